"""Pictures of the scenes in examples/: `python -m benchmarks.scenes [NAME ...]` writes examples/pictures/NAME.png."""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

from benchmarks.machine import ROOT
from macro_fem.job import run_scene

if __name__ == "__main__":
    for scene in sorted((ROOT / "examples").glob("*.toml")):
        if scene.stem in (sys.argv[1:] or [scene.stem]):
            with tempfile.TemporaryDirectory() as folder:
                summary = run_scene(scene, None, Path(folder))
                shutil.copyfile(Path(folder, "curtain.png"), ROOT / "examples" / "pictures" / f"{scene.stem}.png")
            print(f"{scene.stem}: {summary['status']}, {summary['cells']} cells, {summary['wall_s']:.1f} s", flush=True)
