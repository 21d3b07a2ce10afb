"""Rings of a solved curtain, measured: `python -m benchmarks.localize` writes the table of
docs/explanation/localize.md.

Each scene of `examples` is solved and localized in one run on one core.
"""

import tempfile
from pathlib import Path
from typing import Any

from benchmarks.machine import ROOT
from benchmarks.report.files import write_between_marks
from benchmarks.report.measure import Row
from benchmarks.report.records import table
from macro_fem.job import run_scene
from rve.localization.job import LocalizeOptions, run_localize

SCENES = ("corner_hung", "shop_front", "turned_weave", "gathered_with_bar", "facade_panel", "round_net")


def row_of(scene: str, folder: Path) -> Row:
    """One line of the table: a scene solved, its rings found."""
    run_scene(ROOT / "examples" / f"{scene}.toml", None, folder, picture=False)
    found = run_localize(folder / "curtain.vtu", folder / "rings", LocalizeOptions(), picture=False)
    return line(scene, found, (folder / "rings" / "rings.vtu").stat().st_size)


def line(scene: str, found: dict[str, Any], size: int) -> Row:
    """The summary of a job, as a line of the table."""
    counts = ", ".join(str(found["cells_by_status"].get(name, 0)) for name in ("met", "folded", "beyond", "stalled"))
    gaps = found["drawn_gap_mm_quantiles_0_5_25_50"].get("met")
    return {
        "scene": scene,
        "rings": str(found["rings"]),
        "cells (met, folded, beyond, stalled)": f"{found['cells']} ({counts})",
        "solves": str(found["solves"]),
        "strain short": found["largest_strain_short"],
        "drawn gap of met cells, mm: 5 %, 25 %, 50 %": gaps and ", ".join(f"{gap:.3f}" for gap in gaps[1:]),
        "links intact": f"{found['links_intact']} of {found['links']}",
        "largest force, N": found["worst_cell"]["largest_force_N"],
        "rings.vtu, MB": size / 1e6,
        "s": found["wall_s"],
    }


def main() -> None:
    """Measures every scene and writes the table between the marks of the page."""
    rows = []
    for scene in SCENES:
        with tempfile.TemporaryDirectory() as folder:
            rows.append(row_of(scene, Path(folder)))
        print(rows[-1], flush=True)
    forms = {"strain short": ".1e", "rings.vtu, MB": ".1f", "s": ".1f timed"}
    write_between_marks(ROOT / "docs" / "explanation" / "localize.md", "benchmarks.localize", table("", rows, forms))


if __name__ == "__main__":
    main()
