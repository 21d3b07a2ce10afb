"""Many scenes: one `macro_fem run` for each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rve.common.errors import InputError
from rve.common.sweeps import Item

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


def scene_items(scenes: Sequence[Path], out: Path, further: Sequence[str]) -> list[Item]:
    """One curtain for each scene file, in a folder of its name, with `further` options of `macro_fem run`."""
    twice = [name for name, count in Counter(scene.stem for scene in scenes).items() if count > 1]
    if twice:
        raise InputError(f"scenes: two are called {twice[0]}, and each needs a folder of its own; rename one")
    if any(one.split("=")[0] == "--out" for one in further):
        raise InputError("--out: is given by the sweep")
    files = tuple(Path(one).resolve() for one in further if Path(one).is_file())
    words = [str(Path(one).resolve()) if Path(one).exists() else one for one in further]
    items = []
    for scene in scenes:
        folder = out.resolve() / scene.stem
        arguments = ("run", str(scene.resolve()), "--out", str(folder), *words)
        items.append(Item(scene.stem, "macro_fem", arguments, folder / "summary.json", (scene.resolve(), *files)))
    return items


def scene_columns(record: dict[str, Any]) -> dict[str, Any]:
    """What sweep.csv says of a curtain, from its summary."""
    return {name: record.get(name, "") for name in COLUMNS}
