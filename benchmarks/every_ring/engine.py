"""MuJoCo beside every ring in motion: polygons of capsules from our rings at rest, of which some are let go.

Lengths are in r1, times in sqrt(r1 / g), masses in the mean of the rings. MuJoCo's contacts give a little and its rings
are polygons, so it first comes to rest under damping; then the damping is taken away and the corner let go.
"""

import itertools
import math
import time
from typing import NamedTuple

import numpy as np

from benchmarks.every_ring.brute import Array, least_gap
from macro_fem.motion.pace import Run
from macro_fem.motion.rings import RingFrame

CAPSULES = 24
STEPS = (1e-3, 5e-4)
"""In sqrt(r1 / g)."""
SETTLED, DAMPING = 20.0, 0.5
"""How long the rings come to rest, and the damping of every slide and tilt meanwhile."""
TEXT = (
    f"MuJoCo has rings of {CAPSULES} capsules, contacts as stiff as it allows and no friction; from our rings at rest "
    "it first settles with damping. Times are processor seconds of the motion alone."
)


class Fallen(NamedTuple):
    """Mean place (m, 3) in mm at even times, processor seconds, least gap of the true tori at the end in r1."""

    mean: Array
    seconds: float
    least_gap: float


def fall(run: Run[RingFrame], duration: float, dt: float) -> Fallen:
    """The rings of the first frame of a run, of which those that its last frame holds no more are let go.

    The steps of the run are those of the answer.
    """
    import mujoco

    first, end = run.frames[0], run.frames[-1]
    cell, mass = first.rings.mesh.cell, first.asked.mass / first.asked.mass.mean()
    held, kept = first.asked.held.any(axis=1), end.asked.held.any(axis=1)
    centre = first.rings.centre / cell.r1
    model = mujoco.MjModel.from_xml_string(_xml(centre, first.rings.normal, cell.wire, kept, held & ~kept, dt))
    data = mujoco.MjData(model)
    body = np.array([model.body(f"ring{n}").id for n in range(len(mass))])
    model.body_mass[body] *= mass
    model.body_inertia[body] *= mass[:, None]
    mujoco.mj_setConst(model, data)
    mujoco.mj_step(model, data, round(SETTLED / dt))
    model.dof_damping[:], data.qvel[:], data.eq_active[:] = 0.0, 0.0, 0
    per = end.moment.t / math.sqrt(1e-3 * cell.r1 / 9.81) / dt
    began, mean = time.process_time(), []
    for k in range(round(duration / end.moment.t) + 1):
        if k:
            mujoco.mj_step(model, data, round(k * per) - round((k - 1) * per))
        mean.append(cell.r1 * (mass @ data.xpos[body]) / mass.sum())
    seconds = time.process_time() - began
    normal = data.xmat[body].reshape(-1, 3, 3)[:, :, 2]
    return Fallen(np.array(mean), seconds, least_gap(data.xpos[body].copy(), normal.copy(), 1.0, cell.wire))


def _xml(centre: Array, normal: Array, wire: float, kept: Array, released: Array, dt: float) -> str:
    """Free rings, those that only tilt, and those tied to their places until they are let go."""
    shape, bodies = _ring(wire), []
    for n, (x, m) in enumerate(zip(centre, normal, strict=True)):
        turned = np.array([1.0 + m[2], -m[1], m[0], 0.0]) / math.sqrt(2.0 + 2.0 * m[2])
        bodies.append(
            f'<body name="ring{n}" pos="{_numbers(x)}" quat="{_numbers(turned)}">'
            f'<joint type="{"ball" if kept[n] else "free"}" damping="{DAMPING}"/>{shape}</body>'
        )
    ties = [f'<connect body1="ring{n}" anchor="0 0 0"/>' for n in np.flatnonzero(released)]
    rigid = f'solref="{2.0 * dt} 1" solimp="0.9999 0.9999 1e-3"'
    return (
        f'<mujoco><option gravity="0 -1 0" timestep="{dt}" integrator="implicitfast" iterations="100" '
        f'tolerance="1e-10" jacobian="sparse"/><size memory="512M"/>'
        f'<default><geom condim="1" {rigid}/><equality {rigid}/></default><worldbody>{"".join(bodies)}</worldbody>'
        f"<equality>{''.join(ties)}</equality></mujoco>"
    )


def _ring(wire: float) -> str:
    """A polygon of capsules that lies as far inside the centre circle as outside."""
    corner = 2.0 / (1.0 + math.cos(math.pi / CAPSULES))
    turn = 2.0 * np.pi * (np.arange(CAPSULES + 1) - 0.5) / CAPSULES
    points = [f"{corner * math.cos(t):.12f} {corner * math.sin(t):.12f} 0" for t in turn]
    return "".join(
        f'<geom type="capsule" size="{wire}" mass="{1.0 / CAPSULES}" fromto="{a} {b}"/>'
        for a, b in itertools.pairwise(points)
    )


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.12f}" for value in values)
