"""The cloth law: inextensible in every direction and freely wrinkling, without parameters.

A strain is admissible if no line becomes longer: C = I + 2E has no eigenvalue above 1, so E has none above 0. Tension
fields of thin fabrics and films obey it, and its curtains have closed forms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homogenize.laws.geometry import fibres
from homogenize.laws.protocol import Cut, HalfSpaces, check_finite
from homogenize.laws.stored import Law
from rve.common import Array
from rve.common.tensor import disc, eigenvalues, from_disc

FIRST_FIBRES = 8
"""Directions that the first half-spaces hold. More cost time at every point; others join where they matter."""


@dataclass(frozen=True, eq=False, repr=False)
class ClothLaw(Law, kind="cloth"):
    """Fabric whose lines shorten freely and never stretch.

    >>> cut = ClothLaw().cut(np.array([[0.1, 0.0, -0.3]]))
    >>> cut.S.tolist(), cut.h.tolist(), [round(float(x), 12) for x in cut.violation]
    ([[1.0, 0.0, 0.0]], [0.0], [0.1])
    """

    def support(self, S: Array) -> Array:
        check_finite(S, "line loads")
        return np.zeros(len(S))

    def half_spaces(self) -> HalfSpaces:
        """No fibre of a few directions and no mean of all of them stretches."""
        return HalfSpaces(np.vstack([fibres(FIRST_FIBRES), [0.5, 0.0, 0.5]]), np.zeros(FIRST_FIBRES + 1))

    def cut(self, E: Array) -> Cut:
        """The fibre that each E (n, 3) stretches most: the eigenvector of the larger eigenvalue, which it violates."""
        check_finite(E)
        away = disc(E)
        radius = np.hypot(away[:, 0], away[:, 1])[:, None]
        unit = np.where(radius > 0.0, away / np.where(radius > 0.0, radius, 1.0), [1.0, 0.0])
        return Cut(from_disc(unit), np.zeros(len(E)), eigenvalues(E)[1])
