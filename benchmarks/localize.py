"""Back to the rings, measured: `python -m benchmarks.localize` writes its table into docs/localize.md.

Each scene of `examples` is solved and its rings are found in one run on one core, machine and versions below.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from benchmarks.machine import ROOT, describe
from macro_fem.job import run_scene
from rve.localize_job import JobOptions, run_localize

SCENES = ("corner_hung", "shop_front", "turned_weave", "gathered_with_bar", "facade_panel", "round_net")
PAGE = ROOT / "docs" / "localize.md"
BEGIN, END = "<!-- measured: python -m benchmarks.localize -->", "<!-- end of measured -->"
HEAD = (
    "| scene | rings | cells (met, folded, beyond, stalled) | solves | strain short | drawn gap of met cells, mm: 5 %, "
    "25 %, 50 % | links intact | largest force, N | rings.vtu, MB | s |\n|---|---|---|---|---|---|---|---|---|---|"
)


def row_of(scene: str, folder: Path) -> str:
    """One line of the table: a scene solved, its rings found."""
    run_scene(ROOT / "examples" / f"{scene}.toml", None, folder, picture=False)
    found = run_localize(folder / "curtain.vtu", folder / "rings", JobOptions(picture=False))
    return line(scene, found, (folder / "rings" / "rings.vtu").stat().st_size)


def line(scene: str, found: dict[str, Any], size: int) -> str:
    """What the summary of a job says, as a line of the table."""
    status = found["cells_by_status"]
    counts = ", ".join(str(status.get(name, 0)) for name in ("met", "folded", "beyond", "stalled"))
    gaps = found["drawn_gap_mm_quantiles_0_5_25_50"].get("met")
    shown = "-" if gaps is None else ", ".join(f"{gap:.3f}" for gap in gaps[1:])
    return (
        f"| {scene} | {found['rings']} | {found['cells']} ({counts}) | {found['solves']} "
        f"| {found['largest_strain_short']:.1e} | {shown} | {found['links_intact']} of {found['links']} "
        f"| {found['worst_cell']['largest_force_N']:.3g} | {size / 1e6:.1f} | {found['wall_s']:.1f} |"
    )


def main() -> None:
    """Measures every scene and writes the table between the marks of the page."""
    lines = [HEAD]
    for scene in SCENES:
        with tempfile.TemporaryDirectory() as folder:
            lines.append(row_of(scene, Path(folder)))
        print(lines[-1], flush=True)
    page = PAGE.read_text(encoding="utf-8")
    before, rest = page.split(BEGIN)
    after = rest.split(END)[1]
    PAGE.write_text(f"{before}{BEGIN}\n\n" + "\n".join(lines) + f"\n\n{describe()}\n\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
