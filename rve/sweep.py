"""Tables over many radii and weaves: one `rve table` for each cell."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

from rve.common import InputError, sidecar_path
from rve.common.commands.sweeps import SweepItem, absolute

MOST_CELLS = 10_000


def table_items(
    out: Path, r1: Sequence[float], r2: Sequence[float], weave: Sequence[str], grain: str, further: Sequence[str]
) -> list[SweepItem]:
    """One table for each weave, r1 and r2 in mm, with `further` options of `rve table`; InputError for too many."""
    cells = list(product(weave, r1, r2))
    if not 0 < len(cells) <= MOST_CELLS:
        raise InputError(f"--r1, --r2 and --weave: make {len(cells)} tables, at most {MOST_CELLS} are allowed")
    for name in ("--out", "--r1", "--r2", "--weave", "--grain"):
        if any(one.split("=")[0] == name for one in further):
            raise InputError(f"{name}: is given by the sweep")
    items = []
    for name, big, small in cells:
        r1_text, r2_text = (repr(float(one)).removesuffix(".0") for one in (big, small))  # another name for each number
        table = out.resolve() / f"{name}_{grain}_r1-{r1_text}_r2-{r2_text}.csv"
        asked = ("--weave", name, "--grain", grain, "--r1", repr(big), "--r2", repr(small))
        arguments = ("table", "--out", str(table), *asked, *absolute(further))
        items.append(SweepItem(table.stem, "rve", arguments, sidecar_path(table)))
    return items


def table_columns(record: dict[str, Any]) -> dict[str, Any]:
    """What sweep.csv says of a table, from its sidecar: cell, reference cell, areal mass, rows by status."""
    names = ("weave", "grain", "r1_mm", "r2_mm", "b_x_mm", "b_y_mm", "areal_mass_kg_per_m2")
    rows = record.get("rows", {})
    converged = rows.get("converged", 0)
    return {name: record.get(name, "") for name in names} | {
        "rows_converged": converged,
        "rows_other": sum(rows.values()) - converged,
    }
