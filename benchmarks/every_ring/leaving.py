"""Does a weave leave the plane under tension? Periodic cells with centres free in space against the planar cell."""

from functools import partial

import numpy as np

from benchmarks.every_ring.cases import Array, Store, kept_rows
from benchmarks.every_ring.space_cell import SpaceCell, climb
from benchmarks.report.measure import Row
from benchmarks.report.records import Section, table
from rve import Cell, support
from rve.geometry.weave import FOUR_IN_ONE, SIX_IN_ONE, Weave, supercell
from rve.support_function import Support

RATIOS = {"4-in-1": (5.0, 10.0, 20.0, 50.0), "6-in-1": (7.0, 10.0, 20.0, 50.0)}
LOADS = np.array([[0.5, 0.0, 0.5], [0.8, 0.0, 0.2], [0.03, 0.0, 0.97], [0.6, 0.2, 0.4]])
LARGEST, THICK = 3, 10.0
"""Largest cells along each side, for r1/r2 up to `THICK`; 2 x 2 for thinner wire."""
DISTURBANCE = 0.05
"""Of centres across the plane at the start, in r1."""
FLAT = 1e-3
"""Depth in r1 below which a cell is in the plane."""
MORE, RISE, DEPTH = "more work than h", "largest S:E - h", "largest depth of those, r1"


def measure(full: bool, store: Store) -> Section:
    """The section: weaves, ratios of radii, sizes of the periodic cell, loads, starts."""
    makes = {
        f"cell_{weave.name}_{ratio:g}_{size}": partial(_row, weave, ratio, size)
        for weave in (FOUR_IN_ONE, SIX_IN_ONE)
        for ratio in (RATIOS[weave.name] if full else (10.0,))
        for size in range(1, (LARGEST if ratio <= THICK else 2) + 1 if full else 2)
    }
    rows = kept_rows(store, {"loads": LOADS.tolist(), "disturbance": DISTURBANCE}, makes)
    text = (
        "Cells of 1 x 1 to 3 x 3 primitive cells whose rings may move along z, by sequential quadratic programming "
        "(`space_cell.py`, a solver of its own), under four dead loads S of unit trace. Each load has two starts: the "
        f"slack weave with centres disturbed across the plane by up to {DISTURBANCE} r1 at random, every ring on its "
        "own, and the locked state of the planar cell with a fifth of that; 3 x 3 cells have the second start only. "
        "The work S:E that is reached is compared with h(S) of the planar two-ring cell (`rve.support`). Ends within "
        "1e-6 of h are the planar state; lower ones are other locked states, or places where the method stalled. More "
        "work than h out of the plane does not exclude a planar state of the same size that does as much."
    )
    forms = {RISE: "signed 1e-6", "r1/r2": "g", DEPTH: ".1e", "worst overlap, r1": "at_most 1e-12"}
    more = [row for row in rows if row[MORE]]
    left = [row for row in more if row[DEPTH] > FLAT]
    conclusion = (
        f"Ends out of the plane with more work than h: {_names(left)}. "
        f"{sum(row['at h'] for row in rows)} of {sum(row['runs'] for row in rows)} runs end at h of the planar cell."
    )
    if not left:
        conclusion += " Confinement to the plane costs these cells no strain."
    if flat := [row for row in more if row not in left]:
        conclusion += (
            f" In the plane a state of more work than `rve.support` finds exists for {_names(flat)}: S:E is larger by "
            f"up to {max(row[RISE] for row in flat):.2g}."
        )
    return Section(
        "Does a weave leave the plane?", text, (table("Periodic cells in space", rows, forms),), (), conclusion
    )


def _names(rows: list[Row]) -> str:
    return ", ".join(f"{row['weave']} at {row['r1/r2']:g}, {row['cells']}" for row in rows) or "no cell"


def _row(weave: Weave, ratio: float, size: int) -> Row:
    cell = Cell(5.0, 5.0 / ratio, weave)
    planar = support(cell, LOADS)
    ends: list[Row] = []
    for i, S in enumerate(LOADS):
        for kind in ("slack", "locked") if size < LARGEST else ("locked",):
            ends.append(_end(weave, ratio, size, planar, i, S, kind))
    more = [end for end in ends if end["rise"] > 1e-6 and end["overlap"] < 1e-8]
    low = [end for end in ends if end["rise"] < -1e-6]
    return {
        "weave": weave.name,
        "r1/r2": ratio,
        "cells": f"{size} x {size}",
        "runs": len(ends),
        "at h": len(ends) - len(more) - len(low),
        "below h": len(low),
        MORE: len(more),
        RISE: max(end["rise"] for end in ends),
        DEPTH: max((end["depth"] for end in more), default=0.0),
        "depth at h, r1": max((end["depth"] for end in ends if abs(end["rise"]) <= 1e-6), default=0.0),
        "worst overlap, r1": max(end["overlap"] for end in ends),
        "not ended": sum(end["radius"] > 1e-5 and end["steps"] >= STEPS for end in ends),
        "_ends": ends,
    }


STEPS = 1200


def _end(weave: Weave, ratio: float, size: int, planar: Support, i: int, S: Array, kind: str) -> Row:
    """One run: the rise of the work over h for S of unit trace, and how it ended."""
    sides = size * np.array([planar.b_x_mm, planar.b_y_mm]) / 5.0
    rng = np.random.default_rng([size, i])
    start = slack_cell(weave, ratio, size) if kind == "slack" else locked_cell(weave, ratio, size, planar, i)
    start.centres[:, 2] += DISTURBANCE * rng.uniform(-1.0, 1.0, len(start.centres)) * (1.0 if kind == "slack" else 0.2)
    found = climb(start, S, sides, steps=STEPS)
    h = float(planar.h[i])
    values = {k: getattr(found, k) for k in ("work", "overlap", "depth", "steps", "radius")}
    return {"load": i, "start": kind, "h": h, "rise": found.work - h} | values


def slack_cell(weave: Weave, ratio: float, size: int) -> SpaceCell:
    """size x size slack primitive cells."""
    whole = supercell(weave, size, size)
    centres = np.column_stack([whole.start_centres, np.zeros(whole.classes)])
    return SpaceCell(whole, 1.0 / ratio, whole.start_lattice.copy(), centres, whole.start_normals.copy())


def locked_cell(weave: Weave, ratio: float, size: int, planar: Support, i: int) -> SpaceCell:
    """size x size copies of the locked planar cell of load i."""
    pose = planar.states.pose
    whole = supercell(weave, size, size)
    lattice = pose.lattice[i] * [size, size, 1.0]
    shifts = [ix * pose.a1[i] + iy * pose.a2[i] for iy in range(size) for ix in range(size)]
    flat = np.concatenate([pose.centres[i] + shift for shift in shifts])
    centres = np.column_stack([flat, np.zeros(len(flat))])
    return SpaceCell(whole, 1.0 / ratio, lattice, centres, np.tile(pose.normals[i], (size * size, 1)))
