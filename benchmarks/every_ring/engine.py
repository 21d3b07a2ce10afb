"""MuJoCo on a sheet of about 100 rings: polygons of capsules that fall from the slack weave and come to rest.

Lengths are in r1, a ring has the mass 1, the mean load of a ring is 1. Held rings travel to their places in the first
steps, as in `rve.FiniteMesh`. A wire that slides along another rests in the corners of polygons, so that answers for
different numbers of corners scatter: their spread is MuJoCo's error here.
"""

import time
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from benchmarks.every_ring.brute import Array, least_gap, linked_pairs
from benchmarks.every_ring.cases import SHEETS, Store, kept_rows
from benchmarks.every_ring.starts import slack_start
from benchmarks.report.measure import Row
from benchmarks.report.records import Section, table
from benchmarks.work_precision.peers import MujocoOptions, has_mujoco, ring_shape
from macro_fem.every_ring import RingScene, ring_scene
from rve import Cell

TITLE = "A physics engine"
DAMPING = 0.3
"""Of every slide and every tilt."""
BLOCK = 50
"""Steps between two looks at the rings."""
TRAVEL = 1000
"""Steps in which held rings travel to their places, and in which rings in space are pushed across the plane."""
PUSH = 0.05
"""Standard deviation of that push, in the mean load of a ring."""
REST = 1e-4
"""Largest mean speed of a centre over a block at which the sheet is at rest, in r1 per unit of time."""
STEPS = 20_000
"""Most steps of a run. Longer ones move the mean height by less than the answers scatter."""
DIFFERENCE = "mean height less ours, %"


@dataclass(frozen=True, eq=False)
class Rested:
    """Centres and normals (n, 3) in r1, how the run ended, the last speed, its steps and processor seconds."""

    centre: Array
    normal: Array
    status: str
    speed: float
    steps: int
    seconds: float


def sheet_xml(rings: RingScene, space: bool, options: MujocoOptions) -> str:
    """The model: a body with slides for the free coordinates of each centre, one with a ball joint for the tilts."""
    start, wire = slack_start(rings), rings.mesh.cell.wire
    shape = ring_shape(Cell(1.0, wire), options)
    light = '<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-6 1e-6 1e-6"/>'
    free = ~rings.held & np.array([True, True, space])
    bodies = []
    for k, (x, m) in enumerate(zip(start.x, start.normal, strict=True)):
        slides = "".join(
            f'<joint type="slide" axis="{axis}" damping="{DAMPING}"/>'
            for axis, is_free in zip(("1 0 0", "0 1 0", "0 0 1"), free[k], strict=True)
            if is_free
        )
        turned = np.array([1.0 + m[2], -m[1], m[0], 0.0])
        turned /= np.linalg.norm(turned)
        tilts = f'<joint type="ball" damping="{DAMPING}"/>'
        bodies.append(
            f'<body name="held{k}" mocap="true" pos="{_numbers(x)}"><body>{light}{slides}'
            f'<body name="ring{k}" quat="{_numbers(turned)}">{tilts}{shape}</body></body></body>'
        )
    rigid = f'solref="{2.0 * options.dt} 1" solimp="0.9999 0.9999 1e-3"'
    return (
        f'<mujoco><option gravity="0 0 0" timestep="{options.dt}" integrator="implicitfast" iterations="100" '
        f'tolerance="1e-10" jacobian="sparse"/><size memory="512M"/>'
        f'<default><geom condim="1" {rigid}/></default><worldbody>{"".join(bodies)}</worldbody></mujoco>'
    )


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.12f}" for value in values)


def come_to_rest(rings: RingScene, space: bool, options: MujocoOptions) -> Rested:
    """The sheet in MuJoCo, at rest or after `options.steps`; ImportError without mujoco."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(sheet_xml(rings, space, options))
    data = mujoco.MjData(model)
    n = len(rings.mesh.X)
    body = [model.body(f"ring{k}").id for k in range(n)]
    stand = [model.body(f"held{k}").mocapid[0] for k in range(n)]
    start = slack_start(rings).x
    goal = np.where(rings.held, rings.at / rings.mesh.cell.r1, start)
    force = n * rings.force / np.abs(rings.force).sum()
    rng = np.random.default_rng(0)
    before = np.full((n, 3), np.inf)
    began = time.process_time()
    steps, status, speed = 0, "step-limit", np.inf
    while steps < options.steps:
        way = min(1.0, steps / TRAVEL)
        data.mocap_pos[stand] = start + way * (goal - start)
        push = PUSH * rng.standard_normal(n) if space and way < 1.0 else np.zeros(n)
        data.xfrc_applied[body, :3] = force + push[:, None] * [0.0, 0.0, 1.0]
        mujoco.mj_step(model, data, BLOCK)
        steps += BLOCK
        speed = float(np.abs(data.xpos[body] - before).max()) / (BLOCK * options.dt)
        before = data.xpos[body].copy()
        if way == 1.0 and speed < REST:
            status = "at rest"
            break
    normal = data.xmat[body].reshape(-1, 3, 3)[:, :, 2]
    return Rested(before, normal.copy(), status, speed, steps, time.process_time() - began)


def compared(sheet: int, k: int, space: bool, capsules: int) -> Row:
    """MuJoCo's sheet and ours: mean heights over the reference area, gaps and links by brute force, both times."""
    rings = ring_scene(SHEETS[sheet].scene(k, 8))
    mesh = rings.mesh
    began = time.process_time()
    ours = rings.solve(space=space)
    own = time.process_time() - began
    peer = come_to_rest(rings, space, MujocoOptions(capsules, steps=STEPS))
    height = float(mesh.area @ peer.centre[:, 1]) * mesh.cell.r1 / mesh.area.sum()
    intact = linked_pairs(peer.centre, peer.normal, 1.0) == {(int(a), int(b)) for a, b in mesh.linked}
    return {
        "scene": SHEETS[sheet].key,
        "rings": len(mesh.X),
        "centres": "space" if space else "plane",
        "corners of a ring": capsules,
        "MuJoCo": peer.status,
        "ours": ours.status,
        DIFFERENCE: 100.0 * (height - ours.mean_height) / float(np.ptp(mesh.X[:, 1])),
        "least gap of MuJoCo, r1": least_gap(peer.centre, peer.normal, 1.0, mesh.cell.wire),
        "links of MuJoCo intact": intact,
        "its last speed": peer.speed,
        "steps": peer.steps,
        "s of MuJoCo": peer.seconds,
        "s of ours": own,
    }


def measure(full: bool, store: Store) -> Section:
    """The section; without MuJoCo, one that says so."""
    if not has_mujoco() and not store.is_closed:
        return Section(TITLE, "MuJoCo is not installed (`pip install 'mujoco<4'`): nothing was compared.")
    plan = [(0, 2, space, n) for space in (False, True) for n in (24, 48)] if full else [(0, 1, False, 24)]
    makes = {
        f"engine_{SHEETS[sheet].key}_{k}_{'space' if space else 'plane'}_{capsules}": partial(
            compared, sheet, k, space, capsules
        )
        for sheet, k, space, capsules in plan
    }
    rows = kept_rows(store, {}, makes)
    text = (
        "A sheet of the first section in MuJoCo: rings are closed polygons of capsules, whose corners lie as far "
        "outside the centre circle as their sides lie inside, contacts as stiff as it allows, without friction. From "
        "the slack weave it falls under damping until no centre moves faster than 1e-4, in r1 and the square root of "
        "r1/g, or for 20,000 steps. Gaps are those of the true tori with MuJoCo's centres and normals. "
        "A wire that slides along a polygon rests in its corners: answers scatter with their number. MuJoCo's error "
        "is stated as the spread of its answers for the same scene; ours has local minima of its own (`Random "
        "starts`). Times are processor seconds of one thread, one after the other in the same process."
    )
    forms: dict[str, Any] = {
        DIFFERENCE: "+.3f",
        "least gap of MuJoCo, r1": "+.4f",
        "its last speed": "at_most",
        "steps": ",",
    }
    forms |= {"s of MuJoCo": ".0f timed", "s of ours": ".1f timed"}
    return Section(TITLE, text, (table("The same sheet in MuJoCo", rows, forms),), (), _conclusion(rows))


def _conclusion(rows: list[Row]) -> str:
    said = []
    for centres, where in (("plane", "the plane"), ("space", "space")):
        found = np.array([row[DIFFERENCE] for row in rows if row["centres"] == centres])
        if len(found):
            said.append(
                f"with centres in {where} MuJoCo's mean height differs from ours by {found.mean():+.2g} % of the "
                f"height on average, its answers by {np.ptp(found):.2g} % among themselves"
            )
    text = "; ".join(said)
    return f"{text[:1].upper()}{text[1:]}." if said else "No case is there."
