"""Physics engines beside every ring in motion: polygons of capsules from our rings at rest, of which some are let go.

Lengths are in r1, times in sqrt(r1 / g), masses in the mean of the rings. MuJoCo's contacts give a little and its rings
are polygons, so it first comes to rest under damping; then the damping is taken away and the corner let go. Newton's
solver of positions (XPBD) has no ties that can be let go, so its rings begin to fall at once.
"""

import itertools
import math
import time
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from benchmarks.every_ring.brute import Array, least_gap
from macro_fem.motion.pace import Run
from macro_fem.motion.rings import RingFrame

Played = tuple[Callable[[int], None], Callable[[], tuple[Array, Array]]]
"""What takes a number of steps, and what tells centres (n, 3) and normals (n, 3)."""

CAPSULES = 24
STEPS = {"mujoco": (1e-3, 5e-4), "newton": (5e-3, 2.5e-3)}
"""In sqrt(r1 / g)."""
SWEEPS = 10
"""Of XPBD over all contacts in each step."""
SETTLED, DAMPING = 20.0, 0.5
"""How long the rings come to rest, and the damping of every slide and tilt meanwhile."""
TEXT = (
    f"Engines have rings of {CAPSULES} capsules without friction. MuJoCo, with contacts as stiff as it allows, first "
    f"settles from our rings at rest with damping; Newton, on the CPU by XPBD with {SWEEPS} sweeps a step, begins at "
    "once. Times are processor seconds of the motion alone; Newton compiles for two minutes before its first."
)


class Fallen(NamedTuple):
    """Mean place (m, 3) in mm at even times, processor seconds, least gap of the true tori at the end in r1."""

    mean: Array
    seconds: float
    least_gap: float


def fall(run: Run[RingFrame], duration: float, name: str, dt: float) -> Fallen:
    """The rings of the first frame of a run, of which those that its last frame holds no more are let go.

    By the engine `name`; the steps of the run are those of the answer.
    """
    first, end = run.frames[0], run.frames[-1]
    cell, mass = first.rings.mesh.cell, first.asked.mass / first.asked.mass.mean()
    held, kept = first.asked.held.any(axis=1), end.asked.held.any(axis=1)
    centre, normal = first.rings.centre / cell.r1, first.rings.normal
    play = {"mujoco": _mujoco, "newton": _newton}[name]
    forward, places = play(partial(_xml, centre, normal, mass, cell.wire, kept), held & ~kept, dt)
    per = end.moment.t / math.sqrt(1e-3 * cell.r1 / 9.81) / dt
    began, mean = time.process_time(), []
    for k in range(round(duration / end.moment.t) + 1):
        if k:
            forward(round(k * per) - round((k - 1) * per))
        mean.append(cell.r1 * (mass @ places()[0]) / mass.sum())
    seconds = time.process_time() - began
    return Fallen(np.array(mean), seconds, least_gap(*places(), 1.0, cell.wire))


def _mujoco(written: Callable[[Array, float, float], str], released: Array, dt: float) -> Played:
    import mujoco

    model = mujoco.MjModel.from_xml_string(written(released, DAMPING, dt))
    data = mujoco.MjData(model)
    body = np.array([model.body(f"ring{n}").id for n in range(len(released))])
    mujoco.mj_step(model, data, round(SETTLED / dt))
    model.dof_damping[:], data.qvel[:], data.eq_active[:] = 0.0, 0.0, 0
    return partial(mujoco.mj_step, model, data), lambda: (
        data.xpos[body].copy(),
        data.xmat[body].reshape(-1, 3, 3)[:, :, 2].copy(),
    )


def _newton(written: Callable[[Array, float, float], str], released: Array, dt: float) -> Played:
    import newton
    import warp

    warp.config.quiet = True
    builder = newton.ModelBuilder(gravity=(0.0, -1.0, 0.0), up_axis=newton.Axis.Z)
    builder.add_mjcf(written(np.zeros_like(released), 0.0, dt))
    builder.shape_material_mu[:] = [0.0] * builder.shape_count
    model = builder.finalize(device="cpu")
    solver, control = newton.solvers.SolverXPBD(model, iterations=SWEEPS), model.control()
    states = [model.state(), model.state()]
    newton.eval_fk(model, model.joint_q, model.joint_qd, states[0])

    def forward(steps: int) -> None:
        for _ in range(steps):
            states[0].clear_forces()
            solver.step(*states, control, model.collide(states[0]), dt)
            states.reverse()

    def places() -> tuple[Array, Array]:
        x, y, z, w = np.asarray(states[0].body_q.numpy()[:, 3:], float).T
        normal = np.stack([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)], axis=1)
        return np.asarray(states[0].body_q.numpy()[:, :3], float), normal

    return forward, places


def _xml(
    centre: Array, normal: Array, mass: Array, wire: float, kept: Array, released: Array, damping: float, dt: float
) -> str:
    """Free rings, those that only tilt, and those tied to their places until they are let go."""
    bodies = []
    for n, (x, m) in enumerate(zip(centre, normal, strict=True)):
        turned = np.array([1.0 + m[2], -m[1], m[0], 0.0]) / math.sqrt(2.0 + 2.0 * m[2])
        bodies.append(
            f'<body name="ring{n}" pos="{_numbers(x)}" quat="{_numbers(turned)}">'
            f'<joint type="{"ball" if kept[n] else "free"}" damping="{damping}"/>{_ring(wire, mass[n])}</body>'
        )
    ties = [f'<connect body1="ring{n}" anchor="0 0 0"/>' for n in np.flatnonzero(released)]
    rigid = f'solref="{2.0 * dt} 1" solimp="0.9999 0.9999 1e-3"'
    return (
        f'<mujoco><option gravity="0 -1 0" timestep="{dt}" integrator="implicitfast" iterations="100" '
        f'tolerance="1e-10" jacobian="sparse"/><size memory="512M"/>'
        f'<default><geom condim="1" {rigid}/><equality {rigid}/></default><worldbody>{"".join(bodies)}</worldbody>'
        f"<equality>{''.join(ties)}</equality></mujoco>"
    )


def _ring(wire: float, mass: float) -> str:
    """A polygon of capsules that lies as far inside the centre circle as outside."""
    corner = 2.0 / (1.0 + math.cos(math.pi / CAPSULES))
    turn = 2.0 * np.pi * (np.arange(CAPSULES + 1) - 0.5) / CAPSULES
    points = [f"{corner * math.cos(t):.12f} {corner * math.sin(t):.12f} 0" for t in turn]
    return "".join(
        f'<geom type="capsule" size="{wire}" mass="{mass / CAPSULES}" fromto="{a} {b}"/>'
        for a, b in itertools.pairwise(points)
    )


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.12f}" for value in values)
