"""The paper's scheme: a damped rigid-body motion into the locked state, eqs. (6)-(10), batched over load cases.

Each step solves the linear implicit equations of Stewart and Trinkle (doi 10.1002/(SICI)1097-0207(19960815)39:15) for
the velocity at its end: inertia, damping, the line load at its beginning and compliant unilateral contacts linearised
there. This is the periodic form: bilateral constraints (4), (5) and the supports are eliminated, v = T(q) u has 9 free
numbers. Ring velocities, not u, are carried from step to step, so the centrifugal terms of the curved coordinates are
in M (T u - v). Gyroscopic torques w x I w vanish and are left out: frictionless contacts never spin a torus about its
own axis, and about its diameters all moments of inertia are equal. `tests/test_rve/ten_rings.py` is the reference form
with every constraint written out.

Options, units and matrices are in `rve.paper.dynamics`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rve.common import Array, Flags, Index, Rows, tell, way
from rve.equilibrium.interior_point import unit_loads
from rve.equilibrium.system import Equations, lattice_load
from rve.geometry.contacts import CellContacts, find_contacts
from rve.geometry.distance import distance_gradient, distance_hessian
from rve.geometry.pose import Pose, moved, reduction, ring_normals, start_pose
from rve.paper.contact_qp import Programme, solve_contact_step
from rve.paper.dynamics import (
    Dynamics,
    StewartTrinkleOptions,
    contact_energy,
    kinetic_energy,
    largest_motion,
    weighted_load,
)

ROUND_OFF = 1e-13
"""Rise of the energy in s_hat r1^2 that counts as none: some twenty forces of order 1 times round-offs of a gap."""
NO_STEP = 1e300
"""R before the first step."""


@dataclass(frozen=True)
class CellMotion(Rows):
    """Cases under way: row in the result, line load s (n, 3) of unit size, pose, contacts and their forces lam in the
    last step, ring velocities v (n, m_full) in r1/s and rad/s, next time step h, time, accepted and rejected steps, R
    of the last step.
    """

    row: Index
    s: Array
    pose: Pose
    contacts: CellContacts
    lam: Array
    v: Array
    h: Array
    time: Array
    steps: Index
    rejected: Index
    R: Array


@dataclass(frozen=True)
class History:
    """Accepted steps in long form, one row each: case, time (s) at the end of the step, h (s).

    lattice (m, 3) = x2, y3, t in r1; R; kinetic energy in kg mm2/s2 = 1e-6 J; rise: change of the total energy over the
    step in s_hat r1^2, never above ROUND_OFF; side: contacts that press between rings that do not interlink.
    """

    case: Index
    time: Array
    h: Array
    lattice: Array
    R: Array
    kinetic: Array
    rise: Array
    side: Index


@dataclass(frozen=True)
class Settled(Rows):
    """Where the rings came to rest.

    pose: n poses in r1; contacts and lam (n, p, SLOTS) in s_hat r1, summed over the copies of a pair in the ten rings;
    R (n,); steps, rejected (n,): accepted steps and those tried with too large h; time (n,): sum of h in s; status
    (n,): "converged", "step-limit" or "time-step"; history: only when asked for.
    """

    pose: Pose
    contacts: CellContacts
    lam: Array
    R: Array
    steps: Index
    rejected: Index
    time: Array
    status: NDArray[np.str_]
    history: History | None = None


def gap_gradients(pose: Pose, contacts: CellContacts, equations: Equations) -> Array:
    """Derivative of every gap with respect to the reduced coordinates, (n, p * SLOTS, m); 0 in empty slots."""
    minima = contacts.minima
    case, pair = np.divmod(minima.pair, len(equations.weave.pairs))
    T = reduction(pose)
    rows = np.matmul(distance_gradient(minima)[:, None, :], np.matmul(equations.maps[pair], T[case]))[:, 0]
    G = np.zeros((*contacts.present.shape, T.shape[2]))
    G[contacts.present] = rows
    return G.reshape(len(G), -1, T.shape[2])


@dataclass(frozen=True)
class _Frozen(Rows):
    """What a step keeps from its beginning: T, G, line load on (a1, a2), gaps and stiffnesses of the slots, energy, and
    the stiffness `bend` of contact curvature.
    """

    T: Array
    G: Array
    load: Array
    gap: Array
    k: Array
    energy: Array
    bend: Array


def geometric_stiffness(pose: Pose, contacts: CellContacts, equations: Equations, stiffness: Array) -> Array:
    """Positive part of the contact curvature -sum lam d2gap/dq2 with the elastic forces of the pose, (n, m, m).

    It grows without bound where two minima merge: there the contact point runs along the ring and the linearised gap
    holds for a tiny step only. Part of the Hessian of the contact energy, so an implicit step may have it.
    """
    minima = contacts.minima
    case, pair = np.divmod(minima.pair, len(equations.weave.pairs))
    lam = np.maximum(-stiffness[pair] * contacts.gap[contacts.present], 0.0)
    work = np.flatnonzero(lam > 0.0)
    T = reduction(pose)
    H = distance_hessian(minima.take(work), *ring_normals(pose, equations.weave, case[work], pair[work]), 1.0)
    LT = np.matmul(equations.maps[pair[work]], T[case[work]])
    bend = np.zeros((len(T), T.shape[2], T.shape[2]))
    np.add.at(bend, case[work], -lam[work, None, None] * np.matmul(np.matmul(LT.transpose(0, 2, 1), H), LT))
    # The positive part depends on what is orthogonal: the kinetic energy decides, it knows no coordinates.
    L = np.linalg.cholesky(np.matmul(T.transpose(0, 2, 1), np.matmul(equations.mass, T)))
    half = np.linalg.solve(L, np.linalg.solve(L, bend).transpose(0, 2, 1))
    value, vector = np.linalg.eigh(0.5 * (half + half.transpose(0, 2, 1)))
    root = np.matmul(L, vector * np.sqrt(np.maximum(value, 0.0))[:, None, :])
    return np.matmul(root, root.transpose(0, 2, 1))


def _freeze(motion: CellMotion, equations: Equations, dynamics: Dynamics, curvature: bool) -> _Frozen:
    con = motion.contacts
    n = len(con.gap)
    slots = con.present.reshape(n, -1)
    k = np.where(con.present, dynamics.stiffness[:, None], 0.0).reshape(n, -1)
    gap = np.where(slots, con.gap.reshape(n, -1), 0.0)
    load, _ = lattice_load(motion.pose, motion.s)
    total = contact_energy(con, dynamics.stiffness) + kinetic_energy(motion.v, dynamics)
    T = reduction(motion.pose)
    bend = np.zeros((n, T.shape[2], T.shape[2]))
    if curvature:
        bend = geometric_stiffness(motion.pose, con, equations, dynamics.stiffness)
    return _Frozen(T, gap_gradients(motion.pose, con, equations), load, gap, k, total, bend)


def advanced(
    motion: CellMotion, equations: Equations, options: StewartTrinkleOptions, dynamics: Dynamics
) -> tuple[CellMotion, Array, Array]:
    """One accepted step of every case: the motion, the step lengths, and the rise of the energy.

    The step is halved until contact and kinetic energy, less the work of the load of the step on the displacement of
    the corners, do not rise above round-off; links stay intact and no coordinate moves too far. A case whose step falls
    below h_min keeps its place with h = 0.
    """
    frozen = _freeze(motion, equations, dynamics, options.curvature)
    h, rise, rejected = motion.h.copy(), np.zeros(len(motion.row)), motion.rejected.copy()
    after, todo = replace(motion, lam=np.zeros(motion.lam.shape)), np.arange(len(h))
    while len(todo):
        tried, change, good = _tried(motion.take(todo), frozen.take(todo), h[todo], equations, options, dynamics)
        rows, todo = todo[good], todo[~good]
        after, rise[rows] = after.put(rows, tried.take(good)), change[good]
        rejected[todo] += 1
        h[todo] *= 0.5
        gone = h[todo] < options.h_min
        h[todo[gone]] = 0.0
        todo = todo[~gone]
    following, steps = np.minimum(options.h_max, options.restore * h), motion.steps + (h > 0.0)
    return replace(after, h=following, time=motion.time + h, steps=steps, rejected=rejected), h, rise


def _tried(
    motion: CellMotion,
    start: _Frozen,
    h: Array,
    equations: Equations,
    options: StewartTrinkleOptions,
    dynamics: Dynamics,
) -> tuple[CellMotion, Array, Flags]:
    """The motion after a step of length h (n,), the change of its energy, and whether the step may be accepted."""
    T, Tt, hh = start.T, start.T.transpose(0, 2, 1), h[:, None, None]
    A = np.matmul(Tt, np.matmul(dynamics.mass / hh**2 + dynamics.damping / hh, T)) + start.bend
    force = np.matmul(motion.v[:, None, :], dynamics.mass)[:, 0] / h[:, None]
    force[:, :4] += start.load
    b = np.matmul(Tt, force[..., None])[..., 0]
    step = solve_contact_step(Programme(A, b, start.G, start.gap, start.k))
    v = np.matmul(T, step.w[..., None])[..., 0] / h[:, None]
    pose = moved(motion.pose, step.w)
    contacts = find_contacts(pose, equations.weave, equations.wire, options.reach)
    way = np.concatenate([pose.a1 - motion.pose.a1, pose.a2 - motion.pose.a2], axis=1)
    work = (start.load * way).sum(axis=1)
    total = contact_energy(contacts, dynamics.stiffness) + kinetic_energy(v, dynamics)
    change = total - start.energy - work
    near = h * largest_motion(v, equations.weave, dynamics) <= options.largest_move
    good = step.converged & contacts.links_intact & (change <= ROUND_OFF) & near
    R, lam = weighted_load(v, motion.v, h, start.load, dynamics), step.lam.reshape(motion.lam.shape)
    return replace(motion, pose=pose, contacts=contacts, lam=lam, v=v, R=R), change, good


def begin(s: Array, equations: Equations, options: StewartTrinkleOptions) -> CellMotion:
    """All cases at rest in the slack pose of the weave, under line loads s (n, 3) of any size."""
    n = len(s)
    pose = start_pose(equations.weave, n)
    contacts = find_contacts(pose, equations.weave, equations.wire, options.reach)
    zero, none = np.zeros(n), np.zeros(n, dtype=int)
    v, lam = np.zeros((n, len(equations.mass))), np.zeros(contacts.gap.shape)
    h, R = np.full(n, options.h_max), np.full(n, NO_STEP)
    return CellMotion(np.arange(n), unit_loads(s), pose, contacts, lam, v, h, zero, none, none, R)


def solve(
    s: Array, equations: Equations, options: StewartTrinkleOptions | None = None, *, history: bool = False
) -> Settled:
    """Poses in which the rings come to rest under Cauchy line loads s (n, 3) of any size, only their direction counts.

    Starts at rest from the slack pose of the weave. Nothing is raised for a case that does not converge; its status is
    "step-limit" or "time-step" and its pose the last one.

    >>> from rve.geometry.kinematics import cauchy_line_load
    >>> from rve.geometry.weave import FOUR_IN_ONE
    >>> rest = solve(cauchy_line_load([0.0], [90.0]), Equations.of(FOUR_IN_ONE, 0.1))
    >>> (5 * rest.pose.lattice[0, :2]).round(3), str(rest.status[0])
    (array([11.   , 12.646]), 'converged')
    """
    options = options or StewartTrinkleOptions()
    dynamics, motion = Dynamics.of(equations, options), begin(s, equations, options)
    ended: list[CellMotion] = []
    log: list[tuple[Any, ...]] = []
    while len(motion.row):
        # The residual falls by powers of ten on the way to rest, and the slowest case counts.
        here = way(1.0, float(motion.R.max()), options.tolerance) or 0.0
        tell(f"motion of {len(s)} cells, {len(motion.row)} under way", 1.0 - (1.0 - here) * len(motion.row) / len(s))
        motion, h, rise = advanced(motion, equations, options, dynamics)
        if history:
            kinetic = kinetic_energy(motion.v, dynamics) * options.load * options.r1_mm**2
            side = (motion.lam[:, ~equations.weave.linked] > 0.0).sum(axis=(1, 2))
            log.append((motion.row, motion.time, h, motion.pose.lattice, motion.R, kinetic, rise, side))
        out = (options.tolerance > motion.R) | (motion.steps >= options.max_steps) | (h == 0.0)
        if out.any():
            ended.append(motion.take(out))
            motion = motion.take(~out)
    end = ended[0].join(ended[1:])
    end = end.take(np.argsort(end.row))
    status = np.where(options.tolerance > end.R, "converged", np.where(end.h == 0.0, "time-step", "step-limit"))
    columns = (end.pose, end.contacts, end.lam, end.R, end.steps, end.rejected, end.time, status.astype("<U16"))
    return Settled(*columns, History(*map(np.concatenate, zip(*log, strict=True))) if history else None)
