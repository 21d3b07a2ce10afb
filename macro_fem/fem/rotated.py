"""A law whose weave is rotated against the axes of the curtain."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from homogenize import CellInfo, Cut, HalfSpaces, MembraneLaw, Response, elastic_law
from rve.common.tensor import dyad
from rve.common.types import Array


@dataclass(frozen=True, eq=False)
class RotatedLaw:
    """`law` in the frame of a curtain, its weave rotated counterclockwise by `angle_deg`.

    With R the rotation by the angle, tensors of the curtain and of the weave are related by A = R A_weave R^T; on
    triples this is the matrix `to_curtain` (3, 3), A = to_curtain A_weave.
    """

    law: MembraneLaw
    angle_deg: float

    @property
    def name(self) -> str:
        """Name of the law."""
        return self.law.name

    @property
    def cell(self) -> CellInfo | None:
        """The rings behind the law, in the frame of the weave."""
        return self.law.cell

    @property
    def compliance(self) -> Array:
        """The metric of the response in the frame of the curtain, see MembraneLaw."""
        return self.to_curtain @ self.law.compliance @ self.to_weave

    @property
    def to_curtain(self) -> Array:
        """Triples of the weave to triples of the curtain (3, 3)."""
        return rotation_on_triples(self.angle_deg)

    @property
    def to_weave(self) -> Array:
        """Triples of the curtain to triples of the weave (3, 3)."""
        return rotation_on_triples(-self.angle_deg)

    def support(self, S: Array) -> Array:
        """h(S), see MembraneLaw."""
        return self.law.support(S @ self.to_weave.T)

    def half_spaces(self) -> HalfSpaces:
        """Half-spaces to start with, see MembraneLaw."""
        start = self.law.half_spaces()
        return replace(start, S=start.S @ self.to_curtain.T)

    def cut(self, E: Array) -> Cut:
        """The most violated half-space, see MembraneLaw."""
        cut = self.law.cut(np.column_stack([E[:, :3] @ self.to_weave.T, E[:, 3:]]))
        return replace(cut, S=cut.S @ self.to_curtain.T)

    def response(self, E: Array) -> Response:
        """The elastic answer, see MembraneLaw."""
        local = self.law.response(E @ self.to_weave.T)
        T = self.to_curtain
        return Response(local.energy, local.S @ T.T, T @ local.C @ self.to_weave, local.E_star @ T.T)

    def to_dict(self) -> dict[str, Any]:
        """The law and the angle."""
        return {"law": self.law.to_dict(), "angle_deg": self.angle_deg}


def rotation_on_triples(angle_deg: float) -> Array:
    """R A R^T as a matrix (3, 3) on triples, exact for quarter turns.

    >>> rotation_on_triples(90.0) @ [1.0, 2.0, 3.0]
    array([ 3., -2.,  1.])
    """
    quarter = angle_deg / 90.0
    if quarter == round(quarter):
        c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[round(quarter) % 4]
    else:
        c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    return np.array([[c * c, -2 * c * s, s * s], [c * s, c * c - s * s, -c * s], [s * s, 2 * c * s, c * c]])


def elastic(law: MembraneLaw) -> MembraneLaw:
    """`homogenize.elastic_law` of a law in the frame of a curtain."""
    return replace(law, law=elastic_law(law.law)) if isinstance(law, RotatedLaw) else elastic_law(law)


def rotated(law: MembraneLaw, angle_deg: float) -> MembraneLaw:
    """`law` with its weave rotated; the law itself at multiples of 180 degrees."""
    if angle_deg % 180.0 == 0.0:
        return law
    return RotatedLaw(law, angle_deg)


def largest_stretch(law: MembraneLaw, directions: Array) -> Array:
    """How far the law lets a line along each direction (n, 2) stretch: sqrt(1 + 2 h(e e^T)) (n,)."""
    e = directions / np.linalg.norm(directions, axis=1)[:, None]
    return np.sqrt(np.maximum(1.0 + 2.0 * law.support(dyad(e)), 0.0))
