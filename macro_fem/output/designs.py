"""Every scene with every law beside each other: a table, a chart of its numbers, and the curtains on one scale."""

from collections.abc import Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from macro_fem.output.pictures import Drawings, draw_all
from rve.common import digits, job, versions
from rve.common.commands.sweeps import Row
from rve.common.drawing.plane import GREEN, VERMILION, Scale, new_figure, save_figure
from rve.common.files import Record
from rve.common.optional import Figure

RECORD = "designs.json"
NO_SHEET = "designs.xlsx needs openpyxl: run pip install openpyxl (extra notebook); designs.csv has the same table"
SHOWN = {
    "governing_factor": "factor until the first link gives",
    "governing_force_N": "largest force of a point, N",
    "mass_kg": "mass of the mesh, kg",
    "rings": "rings",
    "mean_height_mm": "mean height, mm",
    "wall_s": "time to solve, s",
}
"""Columns of the table that the chart has."""
COLUMNS = (
    "status", "mass_kg", "rings", "mean_height_mm", "lowest_point_mm", "governing_force_N", "holds", "governing_factor",
    "governing_combination", "governing_link", "governing_place", "governing_note", "cells", "wall_s",
)  # fmt: skip
"""What the table takes from summary.json."""

GOVERNS = {
    "governing_factor": "smallest_factor", "governing_link": "weakest", "governing_place": "weakest_place",
    "governing_note": "verdict_note",
}  # fmt: skip
"""What governs a curtain in motion, by its names in summary.json."""
MOVING = ("smallest_factor", "at_s", "peak_support_force_N", "peak_support_force_at_s", "reached_s")
"""Further columns of curtains in motion."""
SAG = ("mean_sag_mm", "largest_sag_mm")
"""Further columns of sheets whose weight acts along z; lines and the chart have the first in place of the height."""


def design_columns(record: Record, names: Sequence[str] = COLUMNS) -> Row:
    """The numbers of a design by name, from its summary.json; of one in motion with those of `MOVING` besides, and what
    governs is its weakest moment."""
    is_moving = "smallest_factor" in record
    weakest: Row = {name: record[key] for name, key in GOVERNS.items()} if is_moving else {}
    if forces := [one["largest_nodal_force_N"] for one in record["support_forces"]] if is_moving else []:
        weakest["governing_force_N"] = max(forces)
    known = weakest | dict(record) | record.get("order", {})
    more = [*(MOVING if is_moving else ()), *(name for name in SAG if name in known)]
    return {name: known.get(name, "") for name in (*names, *more)}


def design_line(row: Row) -> str:
    """A design that has an answer in a line, as far as it is known."""
    known = {name: _number(row[name], 4) for name in _shown([row]) if isinstance(row[name], int | float)}
    words = {"mass_kg": "{} kg", "rings": "{} rings", "mean_height_mm": "mean height {} mm",
             SAG[0]: "mean sag {} mm", "governing_force_N": "largest force {} N", "wall_s": "{} s"}  # fmt: skip
    numbers = [text.format(known[name]) for name, text in words.items() if name in known]
    return "; ".join(filter(None, [f"{row['name']}: {_held(row)}", ", ".join(numbers), row["governing_note"]]))


def _shown(rows: Sequence[Row]) -> dict[str, str]:
    """`SHOWN`, of sheets that all sag along z with the sag in place of the height."""
    sag = {"mean_height_mm": (SAG[0], "mean sag, mm")} if all(SAG[0] in row for row in rows) else {}
    return dict(sag.get(name, (name, label)) for name, label in SHOWN.items())


def _number(value: float, count: int) -> str:
    """A count as it is, other numbers with so many digits."""
    return str(value) if isinstance(value, int) else digits(value, count)


def _held(row: Row) -> str:
    """Whether a design holds, and under which combination it does least."""
    if row["holds"] in (None, ""):
        return "strength not known" if row["status"] == "converged" else str(row["status"])
    if row["governing_factor"] in (None, ""):
        return "holds" if row["holds"] else "does not hold"
    under = f" under {row['governing_combination']}" if row["governing_combination"] else ""
    most = "of at most " * _is_at_most(row)
    return f"{'holds' if row['holds'] else 'does not hold'}, factor {most}{digits(row['governing_factor'])}{under}"


def _is_at_most(row: Row) -> bool:
    """Whether the factor of a design is known to be too large."""
    known = row["governing_factor"] not in (None, "") and "smallest_factor" not in row
    return known and bool(row["governing_note"])


def lightest(rows: Sequence[Row]) -> Row | None:
    """The design of least mass that holds, of those whose factor is not known to be less if there are any; None if
    none does."""
    held = [row for row in rows if row["holds"] is True and row["mass_kg"] != ""]
    return min(held, key=lambda row: (bool(row["governing_note"]), row["mass_kg"]), default=None)


def save_designs(out: Path, rows: Sequence[Row], folders: Sequence[Path], *, picture: bool) -> None:
    """Write designs.json, designs.xlsx with openpyxl, and with matplotlib designs.png and curtains.png of the curtains
    in `folders`, one for each row. NotDrawn for those that fail, when all others are in place."""
    record = {"designs": list(rows), "versions": versions()}
    drawings: Drawings = {"designs.xlsx": partial(_write_sheet, rows)} if find_spec("openpyxl") else {}
    if picture:
        drawings["designs.png"] = lambda path: save_figure(path, chart(rows))
        drawings["curtains.png"] = lambda path: save_figure(path, side_by_side(rows, folders))
    with job(out, RECORD, record):
        pass  # what the run before has drawn is removed
    draw_all(out, RECORD, record, drawings)


def _write_sheet(rows: Sequence[Row], path: Path) -> None:
    """The table as a workbook: numbers as numbers, a header that stays in sight, columns as wide as what is in them."""
    from openpyxl import Workbook
    from openpyxl.styles import Font

    book = Workbook()
    sheet: Any = book.active
    sheet.title, sheet.freeze_panes = "designs", "B2"
    names = list(dict.fromkeys(key for row in rows for key in row))
    for line in (names, *([row.get(name, "") for name in names] for row in rows)):
        sheet.append([None if one == "" else one for one in line])
    for cells in sheet.columns:
        cells[0].font = Font(bold=True)
        longest = max(len(digits(one.value, 6) if isinstance(one.value, float) else str(one.value)) for one in cells)
        sheet.column_dimensions[cells[0].column_letter].width = min(longest, 60) + 2
    book.save(path)


def chart(rows: Sequence[Row]) -> Figure:
    """Each number of `SHOWN` as bars, a line for each design."""
    figure = new_figure(7.6, 2.0 * (0.26 * len(rows) + 0.85))
    colours = [{True: GREEN, False: VERMILION}.get(row["holds"], "#9aa3b2") for row in rows]
    for ax, (name, label) in zip(figure.subplots(2, 3, sharey=True).flat, _shown(rows).items(), strict=True):
        values = np.array([row[name] if isinstance(row[name], int | float) else np.nan for row in rows], float)
        bars = ax.barh([row["name"] for row in rows], np.nan_to_num(values), color=colours, height=0.7)
        texts = [_number(row[name], 3) if isinstance(row[name], int | float) else "" for row in rows]
        if name == "governing_factor":
            ax.axvline(1.0, color="black", lw=0.8, ls="--", zorder=0)
            under = [f" {row['governing_combination']}" if row["governing_combination"] else "" for row in rows]
            most = ["at most " * _is_at_most(row) for row in rows]
            texts = [text and f"{at}{text}{more}" for at, text, more in zip(most, texts, under, strict=True)]
        ax.bar_label(bars, texts, padding=3, fontsize=8, bbox={"fc": "white", "ec": "none", "pad": 0.6})
        most = np.nanmax(values, initial=0.0)
        ax.set_xlim(0.0, (1.15 + 0.045 * max(map(len, texts))) * most or 1.0)
        ax.set_xlabel(label, fontsize=9)
        ax.tick_params(labelsize=8)
        ax.locator_params(axis="x", nbins=4)
        ax.spines[["top", "right"]].set_visible(False)
        if not ax.yaxis_inverted():
            ax.invert_yaxis()
    figure.suptitle("green: holds, orange: does not hold, grey: not known", fontsize=9)
    return figure


def side_by_side(rows: Sequence[Row], folders: Sequence[Path]) -> Figure:
    """The curtains of all designs from the front on one scale of lengths and colours, laws in columns."""
    columns = len({row["law"] for row in rows})
    found = [_curtain(folder) for folder in folders]
    drawn = [one for one in found if one is not None]
    scale = Scale.of(np.concatenate([np.zeros(1), *(loads for *_, loads in drawn)]), "line load, N/mm of reference")
    size = np.ptp(np.vstack([np.zeros((2, 2)), *(points[:, :2] for points, *_ in drawn)]), axis=0)
    side = 6.9 / columns
    share = float(np.clip(size[1] / max(size[0], 1e-9), 0.3, 1.6))
    figure = new_figure(7.6, len(rows) // columns * (side * share + 0.55) + 0.8)
    axes = figure.subplots(len(rows) // columns, columns, sharex=True, sharey=True, squeeze=False)
    for ax, row, one in zip(axes.flat, rows, found, strict=True):
        ax.set(aspect="equal")
        ax.spines[["top", "right"]].set_visible(False)
        ax.tick_params(labelsize=7)
        words = f"{row['name']}: {_held(row)}" if one is not None else f"{row['name']}: no answer"
        ax.set_title(fill(words, max(int(11 * side), 12)), fontsize=9)
        if one is None:
            ax.spines[:].set_visible(False)
            ax.text(0.5, 0.5, fill(str(row["message"]), int(11 * side)), ha="center", va="center", fontsize=7,
                    transform=ax.transAxes)  # fmt: skip
            continue
        points, cells, loads = one
        order = points[cells, 2].mean(axis=1).argsort(kind="stable")  # those in front last
        style: Any = {"cmap": scale.colour_map(), "norm": scale.norm(), "edgecolors": "face", "lw": 0.2}
        ax.tripcolor(*points[:, :2].T, cells[order], facecolors=loads[order], **style)
    for ax in axes[-1]:
        ax.set_xlabel("x, mm", fontsize=8)
    for ax in axes[:, 0]:
        ax.set_ylabel("y, mm", fontsize=8)
    scale.add_bar(*axes.flat, location="bottom", shrink=0.6, aspect=40)
    return figure


def _curtain(folder: Path) -> tuple[Any, Any, Any] | None:
    """Corners (n, 3), cells (m, 3) and largest line loads (m,) of a curtain, at the end of one in motion; None where
    there is none."""
    import meshio

    files = [folder / "curtain.vtu"] if (folder / "curtain.vtu").exists() else sorted(folder.glob("motion_*.vtu"))[-1:]
    if not (folder / "summary.json").exists() or not files:
        return None
    mesh = meshio.vtu.read(files[0])
    points = mesh.points + mesh.point_data["displacement_mm"]
    return points, mesh.cells_dict["triangle"], mesh.cell_data_dict["line_load_1_N_per_mm"]["triangle"]
