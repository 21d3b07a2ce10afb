"""What friction between rings takes of a load that swings: loops of mesh, over weave, r1/r2 and coefficient."""

import numpy as np

from benchmarks.frame import Section, table
from benchmarks.measure import Row
from rve import Cell, SimulationOptions, friction_loop

RATIOS = {"4-in-1": (5.0, 10.0, 20.0), "6-in-1": (7.0, 10.0, 20.0)}
COEFFICIENTS = (0.05, 0.1, 0.2)
SWINGS = {"turns": ((-10.0, 75.0), (10.0, 75.0)), "shifts": ((0.0, 60.0), (0.0, 80.0))}
"""Of a mesh that hangs by its grain: its load turns to both sides, or its share across the grain grows and falls."""


def measure(full: bool) -> Section:
    """The section; `full` has more steps of the load and sides of the polygon of friction forces."""
    rows = [
        {"weave": weave, "r1/r2": ratio, "friction": friction} | swings(Cell(5.0, 5.0 / ratio, weave), friction, full)
        for weave, ratios in RATIOS.items()
        for ratio in ratios
        for friction in COEFFICIENTS
    ]
    columns = [f"{name}, {what}" for name in SWINGS for what in ("lost/load", "band", "damping ratio")]
    ratios = np.array([[row[f"{name}, damping ratio"] / row["friction"] for name in SWINGS] for row in rows])
    low, middle, high = np.nanpercentile(ratios, [0, 50, 100])
    told = (
        f"{np.isnan(ratios).sum()} of {ratios.size} swings move no ring. In the others the damping ratio is {low:.1f} "
        f"to {high:.1f} times the coefficient of friction, {middle:.1f} in the middle."
    )
    forms = dict.fromkeys(columns, ".2g") | {"r1/r2": "g", "friction": "g"}
    return Section("Loops", TEXT, (table("", rows, forms),), conclusion=told)


def swings(cell: Cell, friction: float, full: bool) -> Row:
    """Energy lost per reference area over the size of the load, largest band of strain, damping ratio."""
    options = SimulationOptions(friction=friction, directions=16 if full else 8, tolerance=1e-5 if full else 1e-4)
    row: Row = {}
    for name, (first, second) in SWINGS.items():
        loop = friction_loop(cell, first, second, options, increments=12 if full else 6)
        row |= {f"{name}, lost/load": loop.lost, f"{name}, band": loop.band.max()}
        row |= {f"{name}, damping ratio": loop.damping_ratio}
    return row


TEXT = """A load of constant size swings slowly between two directions (alpha, beta) and back: **turns** (-10, 75) to
(10, 75), **shifts** (0, 60) to (0, 80) degrees. lost/load: energy per reference area and cycle over the line load;
band: largest difference of a strain component under one load on the two ways; damping ratio: of the viscous damping
that loses as much, `-` where the rings do not move."""
