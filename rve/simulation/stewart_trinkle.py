"""The paper's scheme: a damped rigid-body motion into the locked state, eqs. (6)-(10), batched over load cases.

Each step solves the linear implicit equations of Stewart and Trinkle (doi 10.1002/(SICI)1097-0207(19960815)39:15) for
the velocity at its end. This is the periodic form: constraints (4), (5) and supports are eliminated. Ring velocities,
v = T(q) u, are carried from step to step, so the centrifugal terms of the curved coordinates are in M (T u - v);
gyroscopic torques vanish. `tests/test_rve/ten_rings.py` is the reference form with every constraint written out.

With friction the force of a contact lies in a cone of `directions` edges about the normal. Each step stays convex: it
is the associated form of Anitescu (doi 10.1007/s10107-005-0590-7), in which a contact that slips by s in a step opens
by friction times s. This vanishes as the rings come to rest, so that states of rest obey Coulomb's law itself.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from rve.common import Array, Flags, Index, Rows
from rve.geometry.contacts import CellContacts, find_contacts
from rve.geometry.pose import Pose, moved, reduction, start_pose
from rve.locking.system import Equations, lattice_load
from rve.simulation.dynamics import Dynamics

ROUND_OFF = 1e-13
"""Rise of the energy in s_hat r1^2 that counts as none: some twenty forces of order 1 times round-offs of a gap."""


@dataclass(frozen=True)
class CellMotion(Rows):
    """Rings in motion, or come to rest.

    row: in the result; s (n, 3): line load in s_hat, in weave axes; stage (n,): which load of its path a case is at;
    pose: in r1; contacts and their normal forces lam (n, p, SLOTS) in the last step, in s_hat r1, summed over the
    copies of a pair in the ten rings; v (n, m_full): ring velocities in r1/s and rad/s; h: next time step; time (n,):
    sum of h in s; steps, rejected (n,): accepted steps and those tried with too large h; R (n,) of the last step;
    lost (n,): energy lost by friction in s_hat r1^2; status (n,): "" under way, then "converged", "step-limit" or
    "time-step".
    """

    row: Index
    s: Array
    stage: Index
    pose: Pose
    contacts: CellContacts
    lam: Array
    v: Array
    h: Array
    time: Array
    steps: Index
    rejected: Index
    R: Array
    lost: Array
    status: NDArray[np.str_]


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


def advance(motion: CellMotion, dynamics: Dynamics) -> tuple[CellMotion, Flags, Array]:
    """Every case after a step of its length h under its load s, whether it is accepted, and the change of the energy,
    (n,) each.

    It is if contact and kinetic energy, less the work of the load, do not rise above round-off, links stay intact and
    no ring moves too far. Else the case stays where it is, for half the step.
    """
    options, equations = dynamics.options, dynamics.equations
    h, con, T, plain = motion.h, motion.contacts, dynamics.velocities(motion.pose), reduction(motion.pose)
    (n, _, m), c = plain.shape, con.present[0].size
    Tt, hh, load = T.transpose(0, 2, 1), h[:, None, None], lattice_load(motion.pose, motion.s)[0]
    k, gap = np.where(con.present, dynamics.stiffness[:, None], 0.0), np.where(con.present, con.gap, 0.0)
    G, bend = equations.gap_derivatives(motion.pose, con, plain, np.maximum(-k * gap, 0.0))
    A = np.matmul(Tt, np.matmul(dynamics.mass / hh**2 + dynamics.drag / hh, T))
    A[:, :m, :m] += geometric_stiffness(-bend, plain, equations) if options.curvature else 0.0
    force = np.matmul(motion.v[:, None, :], dynamics.mass)[:, 0] / h[:, None]
    force[:, :4] += load
    b = np.matmul(Tt, force[..., None])[..., 0]
    cone = G[:, :, None]
    if options.friction:
        tangential = np.einsum("jx,ncxm->ncjm", dynamics.polygon(), dynamics.slip(motion.pose, con, T))
        cone = tangential.copy()
        cone[..., :m] += G[:, :, None]
    w, beta, is_solved = solve_contact_step(A, b, cone, gap.reshape(n, c), k.reshape(n, c))
    v = np.matmul(T, w[..., None])[..., 0] / h[:, None]
    pose = moved(motion.pose, w[:, :m])
    contacts = find_contacts(pose, equations.weave, equations.wire, options.reach)
    way = np.concatenate([pose.a1 - motion.pose.a1, pose.a2 - motion.pose.a2], axis=1)
    rise = dynamics.energy(contacts, v) - dynamics.energy(con, motion.v) - (load * way).sum(axis=1)
    near = h * dynamics.largest_motion(v) <= options.largest_move
    good = is_solved & contacts.links_intact & (rise <= ROUND_OFF) & near
    lost = motion.lost - np.einsum("ncj,ncjm,nm->n", beta, tangential, w) if options.friction else motion.lost
    R, lam = dynamics.weighted_load(v, motion.v, h, load), beta.sum(axis=2).reshape(motion.lam.shape)
    after = replace(motion, pose=pose, contacts=contacts, lam=lam, v=v, R=R, lost=lost, time=motion.time + h)
    after = replace(after, h=np.minimum(options.h_max, options.restore * h), steps=motion.steps + 1)
    stay, rows = replace(motion, h=0.5 * h, rejected=motion.rejected + 1), np.flatnonzero(good)
    return stay.put(rows, after.take(rows)), good, rise


def solve_contact_step(A: Array, b: Array, cone: Array, gap: Array, k: Array) -> tuple[Array, Array, Flags]:
    """Displacements w (n, m) and forces beta (n, c, d) >= 0 of compliant contact over one step, and which are solved,
    (n,):

        A w = b + sum C_j^T beta_j,    0 <= beta_j  _|_  gap + C_j w + lam/k >= 0,    lam = sum_j beta_j,

    for A (n, m, m) positive definite, b (n, m), edges C of the cones of forces, `cone` (n, c, d, m), gap and stiffness
    k (n, c), 0 for slots without a contact. Without friction d is 1 and C the gradient of the gap. With A = L L^T the
    forces are where |L^-1 (b + sum C_j^T beta_j)|^2 + |lam/sqrt(k) + sqrt(k) gap|^2 is least.

    >>> one = np.ones((1, 1))
    >>> w, beta, _ = solve_contact_step(one[:, None], -2 * one, one[:, None, None], 0 * one, 3 * one)
    >>> print(w.round(9), beta.round(9))
    [[-0.5]] [[[1.5]]]
    """
    L, beta, is_solved = np.linalg.cholesky(A), np.zeros(cone.shape[:3]), np.ones(len(b), dtype=bool)
    rows = cone.reshape(len(b), -1, cone.shape[3])
    force, ways = np.linalg.solve(L, b[..., None])[..., 0], np.linalg.solve(L, rows.transpose(0, 2, 1))
    for i, used in enumerate(k > 0.0):
        root = np.sqrt(k[i, used])
        if not len(root):  # nnls takes no empty matrix
            continue
        try:
            compliance = np.repeat(np.diag(1.0 / root), cone.shape[2], axis=1)
            matrix = np.vstack([ways[i][:, np.repeat(used, cone.shape[2])], compliance])
            found = nnls(matrix, -np.concatenate([force[i], root * gap[i, used]]))[0]
            beta[i, used] = found.reshape(len(root), -1)
        except RuntimeError:  # its limit of iterations
            is_solved[i] = False
    balance = b + np.matmul(beta.reshape(len(b), 1, -1), rows)[:, 0]
    return np.linalg.solve(A, balance[..., None])[..., 0], beta, is_solved


def begin(s: Array, dynamics: Dynamics) -> CellMotion:
    """All cases at rest in the slack pose of the weave, under line loads s (n, 3) in s_hat."""
    n, equations, options = len(s), dynamics.equations, dynamics.options
    pose = start_pose(equations.weave, n)
    contacts = find_contacts(pose, equations.weave, equations.wire, options.reach)
    zero, none = np.zeros(n), np.zeros(n, dtype=int)
    v, lam = np.zeros((n, len(equations.mass))), np.zeros(contacts.gap.shape)
    h, R, status = np.full(n, options.h_max), np.full(n, np.inf), np.full(n, "", dtype="<U16")
    return CellMotion(np.arange(n), s, none, pose, contacts, lam, v, h, zero, none, none, R, zero, status)
