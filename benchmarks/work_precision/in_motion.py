"""Error against run time of curtains in motion: BDF2, Euler's method, and steps chosen by the run, in four scenes.

Positions of all nodes and their mean at the end, against BDF2 with steps four times as short as the shortest shown; and
the time of a step over the number of triangles, beside the same curtain at rest.
"""

import time
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from benchmarks.frame import Diagram, Section, curves, table
from benchmarks.measure import Row, least_seconds
from homogenize import default_law
from macro_fem import read_scene
from macro_fem.curtain import solve_problem
from macro_fem.motion.curtain import MotionFrame, MovingCurtain
from macro_fem.motion.pace import Run
from macro_fem.motion.stage import scene_at
from macro_fem.problem import make_problem
from macro_fem.scene.meshing.mesh import build_mesh

SIDE = 800.0
CORNERS = [{"kind": "point", "at": [0.0, SIDE]}, {"kind": "point", "at": [SIDE, SIDE], "release": 0.0}]
BETWEEN = [{"kind": "top"}, {"kind": "edge", "edge": "bottom", "move": [0.0, 40.0, 0.0]}]
GUST = {"speed": 25.0, "direction": [0.0, 0.0, -1.0], "history": [[0.0, 0.0], [0.15, 1.0], [0.3, 0.0]]}
SHAKEN = {"kind": "top", "move": [0.0, 0.0, 60.0], "history": [[0.0, 0.0], [0.1, 1.0], [0.2, 0.0]]}
BALL = {"kind": "sphere", "radius": 80.0, "mass": 0.5, "at": [400.0, 420.0, 120.0], "velocity": [0.0, 0.0, -4000.0]}
SCENES: dict[str, tuple[float, dict[str, Any]]] = {
    "corner let go": (0.3, {"support": CORNERS}),
    "gust": (0.4, {"support": BETWEEN, "load": {"wind": [GUST]}}),
    "rail shaken": (0.4, {"support": [SHAKEN]}),
    "ball into a net": (0.06, {"support": BETWEEN, "body": [BALL]}),
}
"""Duration, s, and tables of the scenes."""
GROWN, STEP = ("corner let go", "gust"), 5e-3
"""Scenes of the times of a step, s; the first one in the plane."""
ERROR, OF_MEAN, SECONDS, MEAN = "error of positions / side", "of the mean place / side", "s", "mean step, ms"
ITERATIONS, REST = "iterations", "s at rest"


def run(name: str, cells: int, motion: dict[str, Any]) -> Run[MotionFrame]:
    """A scene in motion; ValueError if a step is not solved."""
    duration, tables = SCENES[name]
    base = {"curtain": {"width": SIDE, "height": SIDE}, "mesh": {"cells": cells}, "solver": {"space": True}}
    scene = read_scene(base | tables | {"motion": {"duration": duration} | motion})
    found = MovingCurtain(scene, default_law()).solve()
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
        away = (found.frames[-1].moment.x - truth) / SIDE
        of_all, of_mean = float(np.sqrt((away**2).sum(axis=1).mean())), float(np.linalg.norm(away.mean(axis=0)))
        found_row = {"scene": name, "method": method, MEAN: 1e3 * duration / (len(found.frames) - 1), SECONDS: seconds}
        rows.append(found_row | {ERROR: of_all, OF_MEAN: of_mean})
    return rows


def measure(full: bool) -> Section:
    """The section; `full` takes a finer mesh and more steps."""
    cells, steps, accuracies = (
        (8, (20, 40, 80, 160), (1e-3, 1e-4, 1e-5)) if full else (4, (10, 20, 40, 80), (1e-3, 1e-4))
    )
    rows = [row for name in SCENES for row in rows_of(name, cells, steps, accuracies)]
    pictured = [f"{name}, BDF2" for name in SCENES] + ["corner let go, Euler", "corner let go, step chosen"]
    named = [row | {"_name": f"{row['scene']}, {row['method']}"} for row in rows]
    drawn = curves([row for row in named if row["_name"] in pictured], "_name", SECONDS, ERROR)
    title = "Curtains in motion: error against run time"
    text = (
        f"A sheet of {SIDE:g} x {SIDE:g} mm, {cells} cells across, in space, rigid law. Error: root mean square over "
        f"all nodes at the end, and of their mean, against BDF2 with {4 * steps[-1]} steps on the same mesh: that of "
        "the steps alone. A mesh that locks vibrates; steps longer than its vibrations lose their energy, so that "
        "errors after a blow stay until steps resolve them, and slack parts fold one way or another."
    )
    forms = {MEAN: ".2f", SECONDS: ".1f", ERROR: ".1e", OF_MEAN: ".1e"}
    picture = Diagram("motion", title, SECONDS, ERROR, drawn)
    growing = [step_row(name, cells) for cells in ((8, 16, 24, 50) if full else (8, 16, 24)) for name in GROWN]
    size = table("Processor time of a step, and at rest", growing, {SECONDS: ".2f", REST: ".2f", ITERATIONS: ".0f"})
    return Section("Motion", text, (table("Steps in time", rows, forms), size), (picture,), _end(rows))


def step_row(name: str, cells: int) -> Row:
    """Processor seconds of a step, the median of five, and of the curtain at rest under what acts at its end."""
    plane = {"solver": {"space": name != GROWN[0]}}
    base = {"curtain": {"width": SIDE, "height": SIDE}, "mesh": {"cells": cells}} | plane | SCENES[name][1]
    scene, law = read_scene(base | {"motion": {"duration": 5 * STEP, "step": STEP}}), default_law()
    seconds, frames, began = list[float](), list[MotionFrame](), time.process_time()
    for frame in MovingCurtain(scene, law).frames():
        frames.append(frame)
        seconds.append(time.process_time() - began)
        began = time.process_time()
    still = scene_at(scene, GUST["history"][1][0])
    _, rest = least_seconds(partial(solve_problem, make_problem(still, law, build_mesh(still, law.cell))), long=0.5)
    return {
        "scene": f"{name}, {'space' if plane['solver']['space'] else 'plane'}",
        **{"triangles": frames[0].problem.mesh.mesh.t.shape[1], SECONDS: float(np.median(seconds[1:]))},
        **{ITERATIONS: float(np.median([frame.iterations for frame in frames[1:]])), REST: rest},
    }


def _end(rows: Sequence[Row]) -> str:
    said = []
    for name in SCENES:
        first, *_, last = (row for row in rows if (row["scene"], row["method"]) == (name, "BDF2"))
        orders = [np.log(first[key] / last[key]) / np.log(first[MEAN] / last[MEAN]) for key in (ERROR, OF_MEAN)]
        said.append("{} {:.1f}, {:.1f}".format(name, *orders))
    return f"Observed orders of BDF2 over all its steps, of positions and their mean: {'; '.join(said)}."
