"""The paper's scheme: a damped rigid-body motion into the locked state, eqs. (6)-(10), batched over load cases.

Each step solves the linear implicit equations of Stewart and Trinkle (doi 10.1002/(SICI)1097-0207(19960815)39:15) for
the velocity at its end: inertia, damping, the line load at its beginning and compliant unilateral contacts linearised
there. This is the periodic form: bilateral constraints (4), (5) and the supports are eliminated, v = T(q) u has 9 free
numbers. Ring velocities, not u, are carried from step to step, so the centrifugal terms of the curved coordinates are
in M (T u - v). Gyroscopic torques w x I w vanish and are left out: frictionless contacts never spin a torus about its
own axis, and about its diameters all moments of inertia are equal. `ten_rings` is the reference form with every
constraint written out.

Scaled units: length r1, line load s_hat, hence energy s_hat r1^2; time stays in seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rve.common.types import Array
from rve.equilibrium.contact_qp import ContactStep, Programme, solve_contact_step
from rve.equilibrium.system import Equations, lattice_load
from rve.geometry.circles import cross, distance_gradient, distance_hessian, dot
from rve.geometry.contacts import Contacts, find_contacts, joined_contacts
from rve.geometry.pose import Pose, moved, reduction, start_pose
from rve.geometry.weave import Weave
from rve.paper.alternating_projection import find_contacts_by_projection

Index = NDArray[np.intp]
# Of an energy in s_hat r1^2: some twenty forces of order 1 times a few round-offs of a gap.
ROUND_OFF = 1e-13

Finder = Callable[[Pose, Weave, float, float], Contacts]


@dataclass(frozen=True)
class StewartTrinkleOptions:
    """Parameters of the paper's section 3.1, in mm, kg, s; calibrated ones are marked and derived in the docs.

    r1_mm: centre-circle radius; density in kg/mm3; damping in kg/s and rotational_damping in kg mm2/s (calibrated: the
    paper prints 0.1 kgm/s) act on each ring; stiffness k of one contact in kg/s2; load: size of the Cauchy line load
    s_hat in kg/s2, 1 kg/s2 = 1 N/m (calibrated: the paper states none); h_max, h_min: largest time step and
    the one at which the solver gives up, s; tolerance: R of eq. (9) at which a case has converged; max_steps: accepted
    steps per case; restore: growth of the step after an accepted one; reach: gap in r1 from which contacts are seen;
    largest_move: largest displacement (r1) and rotation (rad) of a ring per step, so that rings do not tunnel;
    contacts: "newton" finds all local minima, "projection" those that two alternating projections per pair of rings end
    in; curvature: whether the step sees the curvature of its contacts (`geometric_stiffness`) beside their linearised
    gaps. Without it, as eq. (6) is printed, some cases chatter between merging minima and end with the status
    "time-step"; inertia: whether rings are slow to move, or follow the forces at once as in an overdamped motion;
    gyroscopic: whether the torques that vanish (see the header) are computed all the same.
    """

    r1_mm: float = 5.0
    density: float = 7.85e-6
    damping: float = 1.0
    rotational_damping: float = 100.0
    stiffness: float = 1e6
    load: float = 2.5
    h_max: float = 1.0
    h_min: float = 1e-9
    tolerance: float = 1e-9
    max_steps: int = 20000
    restore: float = 2.0
    reach: float = 0.2
    largest_move: float = 0.4
    contacts: str = "newton"
    curvature: bool = True
    inertia: bool = True
    gyroscopic: bool = False

    def validate(self) -> None:
        """Raise ValueError with one sentence naming the first option that makes no sense."""
        for name in ("r1_mm", "density", "damping", "rotational_damping", "stiffness", "load", "h_max", "h_min"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"option {name} = {value} must be a positive number")
        if self.contacts not in ("newton", "projection"):
            raise ValueError(f'option contacts = {self.contacts!r} must be "newton" or "projection"')
        if not self.restore >= 1.0:
            raise ValueError(f"option restore = {self.restore} must be at least 1")


@dataclass(frozen=True)
class Dynamics:
    """Matrices of the motion in scaled units.

    mass (m_full, m_full) in s2; damping (m_full, m_full) in s; decay (m_full,): damping over mass of each velocity in
    1/s; ring_mass: one ring's in s2; stiffness (p,): of each pair of rings, without unit; ring_maps (rings, 2,
    m_full): from the velocities to those of every ring's centre. inertia: 1, or 0 for a motion without; axial (K,):
    moment of inertia of the rings of each class about their axes beyond that about a diameter, 0 if gyroscopic torques
    are left out.
    """

    mass: Array
    damping: Array
    decay: Array
    ring_mass: float
    stiffness: Array
    ring_maps: Array
    inertia: float
    axial: NDArray[np.floating]

    @staticmethod
    def of(equations: Equations, options: StewartTrinkleOptions) -> Dynamics:
        """The matrices of a cell with these options."""
        size, k = len(equations.mass), equations.weave.classes
        wire, r1 = equations.wire, options.r1_mm
        ring_mass = options.density * 2.0 * np.pi**2 * r1**3 * wire**2 / options.load
        turns = np.arange(size) >= 2 + 2 * k
        inertia = 0.5 + 0.625 * wire**2
        turning = options.rotational_damping / (options.load * r1**2 * ring_mass * inertia)
        decay = np.where(turns, turning, options.damping / (options.load * ring_mass))
        mass = ring_mass * equations.mass
        stiffness = options.stiffness / options.load * np.maximum(copies(equations.weave), 1)
        maps = _ring_maps(equations.weave, size)
        rings = np.bincount(equations.weave.rings[:, 0], minlength=k) * float(options.gyroscopic)
        axial = ring_mass * (1.0 + 0.75 * wire**2 - inertia) * rings
        return Dynamics(mass, mass * decay, decay, ring_mass, stiffness, maps, float(options.inertia), axial)


def _ring_maps(weave: Weave, size: int) -> Array:
    maps = np.zeros((len(weave.rings), 2, size))
    for ring, (kind, i, j) in enumerate(weave.rings.tolist()):
        for x in range(2):
            maps[ring, x, x], maps[ring, x, 2 + x] = i, j
            if kind > 0:
                maps[ring, x, 2 + 2 * kind + x] = 1.0
    return maps


def largest_motion(v: Array, weave: Weave, dynamics: Dynamics) -> Array:
    """Largest speed of a ring's centre (r1/s) or of its rotation (rad/s), (n,)."""
    speed = np.einsum("rxm,nm->nrx", dynamics.ring_maps, v)
    spin = v[:, 2 + 2 * weave.classes :].reshape(len(v), weave.classes, 3)
    return np.sqrt(np.maximum((speed**2).sum(axis=2).max(axis=1), (spin**2).sum(axis=2).max(axis=1)))


def copies(weave: Weave) -> Index:
    """How many times each pair of `weave.pairs` occurs among the rings that carry mass, (p,): in parallel, their
    contact stiffnesses add.
    """
    rings = {tuple(ring) for ring in weave.rings.tolist()}
    return np.array(
        [sum(c == a and (b, x + i, y + j) in rings for c, x, y in rings) for a, b, i, j in weave.pairs.tolist()]
    )


@dataclass(frozen=True)
class Motion:
    """Cases under way: row in the result, line load s (n, 3) of unit size, pose, contacts, ring velocities v
    (n, m_full) in r1/s and rad/s, next time step h, time, accepted and rejected steps, R of the last step.
    """

    row: Index
    s: Array
    pose: Pose
    contacts: Contacts
    v: Array
    h: Array
    time: Array
    steps: Index
    rejected: Index
    R: Array

    def take(self, keep: NDArray[np.bool_]) -> Motion:
        """The cases where `keep` is true."""
        rows = np.flatnonzero(keep)
        rest = {name: value[rows] for name, value in vars(self).items() if name not in ("pose", "contacts")}
        return Motion(pose=self.pose.take(rows), contacts=self.contacts.take(rows), **rest)


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
class Settled:
    """Where the rings came to rest.

    pose: n poses in r1; contacts and lam (n, p, SLOTS) in s_hat r1, summed over the copies of a pair in the ten rings;
    R (n,); steps, rejected (n,): accepted steps and those tried with too large h; time (n,): sum of h in s; status
    (n,): "converged", "step-limit" or "time-step"; history: only when asked for.
    """

    pose: Pose
    contacts: Contacts
    lam: Array
    R: Array
    steps: Index
    rejected: Index
    time: Array
    status: NDArray[np.str_]
    history: History | None = None


def finder_of(options: StewartTrinkleOptions) -> Finder:
    """The contact search that the options name."""
    return find_contacts if options.contacts == "newton" else find_contacts_by_projection


def contact_energy(contacts: Contacts, stiffness: Array) -> Array:
    """Elastic energy of the penetrating contacts, (n,)."""
    pressed = np.where(contacts.present, np.minimum(contacts.gap, 0.0), 0.0)
    return 0.5 * (stiffness[:, None] * pressed**2).sum(axis=(1, 2))


def gap_gradients(pose: Pose, contacts: Contacts, equations: Equations) -> Array:
    """Derivative of every gap with respect to the reduced coordinates, (n, p * SLOTS, m); 0 in empty slots."""
    case, pair = np.divmod(contacts.minima.pair, len(equations.weave.pairs))
    T = reduction(pose)
    rows = np.matmul(distance_gradient(contacts.minima)[:, None, :], np.matmul(equations.maps[pair], T[case]))[:, 0]
    G = np.zeros((*contacts.present.shape, T.shape[2]))
    G[contacts.present] = rows
    return G.reshape(len(G), -1, T.shape[2])


@dataclass(frozen=True)
class _Frozen:
    """What a step keeps from its beginning: T, G, line load on (a1, a2), gaps and stiffnesses of the slots, energy.

    torque (n, 3 K): gyroscopic, on every class of rings.
    """

    T: Array
    G: Array
    load: Array
    gap: Array
    k: Array
    energy: Array
    bend: Array
    torque: Array

    def take(self, rows: Index) -> _Frozen:
        return _Frozen(*(value[rows] for value in vars(self).values()))


def geometric_stiffness(pose: Pose, contacts: Contacts, equations: Equations, stiffness: Array) -> Array:
    """Positive part of the contact curvature -sum lam d2gap/dq2 with the elastic forces of the pose, (n, m, m).

    It grows without bound where two minima merge: there the contact point runs along the ring and the linearised gap
    holds for a tiny step only. Part of the Hessian of the contact energy, so an implicit step may have it.
    """
    case, pair = np.divmod(contacts.minima.pair, len(equations.weave.pairs))
    lam = np.maximum(-stiffness[pair] * contacts.gap[contacts.present], 0.0)
    work = np.flatnonzero(lam > 0.0)
    minima = contacts.minima.take(work)
    T = reduction(pose)
    H = distance_hessian(minima, contacts.normal_a[work], contacts.normal_b[work], 1.0)
    LT = np.matmul(equations.maps[pair[work]], T[case[work]])
    bend = np.zeros((len(T), T.shape[2], T.shape[2]))
    np.add.at(bend, case[work], -lam[work, None, None] * np.matmul(np.matmul(LT.transpose(0, 2, 1), H), LT))
    # The positive part depends on what is orthogonal: the kinetic energy decides, it knows no coordinates.
    L = np.linalg.cholesky(np.matmul(T.transpose(0, 2, 1), np.matmul(equations.mass, T)))
    half = np.linalg.solve(L, np.linalg.solve(L, bend).transpose(0, 2, 1))
    value, vector = np.linalg.eigh(0.5 * (half + half.transpose(0, 2, 1)))
    root = np.matmul(L, vector * np.sqrt(np.maximum(value, 0.0))[:, None, :])
    return np.matmul(root, root.transpose(0, 2, 1))


def _freeze(motion: Motion, equations: Equations, dynamics: Dynamics, curvature: bool) -> _Frozen:
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
    torque = gyroscopic_torque(motion.pose, motion.v, dynamics)
    return _Frozen(T, gap_gradients(motion.pose, con, equations), load, gap, k, total, bend, torque)


def gyroscopic_torque(pose: Pose, v: Array, dynamics: Dynamics) -> Array:
    """-w x I w summed over the rings of each class, (n, 3 K), for the ring velocities v; 0 where it is left out.

    I w = I_d w + (I_a - I_d) n (n.w), and w x w = 0: only what spins about the axis n counts.
    """
    n, k = pose.normals.shape[:2]
    if not dynamics.axial.any():
        return np.zeros((n, 3 * k))
    w = v[:, 2 + 2 * k :].reshape(n, k, 3)
    along = dynamics.axial * dot(pose.normals, w)
    return -cross(w, along[..., None] * pose.normals).reshape(n, 3 * k)


def kinetic_energy(v: Array, dynamics: Dynamics) -> Array:
    """Kinetic energy of all rings, (n,)."""
    return 0.5 * dynamics.inertia * (v * np.matmul(v[:, None, :], dynamics.mass)[:, 0]).sum(axis=1)


def _trial(motion: Motion, frozen: _Frozen, h: Array, dynamics: Dynamics) -> tuple[ContactStep, Array]:
    """The solved quadratic programme of a step of length h (n,), and the ring velocities at its end."""
    T, Tt = frozen.T, frozen.T.transpose(0, 2, 1)
    hh = h[:, None, None]
    mass = dynamics.inertia * dynamics.mass
    A = np.matmul(Tt, np.matmul(mass / hh**2 + dynamics.damping / hh, T)) + frozen.bend
    force = np.matmul(motion.v[:, None, :], mass)[:, 0] / h[:, None]
    force[:, :4] += frozen.load
    force[:, -frozen.torque.shape[1] :] += frozen.torque
    b = np.matmul(Tt, force[..., None])[..., 0]
    step = solve_contact_step(Programme(A, b, frozen.G, frozen.gap, frozen.k))
    return step, np.matmul(T, step.w[..., None])[..., 0] / h[:, None]


def weighted_load(v_new: Array, v: Array, h: Array, load: Array, dynamics: Dynamics) -> Array:
    """R of eq. (9) over all rings, (n,), with the contact and constraint forces of the step.

    By (6) their sum with the load is M (v+ - v)/h + D v+; the load on the corners 1-4 is +-(f1 + f2)/2, +-(f1 - f2)/2.
    """
    y = dynamics.inertia * (v_new - v) / h[:, None] + dynamics.decay * v_new
    top = (y * np.matmul(y[:, None, :], dynamics.mass)[:, 0]).sum(axis=1)
    return np.sqrt(top * dynamics.ring_mass / (load**2).sum(axis=1))


def advanced(
    motion: Motion, equations: Equations, options: StewartTrinkleOptions, dynamics: Dynamics
) -> tuple[Motion, Array, Array, Array]:
    """One accepted step of every case: the motion, the step lengths, contact forces, and the rise of the energy.

    The step is halved until contact and kinetic energy, less the work of the load of the step on the way that the
    corners really go, do not rise above round-off; links stay intact and no coordinate moves too far. A case whose step
    falls below h_min keeps its place with h = 0.
    """
    n = len(motion.row)
    frozen = _freeze(motion, equations, dynamics, options.curvature)
    finder = finder_of(options)
    h, rise = motion.h.copy(), np.zeros(n)
    v, R, lam = motion.v.copy(), motion.R.copy(), np.zeros(motion.contacts.gap.shape)
    rejected = motion.rejected.copy()
    pose, contacts = motion.pose, motion.contacts
    todo = np.arange(n)
    while len(todo):
        part, start = motion.take(_mask(todo, n)), frozen.take(todo)
        step, v_new = _trial(part, start, h[todo], dynamics)
        new = moved(part.pose, step.w)
        found = finder(new, equations.weave, equations.wire, options.reach)
        way = np.concatenate([new.a1 - part.pose.a1, new.a2 - part.pose.a2], axis=1)
        work = (start.load * way).sum(axis=1)
        total = contact_energy(found, dynamics.stiffness) + kinetic_energy(v_new, dynamics)
        change = total - start.energy - work
        near = h[todo] * largest_motion(v_new, equations.weave, dynamics) <= options.largest_move
        good = step.converged & found.links_intact & (change <= ROUND_OFF) & near
        yes = np.flatnonzero(good)
        rows = todo[yes]
        pose, contacts = pose.put(rows, new.take(yes)), contacts.put(rows, found.take(yes))
        R[rows] = weighted_load(v_new, part.v, h[todo], start.load, dynamics)[yes]
        v[rows], rise[rows], lam[rows] = v_new[yes], change[yes], step.lam[yes].reshape(len(yes), *lam.shape[1:])
        todo = todo[~good]
        rejected[todo] += 1
        h[todo] *= 0.5
        gone = h[todo] < options.h_min
        h[todo[gone]] = 0.0
        todo = todo[~gone]
    after = replace(
        motion,
        pose=pose,
        contacts=contacts,
        v=v,
        h=np.minimum(options.h_max, options.restore * h),
        time=motion.time + h,
        steps=motion.steps + (h > 0.0),
        rejected=rejected,
        R=R,
    )
    return after, h, lam, rise


def _mask(rows: Index, n: int) -> NDArray[np.bool_]:
    out = np.zeros(n, dtype=bool)
    out[rows] = True
    return out


@dataclass(frozen=True)
class Progress:
    """Where a solve stands: cases under way, and cases that have left with their last contact forces."""

    going: Motion
    gone: tuple[Motion, ...] = ()
    forces: tuple[Array, ...] = ()


def begin(s: Array, equations: Equations, options: StewartTrinkleOptions) -> Progress:
    """All cases at rest in the slack pose of the weave, under line loads s (n, 3) of any size."""
    options.validate()
    n = len(s)
    pose = start_pose(equations.weave, n)
    contacts = finder_of(options)(pose, equations.weave, equations.wire, options.reach)
    zero, none = np.zeros(n), np.zeros(n, dtype=int)
    v = np.zeros((n, len(equations.mass)))
    size = np.sqrt(s[:, :1] ** 2 + 2.0 * s[:, 1:2] ** 2 + s[:, 2:] ** 2)
    h = np.full(n, options.h_max)
    return Progress(Motion(np.arange(n), s / size, pose, contacts, v, h, zero, none, none, np.full(n, np.inf)))


def continued(
    progress: Progress,
    equations: Equations,
    options: StewartTrinkleOptions,
    batch_steps: int,
    log: list[tuple[Any, ...]] | None = None,
) -> Progress:
    """The same solve after at most this many batch steps; accepted steps are appended to `log`."""
    dynamics = Dynamics.of(equations, options)
    motion, gone, forces = progress.going, list(progress.gone), list(progress.forces)
    for _ in range(batch_steps):
        if not len(motion.row):
            break
        motion, h, lam, rise = advanced(motion, equations, options, dynamics)
        if log is not None:
            kinetic = kinetic_energy(motion.v, dynamics) * options.load * options.r1_mm**2
            side = (lam[:, ~equations.weave.linked] > 0.0).sum(axis=(1, 2))
            log.append((motion.row, motion.time, h, motion.pose.lattice, motion.R, kinetic, rise, side))
        out = (options.tolerance > motion.R) | (motion.steps >= options.max_steps) | (h == 0.0)
        if out.any():
            gone.append(motion.take(out))
            forces.append(lam[out])
            motion = motion.take(~out)
    return Progress(motion, tuple(gone), tuple(forces))


def solve(
    s: Array, equations: Equations, options: StewartTrinkleOptions = StewartTrinkleOptions(), *, history: bool = False
) -> Settled:
    """Poses in which the rings come to rest under Cauchy line loads s (n, 3) of any size, only their direction counts.

    Starts at rest from the slack pose of the weave. Nothing is raised for a case that does not converge; its status is
    "step-limit" or "time-step" and its pose the last one. Raises ValueError for options that make no sense.

    >>> from rve.geometry.kinematics import cauchy_line_load
    >>> from rve.geometry.weave import FOUR_IN_ONE
    >>> rest = solve(cauchy_line_load([0.0], [90.0]), Equations.of(FOUR_IN_ONE, 0.1))
    >>> (5 * rest.pose.lattice[0, :2]).round(3), str(rest.status[0])
    (array([11.   , 12.646]), 'converged')
    """
    log: list[tuple[Any, ...]] = []
    progress = begin(s, equations, options)
    while len(progress.going.row):
        progress = continued(progress, equations, options, 1000, log if history else None)
    return settled(progress, options, log)


def settled(progress: Progress, options: StewartTrinkleOptions, log: list[tuple[Any, ...]] | None = None) -> Settled:
    """The result, in the order of the loads, of a solve that has come to its end."""
    parts = progress.gone
    order = np.argsort(np.concatenate([part.row for part in parts]))

    def joined(columns: list[Any]) -> Any:
        return np.concatenate(columns)[order]

    pose = Pose(*(joined([getattr(part.pose, name) for part in parts]) for name in ("lattice", "centres", "normals")))
    R, h = joined([part.R for part in parts]), joined([part.h for part in parts])
    status = np.where(options.tolerance > R, "converged", np.where(h == 0.0, "time-step", "step-limit"))
    return Settled(
        pose=pose,
        contacts=joined_contacts([part.contacts for part in parts], order),
        lam=joined(list(progress.forces)),
        R=R,
        steps=joined([part.steps for part in parts]),
        rejected=joined([part.rejected for part in parts]),
        time=joined([part.time for part in parts]),
        status=status,
        history=History(*(np.concatenate(column) for column in zip(*log, strict=True))) if log else None,
    )
