"""Where the load leaves the strain free: detection, and the limit from inside the tensile cone.

At beta = 0 and about 15 to 40 degrees of alpha the load only tightens one straight chain of rings.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.optimize import nnls

from rve.common import Array, Flags
from rve.common.tensor import IDENTITY, eigenvalues
from rve.geometry.contacts import CellContacts
from rve.geometry.pose import Pose
from rve.locking.interior_point import DirectOptions, Equilibrium, solve_equilibrium
from rve.locking.system import Equations, System

_ON_WAY, _LAST = (1.6e-2, 4e-3, 1e-3), (1e-3, 5e-4, 2.5e-4)
"""Second principal loads over the first, by which the limit is approached, and from which it is extrapolated."""
TOUCHING = 1e-6
"""Gap in r1 below which a contact may carry force in a locked state; working ones end at 1e-13 over their force."""
SOFT = 1e-8
"""A stiffness below this, in s r1^2, is none to round-off."""
_WEIGHTS = np.array([1.0, -6.0, 8.0]) / 3.0
"""Extrapolate values at d, d/2 and d/4 to zero with an error of third order."""


def strain_is_unique(equations: Equations, found: Equilibrium, s: Array) -> Flags:
    """Whether the strain of each equilibrium is isolated, (n,): no mode without stiffness moves the lattice."""
    unique = np.ones(len(s), dtype=bool)
    for i, stiffness, motions in loose_motions(equations, found, s):
        unique[i] = not np.any(np.abs(equations.modes[:3] @ motions[:, stiffness < SOFT]) > 1e-6)
    return unique


def loose_motions(equations: Equations, found: Equilibrium, s: Array) -> Iterator[tuple[int, Array, Array]]:
    """For every converged case that is not held by its loaded contacts alone: its number, the stiffnesses (k,) in
    s r1^2, and the motions (m, k) that keep these contacts closed.
    """
    system = equations.assemble(found.pose, found.contacts, found.lam, s)
    loaded = (found.lam > 1e-6) & found.contacts.present
    for i in np.flatnonzero(found.status == "converged"):
        G = system.G[i][loaded[i].ravel()]
        _, sizes, V = np.linalg.svd(G)
        modes = V[np.count_nonzero(sizes > 1e-7) :].T
        if modes.shape[1]:
            values, vectors = np.linalg.eigh(-modes.T @ (0.5 * (system.J[i] + system.J[i].T)) @ modes)
            yield int(i), values, modes @ vectors


def limit_equilibrium(s: Array, equations: Equations, options: DirectOptions) -> Equilibrium:
    """Equilibria under the loads s (n, 3) that are limits for a vanishing addition to the second principal load.

    Paths for decreasing additions come first, each started from the one before and stopped at complementarity 1e-3 of
    the addition, where gaps are still open. The equilibria of the last three additions are extrapolated, and every pair
    of rings is closed that carries more than 1e-3 of the last one in it. Status "no-limit" where Newton's method does
    not confirm that.
    """
    low, high = eigenvalues(s)
    inward = (high / np.maximum(high - low, 1e-300))[:, None] * (high[:, None] * IDENTITY - s)
    start, early, iterations = None, replace(options, attempts=1), np.zeros(len(s), dtype=int)
    for size in _ON_WAY:
        mu = 1e-3 * size
        path = solve_equilibrium(s + size * inward, equations, replace(early, mu_end=mu, tolerance=mu), start)
        start, early = path.pose, replace(early, mu_start=4.0 * mu)
        iterations += path.iterations
    loads = np.concatenate([s + size * inward for size in _LAST])
    exact = replace(options, attempts=1, mu_start=1e-3 * _LAST[0])
    ends = solve_equilibrium(loads, equations, exact, path.pose.take(np.tile(np.arange(len(s)), 3)))
    three = [ends.take(part) for part in np.arange(3 * len(s)).reshape(3, -1)]
    lattice, centres, normals = (
        np.einsum("k,k...->...", _WEIGHTS, np.stack([getattr(part.pose, name) for part in three]))
        for name in ("lattice", "centres", "normals")
    )
    guess = Pose(lattice, centres, normals / np.linalg.norm(normals, axis=2, keepdims=True))
    contacts, found = equations.contacts(guess), three[-1]
    loaded = ((found.lam > 1e-3 * _LAST[-1]) & found.contacts.present).sum(axis=2)
    gaps = np.sort(np.where(contacts.present, contacts.gap, np.inf), axis=2)
    last = np.take_along_axis(gaps, np.maximum(loaded - 1, 0)[..., None], axis=2)[..., 0]
    widest = np.where((loaded > 0) & np.isfinite(last), np.abs(last), 0.0).max(axis=1)
    end = polish(polish(guess, equations, s, 1.5 * widest + 1e-6).pose, equations, s)
    # Newton's steps may drift along the free mode: then the guess was too far away. Gaps under small forces are 1e-9.
    change = np.abs(found.pose.lattice - three[-2].pose.lattice).max(axis=1)
    stays = np.abs(end.pose.lattice - guess.lattice).max(axis=1) < np.maximum(0.5 * change, 1e-8)
    known = np.all([part.status == "converged" for part in three], axis=0)
    status = np.where(known & (end.status == "converged") & stays, "converged", "no-limit").astype("<U16")
    iterations += np.sum([part.iterations for part in three], axis=0)
    return replace(end, iterations=iterations, status=status, attempts=found.attempts)


def touching(contacts: CellContacts, reach: float | Array) -> Flags:
    """Contacts whose gap is below `reach`, one number or one per case, (n, p, SLOTS)."""
    return contacts.present & (contacts.gap < np.reshape(reach, (-1, 1, 1)))


def contact_forces(
    pose: Pose, contacts: CellContacts, equations: Equations, s: Array, reach: float | Array
) -> tuple[Array, System]:
    """Forces (n, p, SLOTS) >= 0 of the contacts with gaps below `reach` that balance the load best, in the norm of the
    mass matrix; the equations with them."""
    active, lam = touching(contacts, reach), np.zeros(contacts.gap.shape)
    bare = equations.assemble(pose, contacts, lam, s)
    for i, rows in enumerate(active.reshape(len(s), -1)):
        if rows.any():
            root = np.linalg.cholesky(np.linalg.inv(bare.M[i])).T
            lam[i][active[i]] = nnls(root @ bare.G[i][rows].T, -root @ bare.f[i])[0]
    return lam, equations.assemble(pose, contacts, lam, s)


def shortest(G: Array, h: Array) -> Array | None:
    """The shortest x (m,) with G x >= h for G (c, m), by least distance programming (Lawson and Hanson, ch. 23)."""
    A, last = np.vstack([G.T, h]), np.eye(G.shape[1] + 1)[-1]
    r = A @ nnls(A, last)[0] - last
    return -r[:-1] / r[-1] if r[-1] < -1e-12 else None


def balanced(pose: Pose, s: Array, equations: Equations, reach: float | Array = TOUCHING) -> Equilibrium:
    """Locked poses as equilibria under the loads s (n, 3), with nonnegative forces of contacts with gaps below `reach`
    that balance every ring in space."""
    contacts, none = equations.contacts(pose), np.zeros(len(s), dtype=int)
    lam, system = contact_forces(pose, contacts, equations, s, reach)
    status = np.full(len(s), "converged", dtype="<U16")
    return Equilibrium(pose, lam, contacts, system.weighted_residual, none, status, none, pose)


def polish(pose: Pose, equations: Equations, s: Array, reach: float | Array = 1e-5, steps: int = 4) -> Equilibrium:
    """Newton on r = 0 and gap = 0 of all contacts with gaps below `reach`, from poses near equilibria; least-norm
    steps, so that a free mode stays where it is. Status "stalled" where that is no equilibrium."""
    for _ in range(steps):
        contacts = equations.contacts(pose)
        _, system = contact_forces(pose, contacts, equations, s, reach)
        dq = np.zeros(system.r.shape)
        for i, rows in enumerate(touching(contacts, reach).reshape(len(s), -1)):
            G = system.G[i][rows]
            size = len(G)
            A = np.block([[system.J[i], G.T], [G, np.zeros((size, size))]])
            b = -np.concatenate([system.r[i], contacts.gap[i].ravel()[rows]])
            dq[i] = np.linalg.lstsq(A, b, rcond=1e-9)[0][: len(dq[i])]
        pose = equations.moved(pose, np.clip(dq, -1e-2, 1e-2))
    end = balanced(pose, s, equations, reach)
    ok = (end.R < 1e-9) & (end.contacts.min_gap > -1e-10) & end.contacts.links_intact
    return replace(end, status=np.where(ok, "converged", "stalled").astype("<U16"))


def with_limits(
    s: Array, equations: Equations, found: Equilibrium, options: DirectOptions
) -> tuple[Equilibrium, Flags]:
    """Equilibria with non-unique rows, and stalled ones of nearly uniaxial loads, replaced by their limits; the flags
    `unique` (n,). A row without a limit keeps its equilibrium and gets the status "no-limit".
    """
    unique = strain_is_unique(equations, found, s)
    slender = np.abs(s[:, 0] * s[:, 2] - s[:, 1] ** 2) < _ON_WAY[0] * (s[:, 0] + s[:, 2]) ** 2
    stalled = (found.status == "stalled") & slender
    rows = np.flatnonzero(~unique | stalled)
    if not len(rows):
        return found, unique
    limit = limit_equilibrium(s[rows], equations, options)
    good = limit.status == "converged"
    found = replace(found, status=np.where(unique, found.status, "no-limit").astype("<U16"))
    found = found.put(rows[good], limit.take(np.flatnonzero(good)))
    reached = rows[good & stalled[rows]]
    unique[reached] = strain_is_unique(equations, found.take(reached), s[reached])
    return found, unique
