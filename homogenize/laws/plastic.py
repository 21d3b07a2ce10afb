"""Rings that flow: the line loads that they carry within plasticity as a convex set, and the law of curtains of them.

Forces between rings, times the vectors between rings of the reference state, add up to the nominal line load P = F S.
Where rings flow these forces stay, and so does P, while S falls as the mesh stretches. So of every half-space
S:E <= h, which reads |F L| <= c with S = L L^T and c^2 = 2 h + tr S, it is the multiplier of the norm that is capped:

    |F L| <= c + N tau   with   N = g / c,   g = 1 / (the load t at which t S collapses the rings),

at the cost tau >= 0 per area. With e = |F L| / c - 1, tau = c^2 e / g: to first order the work of the load S / g on the
plastic strain, so that the law is I_K with D added by inf-convolution, D the support function of the loads S / g. Its
nominal loads are P = sum of p_j L_j with sum of |p_j| N_j <= 1: convex, and the same in every frame.

Collapse loads of rows make a star that need not be convex. Its hull is not safe. The safe set keeps every half-space
at a load c N^-1 = kappa at which no row (F, S) bears more than its own collapse load: a G with kappa_j |G L_j| <= 1 for
all j and (F S):G >= g bounds it. Strips drawn to a line, G = a (x) n, are looked at first, and the strength along both
axes of the weave is kept; then every row with G = F.

Rings that are drawn out end as strings, which stretch no more: half-spaces |F L| <= c_2, c_2^2 = 2 h_strings + tr S,
beside those that tau widens, so that the law is (I_K with D added by inf-convolution) + I_K2. Elastic wire of Young's
modulus E and section A under tension T is longer by T 2 pi r1/(E A). Of loads lam_i S_i with tensions T_i it stores
sum lam_i lam_j C_ij / 2, C_ij = sum over the rings of T_i T_j 2 pi r1/(E A A_ref), never more than with the rank one
C_ij = g_i g_j, g_i^2 = C_ii, which is exact where all rings share loads alike: |F L| <= c_2 + N_e e, N_e = g / c_2, at
the cost e^2 / 2, which is never stiffer than the strings.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
from scipy.spatial import ConvexHull

from homogenize.directions import each_once
from homogenize.laws.geometry import Polyhedron, fibres, highest
from homogenize.laws.polyhedral import PolyhedralLaw
from homogenize.laws.protocol import Cut, HalfSpaces, MembraneLaw, Response, check_finite
from homogenize.laws.strength import MAKE_AGAIN, Strength
from rve.common import Array, ByValue, InputError, checked
from rve.common.tensor import IDENTITY, WEIGHT, disc, dyad, eigenvalues, mirror
from rve.geometry import Cell
from rve.locking import StringStates, string_states

FIBRES = 180
"""Directions of strips, over half a turn. Half as many leave strips between them 1e-4 stronger than their strength."""
STARTS = 6
"""Lattices from which strings are drawn. Four times as many find the same h to 1e-15 in 4-in-1 and 6-in-1."""


@dataclass(frozen=True, eq=False)
class LimitSurface(ByValue):
    """Loads S (n, 3) of unit trace and, in 1/mm, the yield stress over them at collapse: of the rows, g (n,), and of
    the safe set, safe (n,). c (n,): |F L| at which they lock."""

    S: Array
    c: Array
    g: Array
    safe: Array

    def loads(self, S: Array) -> tuple[Array, Array]:
        """The loads t (n,) with which t S leaves the safe set and the hull, in mm times the yield stress; S (n, 3) of
        unit trace."""
        safe, hull = (1.0 / (S @ _planes(self.S, g).T).max(axis=1) for g in (self.safe, self.g))
        return safe, hull

    @property
    def difference(self) -> float:
        """By how many times the hull is larger than the safe set, where it is most."""
        return float((self.safe / self.g).max())

    def dissipation(self, E: Array) -> Array:
        """D(E) = max S:E over the safe set for plastic strains E (n, 3), in mm times the yield stress, (n,)."""
        return np.maximum(highest(E, self.S / self.safe[:, None]), 0.0)


def _planes(S: Array, g: Array) -> Array:
    """n (m, 3) of the half-spaces n.S <= 1 of the hull of S / g (n, 3) and no load."""
    equations = ConvexHull(np.vstack([S / g[:, None], np.zeros((1, 3))]) * g.min()).equations
    outer = equations[equations[:, 3] < -1e-9]
    return np.asarray(outer[:, :3] / -outer[:, 3:] * g.min())


def limit_surface(law: MembraneLaw) -> LimitSurface:
    """The limit surface of a law; InputError if it has no half-spaces, or no strength of its rings."""
    if not isinstance(law, PolyhedralLaw):
        raise InputError(f"a law of kind {law.name} has no half-spaces with which rings flow: fit one of kind refined")
    if law.strength is None:
        raise InputError(f"the law holds no strength of its rings; {MAKE_AGAIN}")
    return _surface(law)


@lru_cache(maxsize=4)
def _surface(law: PolyhedralLaw) -> LimitSurface:
    """The limit surface, found once for each law."""
    assert law.strength is not None
    known, rows = law.strength, law.strength.S
    S = np.vstack([rows, mirror(rows) if known.is_mirrored else rows, fibres(FIBRES), law.S])
    S = S[each_once(disc(S))]
    c, g = np.sqrt(2.0 * law.support(S) + 1.0), known.collapse_at(S)
    strips = _strips(law, known)
    kappa = np.minimum(c / g, 1.0 / np.sqrt(((S * WEIGHT) @ dyad(strips).T).max(axis=1)))  # |L n|^2 = n.S n
    at = law.vertices[((rows * WEIGHT) @ law.vertices.T).argmax(axis=1)]
    return LimitSurface(S, c, g, c / _within_rows(S, kappa, strips, known, 2.0 * at + IDENTITY))


def _strips(law: PolyhedralLaw, known: Strength) -> Array:
    """n (m, 2): strips along d bear no more than their strength kappa_d if |n.d| kappa_d <= 1 for all n; through each
    strip the one that weakens the others least."""
    rim = known.S[eigenvalues(known.S)[0] < 1e-9]
    angle = np.pi * np.arange(FIBRES) / FIBRES
    angle = np.unique(np.round(np.append(angle, np.arctan2(rim[:, 2], rim[:, 1]) % np.pi), 9))
    d, across = np.stack([np.cos(angle), np.sin(angle)]).T, np.stack([-np.sin(angle), np.cos(angle)]).T
    kappa = np.sqrt(2.0 * law.support(dyad(d)) + 1.0) / known.collapse_at(dyad(d))
    # Weight of the strength along the axes of the weave against that along other fibres, where one of them must give.
    weight, planes = np.where(np.abs(d).min(axis=1) < 1e-8, 1e3, 1.0), np.empty_like(d)
    for i in range(len(d)):
        j = np.delete(np.arange(len(d)), i)
        slope = (np.array([[1.0], [-1.0]]) / kappa[j] - d[j] @ d[i] / kappa[i]) / (d[j] @ across[i])
        n = d[i] / kappa[i] + np.append(slope, 0.0)[:, None] * across[i]
        planes[i] = n[(np.maximum(np.abs(n @ d.T) * kappa - 1.0, 0.0) @ weight).argmin()]
    return np.vstack([planes, planes * [1.0, -1.0]]) if known.is_mirrored else planes


def _within_rows(S: Array, kappa: Array, strips: Array, known: Strength, C: Array) -> Array:
    """kappa (n,) of half-spaces S (n, 3) lowered until no row bears more than its collapse load at its locked C = F^T F
    (m, 3): by G = a (x) n of the strips or else by G = F."""
    M, T = (A[:, [0, 1, 1, 2]].reshape(-1, 2, 2) for A in (C, known.S))
    drawn = (T @ M @ T).reshape(-1, 4)[:, [0, 1, 3]] * WEIGHT  # |F S n|^2
    bounded, g = np.sqrt((drawn @ dyad(strips).T).max(axis=1)), known.collapse
    for i in np.flatnonzero(bounded < g * (1.0 - 1e-9)):
        kappa = np.minimum(
            kappa, (known.S[i] * WEIGHT) @ C[i] / g[i] / np.sqrt(np.maximum((S * WEIGHT) @ C[i], 1e-300))
        )
    return kappa


@dataclass(frozen=True, eq=False)
class Strings(ByValue):
    """Rings drawn to strings: h (n,) of loads S (n, 3) of unit trace; N (n,) in (mm/N)^0.5, see `PlasticLaw`; wire: the
    tension over its cross-section under line loads, as `Strength.collapse_at` tells it."""

    S: Array
    h: Array
    N: Array
    wire: Strength


@lru_cache(maxsize=4)
def _drawn(cell: Cell, loads: bytes, sides_mm: tuple[float, float]) -> StringStates:
    """The strings of a cell, found once for all of its laws: a scene with a material makes one at each solve."""
    return string_states(cell, np.frombuffer(loads).reshape(-1, 3), sides_mm, STARTS)


@lru_cache(maxsize=4)
def _strings(law: PolyhedralLaw) -> Strings:
    """The strings of a law at the loads of its strength; InputError where rings are no strings."""
    known, info = law.strength, law.cell
    assert known is not None
    if info is None or info.pattern is None or known.joint != "welded":
        why = "butted rings open before" if known.joint != "welded" else "the law does not tell its weave"
        raise InputError(f"strings: {why}; fit a law of welded rings with its cell")
    found = _drawn(info.cell(), known.S.tobytes(), info.sides_mm)
    if (found.h < law.support(known.S) - 1e-3).any():
        raise InputError("strings: are shorter than rings that lock, so the law is not that of its cell; fit it again")
    S, h, N = known.S, found.h, found.give / np.sqrt(known.material.young_N_per_mm2 * (2.0 * found.h + 1.0))
    if known.is_mirrored:
        S, h, N = np.vstack([S, mirror(S)]), np.tile(h, 2), np.tile(N, 2)
    first = each_once(disc(S))
    return Strings(S[first], h[first], N[first], replace(known, collapse=found.stress, error=None))


@dataclass(frozen=True, eq=False)
class PlasticLaw(MembraneLaw):
    """The law `own` whose rings flow at the safe limit surface: half-spaces S (n, 3), h (n,), widened by N tau, N (n,)
    in mm/N, which is 0 for those of `strings`; these are widened by N_e e, N_e (n,), where they are elastic.
    difference: see `LimitSurface`. Cuts are those of strains with tau and tau^2 / 2, (n, 5), with e and e^2 / 2 beside
    them where strings are elastic, or with `is_limit` of C / 2, 0, tau^2 / 2, C = F^T F: what is left where a curtain
    is stretched without end."""

    own: PolyhedralLaw
    S: Array
    h: Array
    N: Array
    difference: float
    strings: Strings | None = None
    is_limit: bool = False
    N_e: Array | None = None

    name = property(lambda self: self.own.name)
    cell = property(lambda self: self.own.cell)
    compliance = property(lambda self: np.zeros((3, 3)))

    def support(self, S: Array) -> Array:
        return self.own.support(S)

    def half_spaces(self) -> HalfSpaces:
        start = self.own.half_spaces()  # these fibres are among its own
        near = ((self.S - start.S[:, None]) ** 2).sum(axis=2).argmin(axis=1)
        return HalfSpaces(self.S[near], self.h[near], self.extra[near])

    def cut(self, E: Array) -> Cut:
        check_finite(E)
        worst, violation = self._body.worst(E)
        return Cut(self.S[worst], self.h[worst], violation, self.extra[worst])

    def response(self, E: Array) -> Response:
        return self.own.response(E)

    def elastic(self) -> MembraneLaw:
        return self.own.elastic()

    def parts(self, *, is_limit: bool = False) -> tuple[PlasticLaw, ...]:
        """The law of rings that flow as far as the curtain likes, and that of elastic strings alone."""
        some = [(N, N > 0.0) for N in self.extra.T]
        return tuple(
            PlasticLaw(self.own, self.S[of], self.h[of], N[of], self.difference, is_limit=is_limit) for N, of in some
        )

    @cached_property
    def extra(self) -> Array:
        """N beside N_e, (n, 1) or (n, 2)."""
        return np.column_stack([self.N] if self.N_e is None else [self.N, self.N_e])

    @cached_property
    def _body(self) -> Polyhedron:
        wider = [one for N in self.extra.T for one in (-N * np.sqrt(2.0 * self.h + 1.0), -(N**2))]
        planes = np.column_stack([self.S * WEIGHT, *wider])
        return Polyhedron(planes, 0.0 * self.h if self.is_limit else self.h, np.eye(planes.shape[1]))


@checked
def plastic_law(law: MembraneLaw, *, strings: bool | Literal["elastic"] = False) -> PlasticLaw:
    """The law of a curtain whose rings flow, on request until they are strings, which then stretch no more or are
    elastic; InputError for laws without a limit surface, without yield stress, or of rings that are no strings."""
    surface = limit_surface(law)
    assert isinstance(law, PolyhedralLaw)
    assert law.strength is not None
    N = surface.safe / surface.c / law.strength.yield_stress()
    flowing = PlasticLaw(law, surface.S, 0.5 * (surface.c**2 - 1.0), N, surface.difference)
    if not strings:
        return flowing
    last = _strings(law)
    pairs = (flowing.S, last.S), (flowing.h, last.h), (N, 0.0 * last.h), (0.0 * N, last.N)
    S, h, N, N_e = (np.concatenate(pair) for pair in pairs)
    return replace(flowing, S=S, h=h, N=N, strings=last, N_e=N_e if strings == "elastic" else None)
