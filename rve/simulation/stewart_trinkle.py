"""The paper's scheme: a damped rigid-body motion into the locked state, eqs. (6)-(10), batched over load cases.

Each step solves the linear implicit equations of Stewart and Trinkle (doi 10.1002/(SICI)1097-0207(19960815)39:15) for
the velocity at its end. This is the periodic form: constraints (4), (5) and supports are eliminated. Ring velocities,
v = T(q) u, are carried from step to step, so the centrifugal terms of the curved coordinates are in M (T u - v);
gyroscopic torques vanish. `tests/test_rve/ten_rings.py` is the reference form with every constraint written out.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from rve.common import Array, Flags, Index, Rows, tell
from rve.geometry.contacts import CellContacts, find_contacts
from rve.geometry.pose import Pose, moved, reduction, start_pose
from rve.locking.interior_point import unit_loads
from rve.locking.system import Equations, lattice_load
from rve.simulation.dynamics import Dynamics, StewartTrinkleOptions

ROUND_OFF = 1e-13
"""Rise of the energy in s_hat r1^2 that counts as none: some twenty forces of order 1 times round-offs of a gap."""


@dataclass(frozen=True)
class History:
    """Accepted steps, one row each: case, time (s) at the end of the step, h (s).

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
class CellMotion(Rows):
    """Rings in motion, or come to rest.

    row: in the result; s (n, 3): line load of unit size; pose: in r1; contacts and their forces lam (n, p, SLOTS) in
    the last step, in s_hat r1, summed over the copies of a pair in the ten rings; v (n, m_full): ring velocities in
    r1/s and rad/s; h: next time step; time (n,): sum of h in s; steps, rejected (n,): accepted steps and those tried
    with too large h; R (n,) of the last step; status (n,): "" under way, then "converged", "step-limit" or "time-step";
    history: of the end, if `simulate` keeps it.
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
    status: NDArray[np.str_]
    history: History | None = None


def geometric_stiffness(bend: Array, T: Array, equations: Equations) -> Array:
    """Positive part of the contact curvature bend (n, m, m) = -sum lam d2gap/dq2; T (n, m_full, m) by `reduction`.

    It grows without bound where two minima merge: there the linearised gap is valid for tiny steps only.
    """
    # The positive part depends on what is orthogonal: the kinetic energy decides, it knows no coordinates.
    L = np.linalg.cholesky(np.matmul(T.transpose(0, 2, 1), np.matmul(equations.mass, T)))
    half = np.linalg.solve(L, np.linalg.solve(L, bend).transpose(0, 2, 1))
    value, vector = np.linalg.eigh(0.5 * (half + half.transpose(0, 2, 1)))
    root = np.matmul(L, vector * np.sqrt(np.maximum(value, 0.0))[:, None, :])
    return np.asarray(np.matmul(root, root.transpose(0, 2, 1)))


def advance(
    motion: CellMotion, equations: Equations, options: StewartTrinkleOptions, dynamics: Dynamics
) -> tuple[CellMotion, Flags, Array]:
    """Every case after a step of its length h, whether it is accepted, and the change of the energy, (n,) each.

    It is if contact and kinetic energy, less the work of the load, do not rise above round-off, links stay intact and
    no ring moves too far. Else the case stays where it is, for half the step.
    """
    h, con, T, mass = motion.h, motion.contacts, reduction(motion.pose), dynamics.mass
    Tt, hh, load = T.transpose(0, 2, 1), h[:, None, None], lattice_load(motion.pose, motion.s)[0]
    k, gap = np.where(con.present, dynamics.stiffness[:, None], 0.0), np.where(con.present, con.gap, 0.0)
    G, bend = equations.gap_derivatives(motion.pose, con, T, np.maximum(-k * gap, 0.0))
    A = np.matmul(Tt, np.matmul(mass / hh**2 + mass * dynamics.decay / hh, T))
    A += geometric_stiffness(-bend, T, equations) if options.curvature else 0.0
    force = np.matmul(motion.v[:, None, :], mass)[:, 0] / h[:, None]
    force[:, :4] += load
    b = np.matmul(Tt, force[..., None])[..., 0]
    w, lam, is_solved = solve_contact_step(A, b, G, gap.reshape(len(h), -1), k.reshape(len(h), -1))
    v = np.matmul(T, w[..., None])[..., 0] / h[:, None]
    pose = moved(motion.pose, w)
    contacts = find_contacts(pose, equations.weave, equations.wire, options.reach)
    way = np.concatenate([pose.a1 - motion.pose.a1, pose.a2 - motion.pose.a2], axis=1)
    rise = dynamics.energy(contacts, v) - dynamics.energy(con, motion.v) - (load * way).sum(axis=1)
    near = h * dynamics.largest_motion(v) <= options.largest_move
    good = is_solved & contacts.links_intact & (rise <= ROUND_OFF) & near
    R, lam = dynamics.weighted_load(v, motion.v, h, load), lam.reshape(motion.lam.shape)
    after = replace(motion, pose=pose, contacts=contacts, lam=lam, v=v, R=R, time=motion.time + h)
    after = replace(after, h=np.minimum(options.h_max, options.restore * h), steps=motion.steps + 1)
    stay, rows = replace(motion, h=0.5 * h, rejected=motion.rejected + 1), np.flatnonzero(good)
    return stay.put(rows, after.take(rows)), good, rise


def solve_contact_step(A: Array, b: Array, G: Array, gap: Array, k: Array) -> tuple[Array, Array, Flags]:
    """Displacements w (n, m) and forces lam (n, c) >= 0 of compliant contact over one step, and which are solved, (n,):

        A w = b + G^T lam,    0 <= lam  _|_  gap + G w + lam/k >= 0,

    for A (n, m, m) positive definite, b (n, m), G (n, c, m), gap and stiffness k (n, c), 0 for slots without a contact.
    With A = L L^T the forces are where |L^-1 (b + G^T lam)|^2 + |lam/sqrt(k) + sqrt(k) gap|^2 is least.

    >>> one = np.ones((1, 1))
    >>> solve_contact_step(one[:, None], -2 * one, one[:, None], 0 * one, 3 * one)[:2]
    (array([[-0.5]]), array([[1.5]]))
    """
    L, lam, is_solved = np.linalg.cholesky(A), np.zeros(gap.shape), np.ones(len(b), dtype=bool)
    force, ways = np.linalg.solve(L, b[..., None])[..., 0], np.linalg.solve(L, G.transpose(0, 2, 1))
    for i, used in enumerate(k > 0.0):
        root = np.sqrt(k[i, used])
        if not len(root):  # nnls takes no empty matrix
            continue
        try:
            matrix = np.vstack([ways[i][:, used], np.diag(1.0 / root)])
            lam[i, used] = nnls(matrix, -np.concatenate([force[i], root * gap[i, used]]))[0]
        except RuntimeError:  # its limit of iterations
            is_solved[i] = False
    balance = b + np.matmul(lam[:, None, :], G)[:, 0]
    return np.linalg.solve(A, balance[..., None])[..., 0], lam, is_solved


def begin(s: Array, equations: Equations, options: StewartTrinkleOptions) -> CellMotion:
    """All cases at rest in the slack pose of the weave, under line loads s (n, 3) of any size."""
    n = len(s)
    pose = start_pose(equations.weave, n)
    contacts = find_contacts(pose, equations.weave, equations.wire, options.reach)
    zero, none = np.zeros(n), np.zeros(n, dtype=int)
    v, lam = np.zeros((n, len(equations.mass))), np.zeros(contacts.gap.shape)
    h, R, status = np.full(n, options.h_max), np.full(n, np.inf), np.full(n, "", dtype="<U16")
    return CellMotion(np.arange(n), unit_loads(s), pose, contacts, lam, v, h, zero, none, none, R, status)


def simulate(
    s: Array, equations: Equations, options: StewartTrinkleOptions | None = None, *, history: bool = False
) -> CellMotion:
    """Poses in which the rings come to rest under Cauchy line loads s (n, 3) of any size, only their direction counts.

    Starts at rest from the slack pose of the weave. Nothing is raised for a case that does not converge; its status is
    "step-limit" or "time-step" and its pose the last one.

    >>> from rve.geometry.kinematics import cauchy_line_load
    >>> from rve.geometry.weave import FOUR_IN_ONE
    >>> rest = simulate(cauchy_line_load([0.0], [90.0]), Equations.of(FOUR_IN_ONE, 0.1))
    >>> (5 * rest.pose.lattice[0, :2]).round(3), str(rest.status[0])
    (array([11.   , 12.646]), 'converged')
    """
    options = options or StewartTrinkleOptions()
    dynamics, motion = Dynamics.of(equations, options), begin(s, equations, options)
    ended: list[CellMotion] = []
    log: list[list[Any]] = []
    while len(motion.row):
        tell(f"motion of {len(s)} cells, {len(motion.row)} under way, step {motion.steps.max() + 1}")
        h = motion.h
        motion, good, rise = advance(motion, equations, options, dynamics)
        if history:
            kinetic = dynamics.kinetic_energy(motion.v) * options.load * options.r1_mm**2
            side = (motion.lam[:, ~equations.weave.linked] > 0.0).sum(axis=(1, 2))
            columns = (motion.row, motion.time, h, motion.pose.lattice, motion.R, kinetic, rise, side)
            log.append([column[good] for column in columns])
        out = (options.tolerance > motion.R) | (motion.steps >= options.max_steps) | (motion.h < options.h_min)
        if out.any():
            ended.append(motion.take(out))
            motion = motion.take(~out)
    end = ended[0].join(ended[1:])
    end = end.take(np.argsort(end.row))
    failed = np.where(end.h < options.h_min, "time-step", "step-limit")
    status = np.where(options.tolerance > end.R, "converged", failed)
    steps = History(*map(np.concatenate, zip(*log, strict=True))) if history else None
    return replace(end, status=status.astype("<U16"), history=steps)
