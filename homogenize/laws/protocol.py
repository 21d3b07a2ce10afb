"""What a membrane law is: the records it answers with and the protocol it follows.

Symmetric 2 x 2 tensors are triples (11, 12, 22) of tensor components on the last axis, the leading axis is the point:
S:E = S11 E11 + 2 S12 E12 + S22 E22. Line loads and stiffnesses are in N/mm, strains have no unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rve.common import Array, ByValue, InputError, Rows, checked
from rve.geometry import CellInfo


def check_finite(values: Array, what: str = "strains") -> None:
    """InputError that names the first row of `values` (n, 3) that is not three finite numbers."""
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        raise InputError(f"{what} are finite numbers, row {bad[0]} of {len(values)} is {values[bad[0]].tolist()}")


@dataclass(frozen=True, eq=False)
class HalfSpaces(ByValue):
    """Half-spaces S_i:E <= h_i with S_i positive semidefinite and of unit trace.

    S (m, 3); h (m,); extra (m,): by how much each is widened per unit of tau (`homogenize.laws.giving`), or None.
    """

    S: Array
    h: Array
    extra: Array | None = None


@dataclass(frozen=True, eq=False)
class Cut(Rows):
    """For each strain the half-space that it violates most: S (n, 3) of unit trace, h (n,), violation S:E - h (n,).

    extra (n,): see `HalfSpaces`.
    """

    S: Array
    h: Array
    violation: Array
    extra: Array | None = None


@dataclass(frozen=True, eq=False)
class Response(ByValue):
    """Elastic answer beyond locking: energy (n,), S = dPsi/dE (n, 3), C (n, 3, 3), closest locked strain E_star (n, 3).

    The tangent maps tensor components to tensor components, S = C dE with dE the triple (dE11, dE12, dE22); the factor
    2 of the shear product is inside C.
    """

    energy: Array
    S: Array
    C: Array
    E_star: Array


class MembraneLaw(Protocol):
    """A tensile, convex membrane law: the set K+ of admissible strains and the elasticity beyond it."""

    @property
    def name(self) -> str: ...

    @property
    def cell(self) -> CellInfo | None: ...

    @property
    def compliance(self) -> Array:
        """The metric of the response, E - E_star = compliance S: (3, 3) in tensor components, mm/N; 0: none."""

    def support(self, S: Array) -> Array:
        """h(S) = max S:E over K+ for S (n, 3) positive semidefinite, (n,)."""

    def half_spaces(self) -> HalfSpaces:
        """A few half-spaces that contain K+ and bound it under tension: where a cutting-plane method starts."""

    def cut(self, E: Array) -> Cut:
        """The half-space each E (n, 3) violates most; violation <= 0 means that E is admissible."""

    def response(self, E: Array) -> Response:
        """Energy, stress and tangent of the elastic law at E (n, 3)."""

    def elastic(self) -> MembraneLaw:
        """The law of elastic curtains: K+ with a compliance behind it, by direction where the law knows it."""


@checked
def elastic_law(law: MembraneLaw) -> MembraneLaw:
    """The law of an elastic curtain: with the compliance of its rings by direction if it has their strength, else with
    a constant one."""
    return law.elastic()
