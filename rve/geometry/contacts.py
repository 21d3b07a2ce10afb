"""Contacts of a pose: those of all pairs of rings of a cell, and the exact derivatives of their distances."""

from dataclasses import dataclass, replace
from itertools import combinations_with_replacement, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rve.common import Array, Flags, Rows
from rve.geometry.pattern import Pattern
from rve.geometry.pose import Pose, pair_geometry
from rve.geometry.ring_pair import Minima, are_linked, cross, dot, local_minima, norm, tangent_frame

SLOTS = 2  # minima kept per pair of rings, the lowest two: linked rings have no more
SHELL = 4
"""Primitive cells on every side among which unlisted pairs are looked for."""


@dataclass(frozen=True)
class CellContacts(Rows):
    """Contacts of n cases, pair by pair and slot by slot; entries of empty slots have no meaning unless stated.

    present (n, p, SLOTS): which slots hold a contact; gap (n, p, SLOTS) in units of r1, inf where empty; distance of
    the centre circles and curvature (n, p, SLOTS), see `Minima`; rho, rho_b (n, p, SLOTS, 3): points relative to the
    centres of ring a and ring b; normal (n, p, SLOTS, 3): from a to b; links_intact (n,).
    """

    present: Flags
    gap: Array
    distance: Array
    curvature: Array
    rho: Array
    rho_b: Array
    normal: Array
    links_intact: Flags

    @property
    def minima(self) -> Minima:
        """The m contacts in the order of np.nonzero(present); `pair` is case * p + pair."""
        at = np.flatnonzero(self.present)
        normal, rho, rho_b = (rows.reshape(-1, 3)[at] for rows in (self.normal, self.rho, self.rho_b))
        return Minima(at // SLOTS, normal, rho, rho_b, self.distance.ravel()[at], self.curvature.ravel()[at])

    @property
    def min_gap(self) -> Array:
        """Smallest gap of each case, (n,), inf where no pair is near."""
        return np.asarray(self.gap.reshape(len(self.gap), -1).min(axis=1, initial=np.inf))


def find_contacts(pose: Pose, weave: Pattern, wire: float, reach: float) -> CellContacts:
    """Every contact of every case whose gap is below `reach` (in r1), and whether links are intact; wire = r2/r1."""
    circles, (ra, rb), wires = pair_geometry(pose, weave), weave.pair_radii, wire * weave.pair_wires
    n, p = len(pose.lattice), len(weave.pairs)
    near = np.flatnonzero(can_touch(circles[0], ra + rb + wires + reach))
    pair = near % p
    radii, d, na, nb = (ra[pair], rb[pair]), *(x.reshape(-1, 3)[near] for x in circles)
    found = local_minima(d, na, nb, radii, reach=wires[pair] + reach)
    rank = np.zeros(len(found.pair), dtype=int)
    for back in range(1, SLOTS + 1):
        rank[back:] += found.pair[back:] == found.pair[:-back]
    found = found.take(rank < SLOTS)
    slot = near[found.pair] * SLOTS + rank[rank < SLOTS]

    gap = found.distance - wires[pair[found.pair]]

    def slots(values: NDArray[Any], empty: Any) -> NDArray[Any]:
        out = np.full((n * p * SLOTS, *values.shape[1:]), empty, dtype=values.dtype)
        out[slot] = values
        return out.reshape(n, p, SLOTS, *values.shape[1:])

    return CellContacts(
        slots(np.ones(len(slot), dtype=bool), False),
        slots(gap, np.inf),
        slots(found.distance, np.inf),
        slots(found.curvature, 0.0),
        slots(found.rho_a, 0.0),
        slots(found.rho_b, 0.0),
        slots(found.normal, 0.0),
        (are_linked(*circles, (ra, rb)) == weave.linked).all(axis=1),
    )


def can_touch(d: Array, limit: Array | float) -> Flags:
    """Whether offsets d (..., 3) are below `limit`, the sum of two radii and of the distance looked for."""
    return np.asarray(dot(d, d) < limit**2)


def parallel_clearance(before: Pose, after: Pose, weave: Pattern, wire: float, samples: int = 12) -> Array:
    """Smallest gap (n,) of parallel rings, those of one class, on the straight way between two poses, ends left out.

    They can pass through each other at two points at once, which no linking number tells. With height h and in-plane
    offset rho their distance is |h| where the projections cross (rho <= 2 a), and hypot(rho - 2 a, h) outside. Of
    wires with another radius than r2 the distance counts in proportion.
    """
    same = weave.pairs[:, 0] == weave.pairs[:, 1]
    (d0, n0, _), (d1, n1, _) = pair_geometry(before, weave), pair_geometry(after, weave)
    t = (np.arange(1, samples) / samples)[:, None, None, None]
    d, n = ((1.0 - t) * x[:, same] + t * y[:, same] for x, y in ((d0, d1), (n0, n1)))
    h = dot(d, n) / norm(n)
    rho = np.sqrt(np.maximum(dot(d, d) - h**2, 0.0))
    a, b = (radius[same] for radius in weave.pair_radii)
    distance = np.where(rho <= a + b, np.abs(h), np.hypot(rho - a - b, h)) * (2.0 / weave.pair_wires[same])
    return np.asarray(distance.min(axis=(0, 2), initial=np.inf) - 2.0 * wire)


def unlisted_pairs(weave: Pattern) -> Pattern:
    """The weave with only the pairs that it does not list, each once, up to `SHELL` primitive cells apart."""
    listed = {tuple(pair) for pair in weave.pairs.tolist()}
    listed |= {(b, a, -i, -j) for a, b, i, j in listed}
    nx, ny = (-(-SHELL // count) for count in weave.repeat)
    shifts = list(product(range(-nx, nx + 1), range(-ny, ny + 1)))
    every = [(a, b, *shift) for a, b in combinations_with_replacement(range(weave.classes), 2) for shift in shifts]
    found = [(a, b, i, j) for a, b, i, j in every if (a, b, i, j) not in listed and (a < b or (i, j) > (0, 0))]
    return replace(weave, pairs=np.array(found, dtype=int).reshape(-1, 4), linked=np.zeros(len(found), dtype=bool))


def unlisted_gap(pose: Pose, weave: Pattern, wire: float) -> Array:
    """Smallest gap (n,) of unlisted pairs in r1, or a lower bound of it where their centres are too far apart."""
    rest = unlisted_pairs(weave)
    d, _, _ = pair_geometry(pose, rest)
    reach = sum(rest.pair_radii) + wire * rest.pair_wires
    bound = (np.sqrt((d**2).sum(axis=2)) - reach).min(axis=1, initial=np.inf)
    near = np.flatnonzero(can_touch(d, reach).any(axis=1))
    if len(near):
        bound[near] = find_contacts(pose.take(near), rest, wire, np.inf).min_gap
    return np.asarray(bound)


def distance_gradient(m: Minima) -> Array:
    """Derivative of the distance with respect to (d, theta_a, theta_b), (m, 9), theta being rotation vectors in space:
    dD = u . dd - (rho_a x u) . dtheta_a + (rho_b x u) . dtheta_b. Units 1 and r1 (per radian).
    """
    return np.concatenate([m.normal, -cross(m.rho_a, m.normal), cross(m.rho_b, m.normal)], axis=1)


def slip_gradient(m: Minima, n_a: Array, r_a: float | Array, r_b: float | Array) -> Array:
    """Slip of ring b on ring a at a contact with respect to (d, theta_a, theta_b), (m, 2, 9): along the wire of ring a,
    n_a x rho_a, and around it; n_a (m, 3): normals of rings a; r_a, r_b: radii of the wires in r1.

    With t normal to u and the points p_a = rho_a + r_a u, p_b = rho_b - r_b u of the two skins:
    slip = t . dd - (p_a x t) . dtheta_a + (p_b x t) . dtheta_b. Units 1 and r1 (per radian).
    """
    u = m.normal
    along = cross(n_a, m.rho_a)
    along -= dot(along, u)[:, None] * u  # of a minimum it is normal to u already, to round-off
    along /= norm(along)[:, None]
    t = np.stack([along, cross(u, along)], axis=1)
    p_a, p_b = m.rho_a + np.reshape(r_a, (-1, 1)) * u, m.rho_b - np.reshape(r_b, (-1, 1)) * u
    return np.concatenate([t, -cross(p_a[:, None], t), cross(p_b[:, None], t)], axis=2)


def distance_forms(m: Minima, n_a: Array, n_b: Array) -> tuple[Array, Array]:
    """Rows X (m, 7, 9) and weights w (m, 6). The first derivative of the distance with respect to (d, theta_a,
    theta_b), exponential coordinates, is X_0; the second one sum w_k X_k^T X_k, k = 1 ... 6, if no ring spins about
    its axis.

    n_a, n_b (m, 3): normals of the rings. With q = (d, theta) and the two angles phi that place the points,
    H = D_qq - D_qphi D_phiphi^-1 D_phiq. The determinant of D_phiphi, which vanishes with the minimum, is kept above
    1e-10 of its scale.
    """
    u, ra, rb, dist = m.normal, m.rho_a, m.rho_b, m.distance
    ta, tb, X = cross(n_a, ra), cross(n_b, rb), np.zeros((len(dist), 7, 9))
    a2, b2 = (np.maximum(dot(rho, rho), 1e-12) for rho in (ra, rb))  # walls have no radii
    up_a, up_b, ab = dot(u, ra), dot(u, rb), -dot(ta, tb) / dist
    bb = np.maximum(b2 / dist - up_b, 1e-10 * b2 / dist)
    det = np.maximum((a2 / dist + up_a) * bb - ab**2, 1e-10 * a2 * b2 / dist**2)
    for row, e in enumerate((u, *tangent_frame(u))):  # motions of w along u and across it
        X[:, row, :3], X[:, row, 3:6], X[:, row, 6:] = e, cross(e, ra), cross(rb, e)
    # D_phiq for ring b, and for ring a while b follows; dw/dphi, -ta and tb, are normal to u at a minimum.
    ta_dist, tb_dist = ta / dist[:, None], tb / dist[:, None]
    X[:, 3, :3], X[:, 3, 3:6], X[:, 3, 6:] = -ta_dist, cross(u, ta), cross(ta_dist, rb)
    X[:, 4, :3], X[:, 4, 3:6], X[:, 4, 6:] = tb_dist, cross(tb_dist, ra), cross(tb, u)
    X[:, 3] = bb[:, None] * X[:, 3] - ab[:, None] * X[:, 4]
    X[:, 5, 3:6], X[:, 6, 6:] = ta, tb
    return X, np.stack([1.0 / dist, 1.0 / dist, -1.0 / (bb * det), -1.0 / bb, up_a / a2, -up_b / b2], axis=1)


def distance_hessian(m: Minima, n_a: Array, n_b: Array, fixed: Flags | None = None) -> Array:
    """Second derivative (m, 9, 9) of the distance, see `distance_forms`. Where `fixed` (m,) the point of ring a, which
    may be no minimum, stays on its ring and only that of ring b slides."""
    X, weight = distance_forms(m, n_a, n_b)
    if fixed is not None:
        weight[fixed, 2] = 0.0
    H = np.asarray(np.matmul(X[:, 1:].transpose(0, 2, 1), weight[..., None] * X[:, 1:]))
    if fixed is not None:
        rho, t = m.rho_a[fixed], cross(n_a[fixed], m.rho_a[fixed])
        share = 0.5 * dot(m.normal[fixed], t) / np.maximum(dot(rho, rho), 1e-12)
        skew = share[:, None, None] * rho[:, :, None] * t[:, None]
        H[fixed, 3:6, 3:6] -= skew + skew.transpose(0, 2, 1)
    return H
