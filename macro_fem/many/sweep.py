"""Many scenes: one `macro_fem run` for each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rve.common import InputError
from rve.common.commands.sweeps import SweepItem, absolute

COLUMNS = (
    "status",
    "mean_height_mm",
    "lowest_point_mm",
    "max_principal_line_load_N_per_mm",
    "mass_kg",
    "utilisation_max",
    "safety_factor",
    "cells",
)
"""What sweep.csv takes from summary.json; no times, so that the same sweep gives the same file."""


def scene_items(scenes: Sequence[Path], out: Path, further: Sequence[str]) -> list[SweepItem]:
    """One curtain for each scene file, in a folder of its name, with `further` options of `macro_fem run`."""
    twice = [name for name, count in Counter(scene.stem for scene in scenes).items() if count > 1]
    if twice:
        raise InputError(f"scenes: two are called {twice[0]}, and each needs a folder of its own; rename one")
    if any(one.split("=")[0] == "--out" for one in further):
        raise InputError("--out: is given by the sweep")
    items = []
    for scene in scenes:
        folder = out.resolve() / scene.stem
        arguments = ("run", str(scene.resolve()), "--out", str(folder), *absolute(further))
        items.append(SweepItem(scene.stem, "macro_fem", arguments, folder / "summary.json"))
    return items


def scene_columns(record: dict[str, Any]) -> dict[str, Any]:
    """What sweep.csv says of a curtain, from its summary."""
    return {name: record.get(name, "") for name in COLUMNS}
