"""What a path is solved with beside law and load, and what it ends in."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from homogenize import MembraneLaw
from macro_fem.fem.supported import SupportedFem
from macro_fem.solvers.cone_program import Iteration
from macro_fem.solvers.cones import Cones, first_cones
from macro_fem.solvers.inertia import NO_INERTIA, Inertia
from macro_fem.solvers.options import PATH
from macro_fem.solvers.status import FREE, Accuracy, Evidence, Judged, Reach, Verdict, judged
from macro_fem.solvers.walls import Walls
from rve.common.types import Array

RIGID = np.zeros((3, 3))
"""The compliance of a rigid curtain."""


@dataclass(frozen=True, eq=False)
class Terms:
    """What a curtain has beside its law and its load.

    `compliance` (3, 3) is in mm/N and tensor components, such as `law.compliance`. `guide` (n,), N, are small forces
    that act until the gap is `RELEASED`: they give a shape to what the load leaves without one. `walls`: half-spaces on
    nodes; then the discretisation is a `SupportedFem`. `inertia`: a quadratic term in the positions, for a step of
    motion.
    """

    compliance: Array = field(default_factory=lambda: RIGID)
    guide: Array | None = None
    walls: Walls | None = None
    inertia: Inertia = NO_INERTIA


RIGID_TERMS = Terms()
"""A rigid curtain under its load alone."""


@dataclass(frozen=True)
class PathResult(Judged):
    """Free unknowns z, stress and multipliers of a curtain, with the numbers from which its status follows.

    `stop` is why the solver stopped, `evidence` the errors of the answer, `asked` what they must not exceed. `primal`
    is -l.z plus the stored energy, an upper bound of the least potential of this discretisation where the law is
    obeyed, `dual` a lower bound of it, N mm, without the constant that supports add. P (nq, d, 2) is the equilibrated
    stress in N per mm of reference length, y_tail (nc, 2 d) its parts, P = -sum of y L. wall_forces (m,), N: the
    reaction of each half-space on a node.
    """

    stop: str
    evidence: Evidence
    asked: Accuracy
    z: Array
    lam: Array
    y_tail: Array
    cones: Cones
    P: Array
    primal: float
    dual: float
    history: tuple[Iteration, ...] = field(repr=False)
    reach: Reach = FREE
    wall_forces: Array = field(default_factory=lambda: np.zeros(0), repr=False)

    @cached_property
    def S(self) -> Array:
        """The tensile second Piola-Kirchhoff line load sum of lam_i S_i (nq, 3), with P = F S at the exact answer."""
        return self.cones.stress(self.lam)

    @property
    def iterations(self) -> int:
        """Steps of the path."""
        return len(self.history)

    @cached_property
    def verdict(self) -> Verdict:
        """Status and message, from the numbers."""
        return judged(self.stop, self.evidence, self.asked, self.iterations, self.reach)

    @property
    def converged(self) -> bool:
        """Whether the gap was closed."""
        return self.status == "converged"


def unsolved(fem: SupportedFem, law: MembraneLaw, z: Array, stop: str = "infeasible") -> PathResult:
    """What stands for an answer where supports or obstacles leave none: unknowns z without stress."""
    cones = first_cones(law, len(fem.weight))
    P = 0.0 * fem.gradient(z)
    return PathResult(
        stop=stop,
        evidence=Evidence(np.inf, np.inf, np.inf),
        asked=PATH.accuracy,
        z=z,
        lam=np.zeros(len(cones)),
        y_tail=np.zeros((len(cones), 2 * P.shape[1])),
        cones=cones,
        P=P,
        primal=np.nan,
        dual=np.nan,
        history=(),
    )
