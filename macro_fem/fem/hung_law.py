"""The law of a curtain: a membrane law whose weave lies at an angle to the axes of the curtain."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from homogenize import MembraneLaw, elastic_law
from homogenize.laws import Cut, HalfSpaces, PlasticLaw, Response, check_law, plastic_law, polyhedral_law
from rve.common import Array
from rve.common.tensor import dyad


@dataclass(frozen=True, eq=False)
class HungLaw:
    """`own`, the law in the frame of its weave, as a membrane law in the frame of a curtain.

    With R the rotation of the weave, tensors of the curtain are A = R A_weave R^T: on triples the matrix `to_curtain`
    (3, 3), and `to_weave` back.
    """

    own: MembraneLaw
    to_curtain: Array
    to_weave: Array

    name = property(lambda self: self.own.name)
    cell = property(lambda self: self.own.cell)
    compliance = property(lambda self: self.to_curtain @ self.own.compliance @ self.to_weave)

    @classmethod
    def at(cls, own: MembraneLaw, angle_deg: float) -> HungLaw:
        """The law of a weave that is rotated counterclockwise by an angle in the curtain; InputError by `check_law`."""
        check_law(own)
        return cls(own, rotation_on_triples(angle_deg), rotation_on_triples(-angle_deg))

    def in_weave(self, A: Array) -> Array:
        """Triples (n, 3) of the curtain in the frame of the weave."""
        return np.asarray(A @ self.to_weave.T)

    def support(self, S: Array) -> Array:
        return self.own.support(S @ self.to_weave.T)

    def half_spaces(self) -> HalfSpaces:
        start = self.own.half_spaces()
        return replace(start, S=start.S @ self.to_curtain.T)

    def cut(self, E: Array) -> Cut:
        cut = self.own.cut(np.column_stack([E[:, :3] @ self.to_weave.T, E[:, 3:]]))
        return replace(cut, S=cut.S @ self.to_curtain.T)

    def response(self, E: Array) -> Response:
        local = self.own.response(E @ self.to_weave.T)
        T = self.to_curtain
        return Response(local.energy, local.S @ T.T, T @ local.C @ self.to_weave, local.E_star @ T.T)

    def elastic(self) -> HungLaw:
        return replace(self, own=elastic_law(self.own))

    def plastic(self, *, strings: bool | Literal["elastic"] = False) -> HungLaw:
        """The law of rings that flow, on request until they are strings; InputError by `plastic_law`."""
        return replace(self, own=plastic_law(self.own, strings=strings))

    def parts(self, *, is_limit: bool = False) -> tuple[HungLaw, ...]:
        """Those of a `PlasticLaw`; with `is_limit` what is left of them where the curtain is stretched without end."""
        assert isinstance(self.own, PlasticLaw)
        return tuple(replace(self, own=one) for one in self.own.parts(is_limit=is_limit))

    def drawn(self) -> HungLaw:
        """The law of rings that are strings already, of a law of rings that flow until they are."""
        assert isinstance(self.own, PlasticLaw)
        assert self.own.strings is not None
        return replace(self, own=polyhedral_law(self.own.strings.S, self.own.strings.h))


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


def largest_stretch(law: MembraneLaw, directions: Array) -> Array:
    """How far the law lets a line along each direction (n, 2) stretch: sqrt(1 + 2 h(e e^T)) (n,)."""
    e = directions / np.linalg.norm(directions, axis=1)[:, None]
    return np.sqrt(np.maximum(1.0 + 2.0 * law.support(dyad(e)), 0.0))
