"""Pictures of the scenes in examples/: `python -m benchmarks.scenes [NAME ...]` keeps curtain.png of each."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import click

from benchmarks.machine import ROOT
from macro_fem.job import run_scene

EXAMPLES = ROOT / "examples"


@click.command(help=__doc__)
@click.argument("names", nargs=-1)
def main(names: tuple[str, ...]) -> None:
    """Runs the named scenes, or all."""
    for scene in sorted(EXAMPLES.glob("*.toml")):
        if names and scene.stem not in names:
            continue
        with tempfile.TemporaryDirectory() as folder:
            summary = run_scene(scene, None, Path(folder))
            shutil.copyfile(Path(folder) / "curtain.png", EXAMPLES / "pictures" / f"{scene.stem}.png")
        print(f"{scene.stem}: {summary['status']}, {summary['cells']} cells, {summary['wall_s']:.1f} s", flush=True)


if __name__ == "__main__":
    main()
