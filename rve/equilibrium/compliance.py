"""Finite contact stiffness: equilibrium, rigid limit by extrapolation, and the locking compliance dE/dS.

A contact of stiffness k lets rings overlap: gap + lam/k = 0 where lam > 0. In units of r1 and of the size s_hat of the
line load only the ratio kappa = k/s_hat counts (k and s_hat both in N/mm): penetrations are lam/kappa, and strains
differ from the rigid ones by a multiple of 1/kappa. Each contact is counted once per primitive cell.

The locking compliance of a unit load is D(kappa) = dE/dS at constant k, a 3 x 3 matrix of tensor components (11, 12,
22): dE_i = sum_j D_ij dS_j. At s_hat N/mm and k N/mm the compliance in mm/N is D(k/s_hat)/s_hat. Since the contact
energy is a potential, diag(1, 2, 1) D is symmetric. D has a rigid limit, the curvature of the locking surface, with D
S = 0; the stretch along S itself, D S, is proportional to 1/kappa.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rve.common.records import Flags, Index, Rows
from rve.common.types import Array
from rve.common.values import Options, number, whole
from rve.equilibrium.contact_qp import Programme, solve_contact_step
from rve.equilibrium.interior_point import Equilibrium, carry_forces
from rve.equilibrium.system import Equations, System, lattice_load
from rve.geometry.contacts import Contacts, find_contacts
from rve.geometry.kinematics import lattice_strain, second_pk
from rve.geometry.pose import Pose, deformation, moved, reduction

_CONVEX, _STIFF = 1e-4, 1e6
"""Least curvature and largest stiffness of the quadratic programme that finds the loaded contacts."""


@dataclass(frozen=True)
class CompliantOptions(Options):
    """Options of `soften`; InputError for senseless values.

    tolerance: weighted residual R at which a stage has converged; reach: contacts with a larger gap in r1 are ignored.
    step: largest coordinate change per iteration; max_iterations: per stage.
    start: ratio kappa of the first stage, which starts from the rigid pose; factor: between stages, smaller is safer.
    """

    tolerance: float = number(1e-11, above=0.0, most=1.0)
    reach: float = number(0.1, above=0.0, most=10.0)
    step: float = number(0.05, above=0.0, most=0.5)
    start: float = number(1e10, above=0.0)
    factor: float = number(10.0, above=1.0, most=1e6)
    max_iterations: int = whole(40, least=1, most=1_000_000)


@dataclass(frozen=True)
class SoftEquilibrium(Rows):
    """Equilibria at finite contact stiffness.

    pose (n cases, in r1), contacts and lam (n, p, SLOTS) in s_hat r1; R (n,); iterations (n,): of all stages; status
    (n,) "converged" or "stalled"; compliance (n, 3, 3): D for a unit line load, nan where there is none.
    """

    pose: Pose
    contacts: Contacts
    lam: Array
    R: Array
    iterations: Index
    status: NDArray[np.str_]
    compliance: Array


def _bordered(system: System, active: Flags, flexibility: Array) -> Array:
    """Matrices [[-J, -G^T], [G, 1/kappa]] (n, m + c, m + c) on the active contacts, identity rows elsewhere."""
    n, m = system.r.shape
    G = np.where(active[..., None], system.G, 0.0)
    size = m + active.shape[1]
    K = np.zeros((n, size, size))
    K[:, :m, :m] = -system.J
    K[:, :m, m:] = -G.transpose(0, 2, 1)
    K[:, m:, :m] = G
    at = np.arange(m, size)
    K[:, at, at] = np.where(active, flexibility, 1.0)
    return K


def _columns(present: Flags) -> Index:
    """Slots of the contacts of each case, padded by empty ones, (n, c)."""
    count = int(present.sum(axis=1).max(initial=1))
    return np.argsort(~present, axis=1, kind="stable")[:, :count]


@dataclass(frozen=True)
class _Slots(Rows):
    """Contacts of a batch packed into c columns: their slots, gaps, forces, 1/kappa, and which are pressed."""

    slot: Index
    system: System
    gap: Array
    lam: Array
    flexibility: Array
    active: Flags


def _packed(equations: Equations, soft: SoftEquilibrium, s: Array, kappa: Array) -> _Slots:
    con = soft.contacts
    n = len(s)
    present = con.present.reshape(n, -1)
    slot = _columns(present)
    system = equations.assemble(soft.pose, con, soft.lam, s)
    system = replace(system, G=np.take_along_axis(system.G, slot[..., None], axis=1))
    there = np.take_along_axis(present, slot, axis=1)
    gap = np.where(there, np.take_along_axis(con.gap.reshape(n, -1), slot, axis=1), 1.0)
    lam = np.take_along_axis(soft.lam.reshape(n, -1), slot, axis=1)
    flexibility = 1.0 / np.repeat(kappa, con.gap.shape[2])[slot]
    return _Slots(slot, system, gap, lam, flexibility, _pressed(system, there, gap, flexibility))


def _pressed(system: System, there: Flags, gap: Array, flexibility: Array) -> Flags:
    """Which contacts carry a force after the next step: those of a convex quadratic programme near the equations.

    A step that changes one set of contacts for another by the signs of gaps and forces alone cycles at vertices, where
    more contacts touch than the cell has coordinates.
    """
    value, vector = np.linalg.eigh(-0.5 * (system.J + system.J.transpose(0, 2, 1)))
    A = np.matmul(vector * np.maximum(value, _CONVEX)[:, None, :], vector.transpose(0, 2, 1))
    k = np.where(there, 1.0 / np.maximum(flexibility, 1.0 / _STIFF), 0.0)
    return solve_contact_step(Programme(A, system.f, system.G, gap, k)).lam > 0.0


def _iterated(
    equations: Equations, soft: SoftEquilibrium, s: Array, kappa: Array, options: CompliantOptions
) -> tuple[SoftEquilibrium, Flags]:
    """One Newton step of each case, and which had converged before it."""
    n = len(s)
    k = _packed(equations, soft, s, kappa)
    off = np.where(k.active, np.abs(k.gap + k.lam * k.flexibility), np.where(k.lam > 0.0, np.inf, 0.0)).max(axis=1)
    R = k.system.weighted_residual
    done = (options.tolerance > R) & (off <= 1e-14)
    rest = np.where(k.active, -(k.gap + k.lam * k.flexibility), -k.lam)
    K = _bordered(k.system, k.active, k.flexibility)
    x = np.linalg.solve(K, np.concatenate([k.system.r, rest], axis=1)[..., None])[..., 0]
    m = k.system.r.shape[1]
    length = np.minimum(1.0, options.step / np.maximum(np.abs(x[:, :m]).max(axis=1), 1e-300))
    length[done] = 0.0
    pose = moved(soft.pose, length[:, None] * x[:, :m])
    lam = np.zeros(soft.lam.reshape(n, -1).shape)
    np.put_along_axis(lam, k.slot, np.maximum(k.lam + length[:, None] * x[:, m:], 0.0), axis=1)
    contacts = find_contacts(pose, equations.weave, equations.wire, options.reach)
    lam = _carried(soft.contacts, lam.reshape(soft.lam.shape), contacts)
    return replace(soft, pose=pose, contacts=contacts, lam=lam, R=R, iterations=soft.iterations + ~done), done


def _carried(old: Contacts, lam: Array, new: Contacts) -> Array:
    """Forces at the new contacts of each pair; a contact without a force has none, not the barrier's smallest."""
    out = carry_forces(old, lam, new, np.zeros(len(lam)))
    return np.where(out > 1e-15, out, 0.0)


def soften(
    found: Equilibrium,
    s: Array,
    equations: Equations,
    kappa: float | Array,
    reference: tuple[float, float],
    options: CompliantOptions = CompliantOptions(),
) -> SoftEquilibrium:
    """Equilibria at the stiffness ratio kappa = k/s_hat near the rigid ones `found`, with their compliances.

    s (n, 3): line loads of any size; kappa: one number, or one for each pair of rings (p,); reference: sides b_x, b_y
    of the undeformed cell in r1. Newton's method on a ladder of ratios from the rigid limit down to kappa. Cases that
    are not converged in `found`, or are not found again, have the status "stalled" and no compliance.
    """
    s = s / np.sqrt(s[:, :1] ** 2 + 2.0 * s[:, 1:2] ** 2 + s[:, 2:] ** 2)
    target = np.broadcast_to(np.asarray(kappa, dtype=float), (len(equations.weave.pairs),))
    contacts = find_contacts(found.pose, equations.weave, equations.wire, options.reach)
    n = len(s)
    lam, R, iterations = _carried(found.contacts, found.lam, contacts), np.full(n, np.nan), np.zeros(n, dtype=int)
    soft = SoftEquilibrium(found.pose, contacts, lam, R, iterations, found.status, np.full((n, 3, 3), np.nan))
    stages = max(0, int(np.ceil(np.log(options.start / target.min()) / np.log(options.factor))))
    for stage in range(stages, -1, -1):
        soft = _stage(equations, soft, s, target * options.factor**stage, options)
    good = np.flatnonzero(soft.status == "converged")
    if not len(good):
        return soft
    part = soft.take(good)
    return soft.put(good, replace(part, compliance=locking_compliance(equations, part, s[good], target, reference)))


def _stage(
    equations: Equations, soft: SoftEquilibrium, s: Array, kappa: Array, options: CompliantOptions
) -> SoftEquilibrium:
    """Newton's method at one stiffness for the cases that converged in the stage before."""
    rows = np.flatnonzero(soft.status == "converged")
    part = soft.take(rows)
    done = np.zeros(len(rows), dtype=bool)
    for _ in range(options.max_iterations):
        if done.all():
            break
        part, done = _iterated(equations, part, s[rows], kappa, options)
    status = np.where(done, "converged", "stalled").astype(soft.status.dtype)
    return soft.put(rows, replace(part, status=status))


def locking_compliance(
    equations: Equations, soft: SoftEquilibrium, s: Array, kappa: Array, reference: tuple[float, float]
) -> Array:
    """D = dE/dS (n, 3, 3) at constant contact stiffness by implicit differentiation of the equilibrium.

    From J dq + G^T dlam + (df/ds) ds = 0 and G dq + dlam/kappa = 0 follow dE/ds and, with F S F^T = det(F) s, dS/ds.
    nan where the equilibrium is not isolated.
    """
    k = _packed(equations, soft, s, kappa)
    n, m = k.system.r.shape
    T = reduction(soft.pose)
    df = np.stack(
        [np.einsum("ni,nij->nj", lattice_load(soft.pose, np.tile(e, (n, 1)))[0], T[:, :4]) for e in np.eye(3)], axis=2
    )
    K = _bordered(k.system, k.active, k.flexibility)
    # Whether a mode is free does not depend on the stiffness; a moderate one keeps round-off out of the answer.
    moderate = np.where(k.active, np.minimum(1.0 / k.flexibility, 1e4), 0.0)
    G = k.system.G
    condensed = np.matmul(G.transpose(0, 2, 1) * moderate[:, None, :], G) - k.system.J
    free = np.abs(np.linalg.eigvals(condensed)).min(axis=1) < 1e-9
    K[free] = np.eye(K.shape[1])
    dq = np.linalg.solve(K, np.concatenate([df, np.zeros((n, K.shape[1] - m, 3))], axis=1))[:, :m]
    F = deformation(soft.pose, reference)
    dF = np.einsum("nxym,nmj->nxyj", _gradient_of_F(soft.pose, reference), dq[:, :3])
    D = lattice_strain(soft.pose.lattice, reference)[1] @ dq[:, :3] @ np.linalg.inv(_pk_derivative(F, dF, s))
    D[free] = np.nan
    return D


def _triples(tensor: Array) -> Array:
    return np.stack([tensor[:, 0, 0], tensor[:, 0, 1], tensor[:, 1, 1]], axis=1)


def _gradient_of_F(pose: Pose, reference: tuple[float, float]) -> Array:
    """Derivative of F with respect to x2, y3, t, (n, 2, 2, 3)."""
    x2, y3, t = pose.lattice.T
    out = np.zeros((len(x2), 2, 2, 3))
    out[:, 0, 0, 0], out[:, 1, 0, 0], out[:, 1, 0, 2] = 1.0, t, x2
    out[:, 1, 1, 1], out[:, 0, 1, 1], out[:, 0, 1, 2] = 1.0, t, y3
    return out / np.asarray(reference)[None, None, :, None]


def _pk_derivative(F: Array, dF: Array, s: Array) -> Array:
    """dS/ds (n, 3, 3) for F that moves by dF (n, 2, 2, 3): dS = F^-1 (J ds + dJ s) F^-T - F^-1 dF S - (F^-1 dF S)^T."""
    n = len(s)
    inverse = np.linalg.inv(F)
    triple = second_pk(F, s)
    S = np.stack([triple[:, [0, 1]], triple[:, [1, 2]]], axis=1)
    turn = np.einsum("nxk,nkyj->nxyj", inverse, dF)
    dJ_over_J = np.einsum("nxxj->nj", turn)
    back = np.einsum("nxkj,nky->nxyj", turn, S)
    direct = np.stack([second_pk(F, np.tile(e, (n, 1))) for e in np.eye(3)], axis=2)
    return direct + triple[:, :, None] * dJ_over_J[:, None, :] - _triples(back + back.transpose(0, 2, 1, 3))
