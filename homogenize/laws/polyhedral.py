"""The polyhedral law: half-spaces of the rows, from outside or from inside, without a fit; its elastic form.

Outer form: {E : S_i:E <= h_i}, all that the rows allow. Inner form: the hull of the rows' strains minus the tensile
cone, all that the rows reach; its half-spaces are the hull's tensile facets and loads of rank one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from scipy.spatial import cKDTree

from homogenize.laws.geometry import Polyhedron, fibres, highest, outer_vertices, polyhedron_of, respond
from homogenize.laws.giving import split_compliance, work_along
from homogenize.laws.net import LEAST_STIFFNESS, MOST_STIFFNESS, STATED_STIFFNESS
from homogenize.laws.protocol import Cut, HalfSpaces, MembraneLaw, Response, check_finite
from homogenize.laws.stored import Law
from rve.common import Array, InputError, JsonObject, Typed, read_typed
from rve.common.tensor import WEIGHT, disc
from rve.geometry import CellInfo

LEVELS = 13
"""Levels of tau between which support functions are interpolated."""
FAR = 100.0
"""Locked strains of a law of elastic curtains are not those of cells: bounds of I + 2E widen this much faster."""
MOST_HALF_SPACES = 50_000
"""In a law file. A table of 403 rows gives some 5,000; reading takes longer in proportion."""
MOST_STRAIN = 1e3
"""Bound of h and of the components of S in a law file; strains of rings are below 1."""
Component = Annotated[float, Meta(ge=-MOST_STRAIN, le=MOST_STRAIN)]
Entry = Annotated[float, Meta(ge=-MOST_STIFFNESS, le=MOST_STIFFNESS)]
Matrix = tuple[tuple[Entry, Entry, Entry], tuple[Entry, Entry, Entry], tuple[Entry, Entry, Entry]]
"""A stiffness in a law file, N/mm."""


@dataclass(frozen=True)
class PolyhedronEntries(Typed):
    """What the file of a polyhedral law holds: half-spaces S:E <= h and the stiffness in N/mm."""

    S: Annotated[tuple[tuple[Component, Component, Component], ...], Meta(min_length=1, max_length=MOST_HALF_SPACES)]
    h: tuple[Component, ...]
    stiffness_N_per_mm: Matrix


@dataclass(frozen=True, eq=False, repr=False)
class PolyhedralLaw(Law, kind="polyhedral"):
    """Half-spaces S (m, 3) of unit trace, h (m,); `vertices` (k, 3) of the strains they leave; stiffness (3, 3)."""

    S: Array
    h: Array
    vertices: Array
    stiffness: Array

    @property
    def compliance(self) -> Array:
        return np.asarray(np.linalg.inv(self.stiffness))

    def support(self, S: Array) -> Array:
        check_finite(S, "line loads")
        return highest(S, self.vertices)

    def half_spaces(self) -> HalfSpaces:
        """Eight tight ones: those of loads of rank one."""
        S = fibres(8)  # nine more inside the tensile cone made steps of curtains up to half as long again, and no fewer
        return HalfSpaces(S, self.support(S))

    def elastic(self) -> MembraneLaw:
        return giving_law(self) or self

    def cut(self, E: Array) -> Cut:
        """The most violated half-space of the law; none of a load between them is violated more."""
        check_finite(E)
        worst, violation = self._body.worst(E)
        return Cut(self.S[worst], self.h[worst], violation)

    def response(self, E: Array) -> Response:
        check_finite(E)
        return respond(E, self._body)

    @cached_property
    def _body(self) -> Polyhedron:
        return polyhedron_of(self.S, self.h, self.stiffness)

    def to_dict(self) -> JsonObject:
        return {"S": self.S.tolist(), "h": self.h.tolist(), "stiffness_N_per_mm": self.stiffness.tolist()}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], where: str) -> PolyhedralLaw:
        entries = read_typed(PolyhedronEntries, data, where)
        try:
            return polyhedral_law(
                np.array(entries.S), np.array(entries.h), stiffness_matrix(entries.stiffness_N_per_mm)
            )
        except InputError as error:
            raise InputError(f"{where} {error}") from error

    def softer(self, factor: float) -> PolyhedralLaw:
        return replace(self, stiffness=self.stiffness / factor) if self.stiffness_is_measured else self


@dataclass(frozen=True, eq=False, repr=False)
class GivingLaw(PolyhedralLaw):
    """A polyhedral law with a compliance by direction, for elastic curtains (`homogenize.laws.giving`).

    Its stiffness is that of the floor D0; extra (m,): the widenings g_i of its half-spaces, in (mm/N)^0.5. Strains may
    have a fourth component, tau.
    """

    extra: Array

    def half_spaces(self) -> HalfSpaces:
        """Half-spaces to start with, each with its widening in the law, or the largest if it is not among them."""
        start = super().half_spaces()
        tree = cKDTree(np.column_stack([disc(self.S), self.h]))
        distance, row = tree.query(np.column_stack([disc(start.S), start.h]))
        return replace(start, extra=np.where(distance < 1e-9, self.extra[row], self.extra.max()))

    def cut(self, E: Array) -> Cut:
        """The most violated half-space of strains E (n, 3), or (n, 4) with tau, see MembraneLaw."""
        check_finite(E)
        E = E if E.shape[1] == 4 else np.column_stack([E, np.zeros(len(E))])
        worst, violation = self._body.worst(E)
        return Cut(self.S[worst], self.h[worst], violation, self.extra[worst])

    @cached_property
    def _body(self) -> Polyhedron:
        return polyhedron_of(self.S, self.h, self.stiffness, self.extra)

    elastic = Law.elastic

    def compliance_along(self, S: Array, size: float) -> Array:
        """Twice the complementary energy beyond size h(S), over size^2, mm/N, (n,): S:D S of this law at line loads
        size S in N/mm, S (n, 3) of unit trace.

        The largest of size H - tau^2/2 over tau, where H, the support function of half-spaces widened by tau, is
        concave in tau and taken as linear between LEVELS of it.
        """
        tau = size * self.extra.max() * np.linspace(0.0, 1.0, LEVELS) ** 2
        H = np.stack(
            [highest(S, outer_vertices(self.S, self.h + t * self.extra, FAR * t * self.extra.max())) for t in tau]
        )
        slope = np.diff(H, axis=0) / np.diff(tau)[:, None]
        at = np.clip(size * slope, tau[:-1, None], tau[1:, None])
        most = (size * (H[:-1] + slope * (at - tau[:-1, None])) - 0.5 * at**2).max(axis=0)
        return np.asarray(2.0 * (most - size * H[0]) / size**2 + work_along(S, self.compliance))


def giving_law(law: PolyhedralLaw) -> GivingLaw | None:
    """The law with the compliance by direction of its strength; None if it has none."""
    split = None if law.strength is None else split_compliance(law.S, law.strength)
    if split is None:
        return None
    same = {field.name: vars(law)[field.name] for field in fields(law)}
    return GivingLaw(**(same | {"stiffness": split[0], "extra": split[1]}))


def polyhedral_law(S: Array, h: Array, stiffness: Array | None = None, cell: CellInfo | None = None) -> PolyhedralLaw:
    """The law of half-spaces S (m, 3) positive semidefinite, h (m,); InputError if they are not tensile or contradict.

    stiffness (3, 3) in N/mm: that of the rings, by default a stated one.

    >>> law = polyhedral_law(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([0.5, 0.2]))
    >>> law.support(np.array([[0.5, 0.0, 0.5]])).round(9)
    array([0.35])
    """
    of_unit_trace = HalfSpaces(S, h)
    S, h = of_unit_trace.S, of_unit_trace.h
    C = STATED_STIFFNESS * np.eye(3) if stiffness is None else np.asarray(stiffness, float)
    return PolyhedralLaw(S, h, outer_vertices(S, h), C, cell=cell, stiffness_is_measured=stiffness is not None)


def stiffness_matrix(given: Matrix) -> Array:
    """A stiffness (3, 3) in tensor components; InputError unless it is symmetric and positive definite.

    With W = diag(1, 2, 1) it is W M that is symmetric, and its eigenvalues are the stiffnesses.
    """
    M = np.array(given)
    Q = WEIGHT[:, None] * M
    named = f"stiffness_N_per_mm = {M.tolist()}"
    if np.abs(Q - Q.T).max() > 1e-9 * np.abs(Q).max():
        raise InputError(f"{named}: must be symmetric, M_11,12 = 2 M_12,11 and so on")
    least = float(np.linalg.eigvalsh(0.5 * (Q + Q.T))[0])
    if not least >= LEAST_STIFFNESS:
        raise InputError(
            f"{named}: is not positive definite, its least stiffness is {least:g} N/mm; {LEAST_STIFFNESS:g} is needed"
        )
    return M
