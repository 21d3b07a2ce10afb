"""A stiff law made soft on the way to its answer, so that a Newton step meets fewer walls.

For a law whose strain splits into a locked and an elastic part, E = E* + D S with one compliance D, the dual problem of
the membrane has the term -1/2 S : D S. Adding -(s - 1)/2 (S - S0) : D (S - S0) to it (Rockafellar's proximal point
algorithm, SIAM J. Control Optim. 14, 1976) turns the law into

    Psi_s(E) = Psi(E + (s - 1) D S0) / s,    S_s = S(E + (s - 1) D S0) / s,

the law with s times the compliance and memory of the stress S0. At S = S0 both laws agree: when S0 has become the
stress of the answer, s may fall to 1 and nothing moves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from homogenize import Response
from macro_fem.fem.materials import ElasticLaw
from rve.common.types import Array


@runtime_checkable
class CompliantLaw(ElasticLaw, Protocol):
    """A law with E - E* = compliance S: `homogenize`'s laws are of this kind."""

    @property
    def compliance(self) -> Array:
        """(3, 3) in tensor components, mm/N."""
        ...


@dataclass(frozen=True, eq=False)
class SoftenedLaw:
    """`law` with `softness` times its compliance, in agreement with it at the stress S0 (n, 3) of n fixed points."""

    law: CompliantLaw
    softness: float
    S0: Array

    def response(self, E: Array) -> Response:
        """Psi_s, S_s and dS_s/dE at E (n, 3).

        >>> from macro_fem.fem.materials import TensionFieldSheet
        >>> law = TensionFieldSheet(young=2.0, poisson=0.3)
        >>> E = np.array([[0.02, 0.01, 0.01]])
        >>> stress = law.response(E).S
        >>> bool(np.allclose(SoftenedLaw(law, 50.0, stress).response(E).S, stress))
        True
        """
        shift = (self.softness - 1.0) * self.S0 @ self.law.compliance.T
        r = self.law.response(E + shift)
        s = self.softness
        return Response(r.energy / s, r.S / s, r.C / s, r.E_star)


def softnesses(law: CompliantLaw, line_load: float, ratio: float, warm: float | None) -> list[float]:
    """Falling factors > 1 on the compliance, by `ratio`; the first makes the law about as soft as the load is large.

    `warm` caps them: with a good stress to remember, little softness is enough.
    """
    stiffness = 3.0 / float(np.trace(law.compliance))
    first = max(stiffness / line_load, 1.0)
    if warm is not None:
        first = min(first, warm)
    count = int(np.ceil(np.log(first) / np.log(ratio)))
    return [ratio**k for k in range(count, 0, -1)]
