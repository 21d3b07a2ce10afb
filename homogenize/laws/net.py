"""The net law: two families of inextensible fibres that turn freely where they cross, one parameter.

The rings of the mesh hang on straight diagonal chains, |x2 + x3| <= 4 (r1 - r2) and |x2 - x3| <= 4 (r1 - r2), and this
alone explains most of what the mesh does. With the unit directions n of the families in the reference state and
C = I + 2E a strain is admissible if n.C n <= l^2 for both, l the stretch at which a fibre is taut.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from homogenize.laws.protocol import Cut, HalfSpaces, MembraneLaw, Response, check_finite
from homogenize.laws.stored import Law
from rve.common import Array, JsonObject, Typed, checked, read_typed
from rve.common.cell_fields import STEEL_KG_PER_MM3, areal_mass
from rve.common.tensor import IDENTITY, WEIGHT, disc, double_dot, dyad, from_disc, trace
from rve.geometry import CellInfo

ROUNDING = 1e-6
"""Of the length of a direction in a file, and the least sine between two."""
LEAST_STIFFNESS, MOST_STIFFNESS = 1e-6, 1e12
"""N/mm, of every strain. A wider range leaves no digits between stress and energy."""
Stiffness = Annotated[float, Meta(ge=LEAST_STIFFNESS, le=MOST_STIFFNESS)]
STATED_STIFFNESS = 1000.0
"""N/mm: the contact stiffness 1e6 kg/s2 of the paper, one contact per ring and pitch; a stand-in for the compliance."""

Cosine = Annotated[float, Meta(ge=-1.0 - ROUNDING, le=1.0 + ROUNDING)]


@dataclass(frozen=True)
class NetEntries(Typed):
    """What the file of a net holds: unit vectors along the two families, stretch limit, stiffness in N/mm."""

    directions: tuple[tuple[Cosine, Cosine], tuple[Cosine, Cosine]]
    limit: Annotated[float, Meta(ge=1e-3, le=1e3)]
    stiffness_N_per_mm: Stiffness

    def check(self) -> None:
        n = np.array(self.directions)
        if np.abs((n**2).sum(axis=1) - 1.0).max() > ROUNDING or abs(np.linalg.det(n)) < ROUNDING:
            self.refuse(f"directions = {n.tolist()}: must be two different unit vectors")


@dataclass(frozen=True, eq=False, repr=False)
class NetLaw(Law, kind="net"):
    """Two families of fibres along `directions` (2, 2), one unit vector per row, taut at stretch `limit`.

    `stiffness` (N/mm) is the line load per unit of Green strain beyond locking, for each family alone.
    """

    directions: Array
    limit: float
    stiffness: float = STATED_STIFFNESS

    @property
    def compliance(self) -> Array:
        """Strain per line load (3, 3), in the metric in which the two fibres do not interact, mm/N."""
        lift = self._lift()
        return np.asarray(lift.T @ (lift * WEIGHT) / self.stiffness)

    def collapsed(self) -> Array:
        """The two fully drawn states C = I + 2E, both families in one line: triples (2, 3), each of rank one."""
        to_both = np.linalg.inv(self.directions)  # directions @ v = (1, +-1)
        return dyad(self.limit * (to_both @ np.array([[1.0, 1.0], [1.0, -1.0]])).T)

    def support(self, S: Array) -> Array:
        """h(S) = max S:E over the strains of the net, (n,): one of the two drawn states maximises under tension.

        The condition that I + 2E is positive semidefinite, which every deformation obeys, belongs to the set; without
        it a net would not bound a load outside the plane of its two fibre dyads.
        """
        check_finite(S, "line loads")
        C = self.collapsed()
        return 0.5 * (np.maximum(double_dot(S, C[0]), double_dot(S, C[1])) - trace(S))

    def half_spaces(self) -> HalfSpaces:
        """The two fibres: n n^T : E <= (l^2 - 1)/2; with I + 2E positive semidefinite these two bound the set."""
        return HalfSpaces(dyad(self.directions), np.full(2, 0.5 * (self.limit**2 - 1.0)))

    def cut(self, E: Array) -> Cut:
        """The half-space each E (n, 3) violates most: min over the segment of drawn states of the largest eigenvalue.

        max over S of unit trace of S:E - h(S) = min over t of the largest eigenvalue of E - E(t) (von Neumann), and
        the eigenvalue of a pencil of 2 x 2 tensors is minimised in closed form. At an inner t the answer is a fibre.
        """
        check_finite(E)
        E_ends = 0.5 * (self.collapsed() - IDENTITY)
        D = E_ends[1] - E_ends[0]
        d, q = 0.5 * disc(D[None])[0], 0.5 * disc(E - E_ends[0])
        size = float(np.hypot(d[0], d[1]))
        along, across = q @ d / size, (q[:, 1] * d[0] - q[:, 0] * d[1]) / size
        slope = 0.5 * float(trace(D)) / size  # in (-1, 1), because D is indefinite
        t_free = (along + slope * np.abs(across) / math.sqrt(1.0 - slope**2)) / size
        t = np.clip(t_free, 0.0, 1.0)
        q = q - t[:, None] * d
        length = np.hypot(q[:, 0], q[:, 1])
        unit = q / np.where(length > 0.0, length, 1.0)[:, None]
        fibres = dyad(self.directions)
        nearest = np.argmax(E @ (fibres * WEIGHT).T, axis=1)
        S = np.where((t == t_free)[:, None], fibres[nearest], from_disc(unit))
        h = self.support(S)
        return Cut(S, h, double_dot(S, E) - h)

    def response(self, E: Array) -> Response:
        """Energy, stress and tangent of the elastic net: each taut fibre is a linear spring in its Green strain."""
        check_finite(E)
        N = dyad(self.directions)
        excess = np.maximum(E @ (N * WEIGHT).T - 0.5 * (self.limit**2 - 1.0), 0.0)
        S = self.stiffness * excess @ N
        dyads = self.stiffness * N[:, :, None] * (N * WEIGHT)[:, None, :]
        C = np.einsum("nf,fij->nij", (excess > 0.0).astype(float), dyads)
        return Response(0.5 * self.stiffness * (excess**2).sum(axis=1), S, C, E - excess @ self._lift())

    def elastic(self) -> MembraneLaw:
        """The net whose two fibres alone limit the strain, which `response` is the energy of."""
        return ElasticNet(**{field.name: vars(self)[field.name] for field in fields(self)})

    def _lift(self) -> Array:
        """Strain (2, 3) per unit of excess of each fibre, in the metric in which the two fibres do not interact."""
        N = dyad(self.directions)
        gram = (N * WEIGHT) @ N.T
        return np.linalg.solve(gram, N)

    def to_dict(self) -> JsonObject:
        return {"directions": self.directions.tolist(), "limit": self.limit, "stiffness_N_per_mm": self.stiffness}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], where: str) -> NetLaw:
        entries = read_typed(NetEntries, data, where)
        return NetLaw(np.array(entries.directions), entries.limit, entries.stiffness_N_per_mm)


@dataclass(frozen=True, eq=False, repr=False)
class ElasticNet(NetLaw):
    """The net of elastic curtains: two linear springs, also where they are drawn into a line.

    `NetLaw` has I + 2E positive semidefinite among its half-spaces. Strains of curtains obey this, strains of their
    locked parts E - D S need not.
    """

    cut = Law.cut
    elastic = Law.elastic


@checked
def diagonal_net(limit: float = 1.0, stiffness: float = STATED_STIFFNESS) -> NetLaw:
    """The abstract net: two families at +45 and -45 degrees, taut at stretch `limit`."""
    return NetLaw(np.array([[1.0, 1.0], [1.0, -1.0]]) / math.sqrt(2.0), limit, stiffness)


def ring_cell(
    r1_mm: float, r2_mm: float, b_x_mm: float, b_y_mm: float, density_kg_per_mm3: float = STEEL_KG_PER_MM3
) -> CellInfo:
    """The cell of the 4-in-1 weave: two rings of this density, steel by default, on every b_x times b_y."""
    mass = areal_mass(r1_mm, r2_mm, 0.5 * b_x_mm * b_y_mm, density_kg_per_mm3)
    return CellInfo(r1_mm, r2_mm, b_x_mm, b_y_mm, mass)


@checked
def ring_net(cell: CellInfo, stiffness: float = STATED_STIFFNESS) -> NetLaw:
    """The net of a ring mesh: diagonals (b_x, +-b_y) that can be drawn to 4 (r1 - r2).

    >>> law = ring_net(ring_cell(5.0, 0.5, 11.0, 12.646069623526))
    >>> float(round(law.limit, 5))
    1.07394
    """
    diagonal = math.hypot(cell.b_x_mm, cell.b_y_mm)
    n = np.array([[cell.b_x_mm, cell.b_y_mm], [cell.b_x_mm, -cell.b_y_mm]]) / diagonal
    return NetLaw(n, 4.0 * (cell.r1_mm - cell.r2_mm) / diagonal, stiffness, cell=cell)
