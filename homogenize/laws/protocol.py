"""What a membrane law is: the records it answers with and the protocol it follows.

Symmetric 2 x 2 tensors are triples (11, 12, 22) of tensor components on the last axis, the leading axis is the point:
S:E = S11 E11 + 2 S12 E12 + S22 E22. Line loads and stiffnesses are in N/mm, strains have no unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rve.common import Array, ByValue, InputError, Rows, Typed, checked
from rve.common.cell_fields import ArealMass, Length

SAME_RINGS = 1e-6
"""Relative difference of radii and reference cells that are count as the same."""


def check_finite(values: Array, what: str = "strains") -> None:
    """InputError that names the first row of `values` (n, 3) that is not three finite numbers."""
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        raise InputError(f"{what} are finite numbers, row {bad[0]} of {len(values)} is {values[bad[0]].tolist()}")


@dataclass(frozen=True)
class CellInfo(Typed):
    """The rings behind a law: what a scene needs to know of them, in mm and kg/m2.

    b_x_mm, b_y_mm: sides of the reference cell, one primitive cell.
    """

    r1_mm: Length
    r2_mm: Length
    b_x_mm: Length
    b_y_mm: Length
    areal_mass_kg_per_m2: ArealMass

    def check_same(self, other: CellInfo, where: str, name: str) -> None:
        """InputError if `other` are rings of another shape, of any size; `where` names them, `name` these rings."""
        shapes = [np.array([cell.r2_mm, cell.b_x_mm, cell.b_y_mm]) / cell.r1_mm for cell in (other, self)]
        if np.abs(np.subtract(*shapes)).max() > SAME_RINGS:
            given, own = (", ".join(f"{x:.6g}" for x in shape) for shape in shapes)
            weaves = other.weave(), self.weave()
            if all(weaves) and weaves[0] != weaves[1]:
                raise InputError(
                    f"{where}: has the weave {weaves[0]}, {name} the weave {weaves[1]}; give both the same one"
                )
            raise InputError(f"{where}: r2, b_x and b_y over r1 are {given}, those of {name} are {own}")

    def weave(self) -> str:
        """The name of the weave and its grain, by the sides of the reference cell; "" if no weave has them."""
        from rve import cell_of_sides  # which brings the solver of every ring

        try:
            cell = cell_of_sides(self.r1_mm, self.r2_mm, (self.b_x_mm, self.b_y_mm))
        except InputError:
            return ""
        return f"{cell.weave.name} with grain {cell.grain}"


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
