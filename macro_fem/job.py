"""One job: a scene file in, a folder with summary, VTU and picture out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from homogenize.law import InputError, default_law, load_law
from macro_fem.output import prepare_folder, summarize, write_summary, write_vtu
from macro_fem.scene import load_scene
from macro_fem.solvers import solve_scene


def run_scene(scene_path: Path, law_path: Path | None, out: Path, *, picture: bool = True) -> dict[str, Any]:
    """Solves the scene, writes its files into `out` and returns the summary.

    InputError in one sentence if the scene cannot be read, makes no sense or has no solution; nothing is written then.
    """
    scene = load_scene(scene_path)
    law = default_law() if law_path is None else load_law(law_path)
    if picture:
        require_matplotlib()
    solution = solve_scene(scene, law)
    if solution.status == "infeasible":
        raise InputError(f"{scene_path}: [support]: {solution.message}")
    summary = summarize(solution)
    prepare_folder(out)
    write_vtu(out / "curtain.vtu", solution)
    if picture:
        from macro_fem.plots import save_picture

        save_picture(out / "curtain.png", solution)
    write_summary(out, summary)
    return summary


def require_matplotlib() -> None:
    """InputError if pictures are asked for and matplotlib is not installed."""
    from importlib.util import find_spec

    if find_spec("matplotlib") is None:
        raise InputError("curtain.png needs matplotlib: pip install 'ring-mesh[plots]', or ask for --no-picture")
