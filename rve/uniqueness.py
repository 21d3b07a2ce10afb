"""Where the load leaves the strain free: detection, and the limit from inside the tensile cone.

At beta = 0 and about 15 to 40 degrees of alpha the load only tightens one straight chain of rings; the rest of the cell
may move. Such a row gets the limit of the strain for a vanishing second principal load.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from rve.cell import Contacts, Pose, find_contacts, moved
from rve.equilibrium import DirectOptions, Equilibrium, solve_equilibrium
from rve.system import Equations, System

Array = NDArray[np.float64]

# Second principal load over the first: d, d/2 and d/4 extrapolate to zero with an error of third order. The next d is
# tried where one of the three solves fails (contacts may merge on the way).
_SMALL = (4e-3, 1e-3, 2e-3, 5e-4)
_WEIGHTS = np.array([1.0, -6.0, 8.0]) / 3.0


def strain_is_unique(equations: Equations, found: Equilibrium, s: Array, tolerance: float = 1e-8) -> NDArray[np.bool_]:
    """Whether the strain of each equilibrium is isolated, (n,): False where a mode without stiffness moves the lattice.

    Modes are the directions that keep every loaded contact closed; their stiffness is the reduced Jacobian, in units of
    s r1^2. A mode that moves only rings inside the cell leaves the strain unique.
    """
    system = equations.assemble(found.pose, found.contacts, found.lam, s)
    unique = np.ones(len(s), dtype=bool)
    loaded = (found.lam > 1e-6) & found.contacts.present
    for i in np.flatnonzero(found.status == "converged"):
        G = system.G[i][loaded[i].ravel()]
        _, sizes, V = np.linalg.svd(G)
        modes = V[np.count_nonzero(sizes > 1e-7) :].T
        if not modes.shape[1]:
            continue
        stiffness = -modes.T @ (0.5 * (system.J[i] + system.J[i].T)) @ modes
        values, vectors = np.linalg.eigh(stiffness)
        free = modes @ vectors[:, values < tolerance]
        unique[i] = not np.any(np.abs(free[:3]) > 1e-6)
    return unique


def _inward(s: Array, size: float) -> Array:
    """Line loads with the smaller principal value raised by `size` times the larger one."""
    mean, half = 0.5 * (s[:, 0] + s[:, 2]), 0.5 * (s[:, 0] - s[:, 2])
    radius = np.hypot(half, s[:, 1])
    n1 = np.stack([radius + half, s[:, 1], radius - half], axis=1) / np.maximum(2.0 * radius, 1e-300)[:, None]
    return s + size * (mean + radius)[:, None] * (np.array([1.0, 0.0, 1.0]) - n1)


def limit_equilibrium(s: Array, equations: Equations, size: float, options: DirectOptions) -> Equilibrium:
    """Equilibria under the uniaxial loads s (n, 3): limits from the second principal loads size, size/2 and size/4.

    Status "no-limit" where one of the three did not converge, or their extrapolation is no equilibrium.
    """
    n = len(s)
    loads = np.concatenate([_inward(s, size / part) for part in (1.0, 2.0, 4.0)])
    found = solve_equilibrium(loads, equations, options)
    parts = [found.pose.take(np.arange(k * n, (k + 1) * n)) for k in range(3)]
    lattice, centres, normals = (
        np.einsum("k,k...->...", _WEIGHTS, np.stack([getattr(part, name) for part in parts]))
        for name in ("lattice", "centres", "normals")
    )
    normals = normals / np.linalg.norm(normals, axis=2, keepdims=True)
    pose, lam, contacts, R = polish(Pose(lattice, centres, normals), equations, s, options)
    ok = (found.status == "converged").reshape(3, n).all(axis=0) & (R < 1e-9) & (contacts.min_gap > -1e-10)
    return Equilibrium(
        pose,
        lam,
        contacts,
        R,
        found.iterations.reshape(3, n).sum(axis=0),
        np.where(ok, "converged", "no-limit"),
        found.attempts.reshape(3, n).max(axis=0),
    )


def touching(contacts: Contacts, reach: float) -> NDArray[np.bool_]:
    """Contacts whose gap is below `reach`, (n, p, SLOTS)."""
    return contacts.present & (contacts.gap < reach)


def contact_forces(system: System, active: NDArray[np.bool_]) -> Array:
    """Forces >= 0 of the active contacts (n, c) that balance the load best, in the norm of the mass matrix."""
    lam = np.zeros(active.shape)
    for i, rows in enumerate(active):
        if rows.any():
            root = np.linalg.cholesky(np.linalg.inv(system.M[i])).T
            lam[i, rows] = nnls(root @ system.G[i][rows].T, -root @ system.f[i])[0]
    return lam


def polish(
    pose: Pose, equations: Equations, s: Array, options: DirectOptions, reach: float = 1e-5, steps: int = 4
) -> tuple[Pose, Array, Contacts, Array]:
    """Newton on r = 0 and gap = 0 of all touching contacts; least-norm steps, so that a free mode stays where it is.

    Returns pose, forces (n, p, SLOTS), contacts and weighted residual R (n,). Converges quadratically from a pose near
    an equilibrium whose touching contacts are known (tests/test_rve/test_equilibrium.py).
    """
    lam = np.zeros(())
    for step in range(steps + 1):
        contacts = find_contacts(pose, equations.weave, equations.wire, options.reach)
        active = touching(contacts, reach)
        flat = active.reshape(len(s), -1)
        lam = np.zeros(contacts.gap.shape)
        bare = equations.assemble(pose, contacts, lam, s)
        lam = contact_forces(bare, flat).reshape(contacts.gap.shape)
        system = equations.assemble(pose, contacts, lam, s)
        if step == steps:
            break
        dq = np.zeros(system.r.shape)
        for i, rows in enumerate(flat):
            G = system.G[i][rows]
            size = len(G)
            A = np.block([[system.J[i], G.T], [G, np.zeros((size, size))]])
            b = -np.concatenate([system.r[i], contacts.gap[i].ravel()[rows]])
            dq[i] = np.linalg.lstsq(A, b, rcond=1e-9)[0][: len(dq[i])]
        pose = moved(pose, np.clip(dq, -1e-3, 1e-3))
    return pose, lam, contacts, system.weighted_residual


def with_limits(
    s: Array, equations: Equations, found: Equilibrium, options: DirectOptions
) -> tuple[Equilibrium, NDArray[np.bool_]]:
    """Equilibria with non-unique rows replaced by their limits, and the flags `unique` (n,).

    A row whose limit cannot be found keeps one of its equilibria and gets the status "no-limit".
    """
    unique = strain_is_unique(equations, found, s)
    left = np.flatnonzero(~unique)
    if not len(left):
        return found, unique
    quick = replace(options, attempts=1)
    found = replace(found, status=np.where(unique, found.status, "no-limit"))
    for size in _SMALL:
        limit = limit_equilibrium(s[left], equations, size, quick)
        good = np.flatnonzero(limit.status == "converged")
        found = found.put(left[good], limit.take(good))
        left = np.delete(left, good)
        if not len(left):
            break
    return found, unique
