"""Error against run time of curtains in motion: BDF2, Euler's method, and steps chosen by the run, in four scenes.

Positions of all nodes at the end, against BDF2 with steps four times as short as the shortest shown: of a curtain let
go at a corner, blown at by a gust, shaken by its rail, and of a net that a ball strikes.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from benchmarks.frame import Curve, Diagram, Section, table
from benchmarks.measure import Row, least_seconds
from homogenize import default_law
from macro_fem.motion.run import MotionRun, solve_motion
from macro_fem.scene.schema import read_scene

SIDE = 800.0
CORNERS = [{"kind": "point", "at": [0.0, SIDE]}, {"kind": "point", "at": [SIDE, SIDE], "release": 0.0}]
BETWEEN = [{"kind": "top"}, {"kind": "edge", "edge": "bottom", "move": [0.0, 40.0, 0.0]}]
GUST = {"speed": 25.0, "direction": [0.0, 0.0, -1.0], "history": [[0.0, 0.0], [0.15, 1.0], [0.3, 0.0]]}
SHAKEN = {"kind": "top", "move": [0.0, 0.0, 60.0], "history": [[0.0, 0.0], [0.1, 1.0], [0.2, 0.0]]}
BALL = {"kind": "sphere", "radius": 60.0, "mass": 0.5, "at": [400.0, 420.0, 120.0], "velocity": [0.0, 0.0, -4000.0]}
SCENES: dict[str, tuple[float, dict[str, Any]]] = {
    "corner let go": (0.3, {"support": CORNERS}),
    "gust": (0.4, {"support": BETWEEN, "load": {"wind": [GUST]}}),
    "rail shaken": (0.4, {"support": [SHAKEN]}),
    "ball into a net": (0.06, {"support": BETWEEN, "body": [BALL]}),
}
"""Duration, s, and tables of the scenes."""
ERROR, SECONDS, MEAN = "error of positions / side", "s", "mean step, ms"


def run(name: str, cells: int, motion: dict[str, Any]) -> MotionRun:
    """A scene in motion; ValueError if a step is not solved."""
    duration, tables = SCENES[name]
    base = {"curtain": {"width": SIDE, "height": SIDE}, "mesh": {"cells": cells}, "solver": {"space": True}}
    found = solve_motion(read_scene(base | tables | {"motion": {"duration": duration} | motion}), default_law())
    if found.status != "converged":
        raise ValueError(f"{name}: {found.message}")
    return found


def rows_of(name: str, cells: int, steps: Sequence[int], accuracies: Sequence[float]) -> list[Row]:
    """A row for each method and setting: mean step, seconds, error against a run with steps four times as short."""
    duration = SCENES[name][0]
    settings = [("BDF2", {"step": duration / n}) for n in steps]
    settings += [("Euler", {"step": duration / n, "scheme": "euler"}) for n in steps]
    settings += [("step chosen", {"accuracy": accuracy}) for accuracy in accuracies]
    truth = run(name, cells, {"step": duration / (4 * steps[-1])}).frames[-1].moment.x
    rows: list[Row] = []
    for method, motion in settings:
        found, seconds = least_seconds(partial(run, name, cells, motion), long=0.0)
        x, count = found.frames[-1].moment.x, len(found.frames) - 1
        error = float(np.sqrt(((x - truth) ** 2).sum(axis=1).mean())) / SIDE
        rows.append({"scene": name, "method": method, MEAN: 1e3 * duration / count, SECONDS: seconds, ERROR: error})
    return rows


def measure(full: bool) -> Section:
    """The section; `full` takes a finer mesh and more steps."""
    cells, steps, accuracies = (
        (8, (20, 40, 80, 160), (1e-3, 1e-4, 1e-5)) if full else (4, (10, 20, 40, 80), (1e-3, 1e-4))
    )
    rows = [row for name in SCENES for row in rows_of(name, cells, steps, accuracies)]
    pictured = [(name, "BDF2") for name in SCENES] + [("corner let go", "Euler"), ("corner let go", "step chosen")]
    shown = [[row for row in rows if (row["scene"], row["method"]) == one] for one in pictured]
    curves = [
        Curve(", ".join(one), tuple(row[SECONDS] for row in mine), tuple(row[ERROR] for row in mine))
        for one, mine in zip(pictured, shown, strict=True)
    ]
    title = "Curtains in motion: error against run time"
    text = (
        f"A sheet of {SIDE:g} x {SIDE:g} mm, {cells} cells across, in space, rigid law. Error: root mean square over "
        f"all nodes at the end, against BDF2 with {4 * steps[-1]} steps on the same mesh: that of the steps alone."
    )
    forms = {MEAN: ".2f", SECONDS: ".1f", ERROR: ".1e"}
    picture = Diagram("motion", title, SECONDS, ERROR, tuple(curves))
    return Section("Motion", text, (table("Steps in time", rows, forms),), (picture,), _end(rows))


def _end(rows: Sequence[Row]) -> str:
    said = []
    for name in SCENES:
        errors, means = (
            np.array([row[key] for row in rows if (row["scene"], row["method"]) == (name, "BDF2")])
            for key in (ERROR, MEAN)
        )
        order = np.log(errors[0] / errors[-1]) / np.log(means[0] / means[-1])
        said.append(f"{name} {order:.1f}")
    return f"Observed orders of BDF2 over all its steps: {', '.join(said)}. Euler's method is for settling."
