"""Wide contacts: pairs of rings whose minima of the distance may split or merge, spread over points of ring a.

A joining ring between two taut contacts turns freely about the line through them until a minimum of the distance splits
in two. There minima move with the cube root of the tilt, which no Newton step predicts, and a sum over minima jumps. In
place of the least gap such a pair has

    g = (integral of gap(angle)^-p over ring a)^(-1/p),

which is smooth, and zero where the rings touch. Its force is spread over the points of the quadrature in the shares
dg/dgap_k = angle_k (g / gap_k)^(p+1): none of them pulls, and the sum of shares times gaps is g, so that forces of the
central path satisfy the conditions of equilibrium of the rings themselves, at points a force times gap of mu apart.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rve.common import Array, Flags, Index, Rows
from rve.geometry.ring_pair import Minima, cross, dot, foot_on_circle, norm


@dataclass(frozen=True, eq=False)
class WideContacts(Rows):
    """The points of wide contacts: contact (k,), ascending, a row of all contacts; points; gap (k,); angle (k,): the
    part of ring a for which each stands."""

    contact: Index
    points: Minima
    gap: Array
    angle: Array
    power: ClassVar[int] = 2  # larger ones need more points, smaller ones weigh far points more

    @property
    def rows(self) -> Index:
        """Rows (w,) of the wide contacts among all contacts."""
        return np.unique(self.contact)

    def sums(self, values: Array) -> Array:
        """Sums (w, ...) over the points of each contact of values (k, ...)."""
        return np.asarray(np.add.reduceat(values, np.unique(self.contact, return_index=True)[1], axis=0))

    def mean(self, gap: Array) -> Array:
        """g (w,) at gaps (k,) of the points; the least one where it is negative."""
        rows, first, back = np.unique(self.contact, return_index=True, return_inverse=True)
        least = np.asarray(np.minimum.reduceat(gap, first)) if len(rows) else gap[:0]
        ratio = np.maximum(least, 0.0)[back] / np.where(gap == 0.0, 1.0, gap)
        total = np.maximum(self.sums(self.angle * ratio**self.power), 1e-300)
        return np.where(least > 0.0, least * total ** (-1.0 / self.power), least)

    def shares(self, gap: Array) -> Array:
        """dg/dgap_k (k,); gap (m,): of all contacts, g of the wide ones."""
        return np.asarray(self.angle * (gap[self.contact] / self.gap) ** (self.power + 1))


_EMPTY, _NOWHERE = np.zeros(0), np.zeros((0, 3))
_NONE = Minima(np.zeros(0, np.intp), _NOWHERE, _NOWHERE, _NOWHERE, _EMPTY, _EMPTY)
NO_WIDE = WideContacts(np.zeros(0, np.intp), _NONE, _EMPTY, _EMPTY)


def soft_pairs(minima: Minima, wires: Array, was_wide: Flags) -> Index:
    """Pairs (w,) that are wide: with a minimum of small curvature, and those that were until it is stiffer; wires (p,):
    radii of both wires together."""
    is_soft, least = np.zeros(len(wires), dtype=bool), np.full(len(wires), np.inf)
    is_soft[minima.pair[minima.curvature < np.where(was_wide, 0.7, 0.4)[minima.pair]]] = True
    np.minimum.at(least, minima.pair, minima.distance - wires[minima.pair])
    return np.flatnonzero(is_soft & (least > 0.0))


def widened(
    minima: Minima, pairs: Index, circles: tuple[Array, Array, Array, Array], wires: Array
) -> tuple[Minima, WideContacts]:
    """Minima with the deepest one alone of each of the pairs (w,), and the points of these.

    circles: d, n_a, n_b (p, 3) and radii b (p,) of all pairs. The quadrature is the trapezoidal rule in a coordinate in
    which points crowd around each minimum, like the angle there at which the gap has doubled, and lie evenly elsewhere.
    """
    d, n_a, n_b, b = circles
    first = np.searchsorted(minima.pair, np.arange(len(wires) + 1))
    deepest, other = first[pairs], first[pairs + 1] - 1  # circles have two minima at most
    gap = np.maximum(minima.distance - wires[minima.pair], 1e-14)
    stiff = np.maximum(minima.curvature, 0.0) / minima.distance
    size = 0.7 * np.sqrt(np.sqrt(stiff**2 + 4.0 * gap) - stiff) / norm(minima.rho_a)
    rho, tau = minima.rho_a[deepest], cross(n_a[pairs], minima.rho_a[deepest])
    place = np.arctan2(dot(minima.rho_a[other], tau), dot(minima.rho_a[other], rho))
    centre = np.stack([np.zeros(len(pairs)), place], axis=1)[:, :, None]
    width = np.maximum(size[np.stack([deepest, other], axis=1)], 1e-7)[:, :, None]
    weight = np.stack([np.ones(len(pairs)), other > deepest], axis=1)[:, :, None]

    def coordinate(angle: Array) -> Array:
        return np.asarray((weight * np.arcsinh((angle[:, None] - centre) / width)).sum(axis=1) + 1.5 * angle)

    low = np.full((len(pairs), 1), -np.pi)
    start, end = coordinate(low), coordinate(-low)
    count = int(np.ceil(float((end - start).max(initial=0.0)) / 0.4)) + 1
    aim = start + (end - start) * (np.arange(count) + 0.5) / count
    low, high = np.full_like(aim, -np.pi), np.full_like(aim, np.pi)
    for _ in range(60):
        angle = 0.5 * (low + high)
        is_below = coordinate(angle) < aim
        low, high = np.where(is_below, angle, low), np.where(is_below, high, angle)
    density = (weight / np.hypot(angle[:, None] - centre, width)).sum(axis=1) + 1.5
    rho = np.cos(angle)[..., None] * rho[:, None] + np.sin(angle)[..., None] * tau[:, None]
    pair = np.repeat(pairs, count)
    points = point_contacts(pair, rho.reshape(-1, 3), d[pair], n_b[pair], b[pair])
    keep = ~np.isin(minima.pair, pairs)
    keep[deepest] = True
    contact = np.repeat((np.cumsum(keep) - 1)[deepest], count)
    part = ((end - start) / count / density).ravel()
    return minima.take(keep), WideContacts(contact, points, points.distance - wires[pair], part)


def point_contacts(pair: Index, rho_a: Array, d: Array, nb: Array, rb: Array) -> Minima:
    """Points (m, 3) of ring a with the nearest points of ring b, as contacts of the pairs (m,)."""
    rho_b = foot_on_circle(rho_a - d, nb, rb)
    w = d + rho_b - rho_a
    distance = norm(w)
    return Minima(pair, w / distance[:, None], rho_a, rho_b, distance, np.ones(len(pair)))
