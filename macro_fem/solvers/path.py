"""What a path is asked for, what a curtain has beside law and load, and what the path ends in."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse

from homogenize import MembraneLaw
from macro_fem.fem.supported import SupportedFem
from macro_fem.solvers.cones import Cones
from macro_fem.solvers.status import FREE, Evidence, Judged, Reach, Verdict, judged
from macro_fem.solvers.walls import Walls
from rve.common import Array

COUNTED = 10.0
"""The gap of the answer, with unbalanced forces REACH times and the cost of drawing it inside, over `gap`."""


@dataclass(frozen=True)
class PathOptions:
    """When to stop. `gap` is relative to the energy scale, total load times size, and holds for unbalanced forces too;
    of rings that flow to what supports draw them to, and of their limit to it, where that is more.

    `violation` (relative to h + tr S/2) is what the last step may leave of the law. `cones` are half-spaces to begin
    with instead of the law's own few; of a step of motion also their multipliers `lam` (nc,) in N/mm and the `pushes`
    (m,) of its walls in N. `drawn`: whether a rigid answer is drawn back inside the law; without, only its
    dual value is a bound. `enough` ends the path as soon as it is true of the unknowns z and the dual value.
    """

    gap: float = 1e-9
    violation: float = 1e-8
    max_iterations: int = 400
    cones: Cones | None = None
    lam: Array | None = None
    pushes: Array | None = None
    drawn: bool = True
    enough: Callable[[Array, float], bool] | None = None
    first_gap: float = 10.0
    """Gap of the first state in energy scales: 0.1 to 100 take about as many steps."""
    least_gap: float = 0.1
    """The path is followed to this part of the gap asked for, then residuals are removed. Smaller parts lose digits;
    larger ones leave less of the gap for rounding."""
    pruned_at: tuple[float, ...] = (1e-1, 1e-2, 1e-3)
    """Relative gaps at which idle half-spaces are dropped, largest first; none keeps all. Small gaps risk circles."""

    @property
    def accuracy(self) -> Evidence:
        """What the numbers of the answer must not exceed."""
        return Evidence(COUNTED * self.gap, self.gap, self.violation)


PATH = PathOptions()


@dataclass(frozen=True, eq=False)
class Inertia:
    """The quadratic term of a step of motion, (x - x_hat).W (x - x_hat) / 2 over the nodes at x = x_held + T z.

    W (n_nodes, d, d): one symmetric block per node, positive definite where it is free, its mass over (beta h)^2 and
    what else resists its motion over beta h, N/mm. x_hat (n_nodes, d), mm. force_scale, N, and energy_scale, N mm: what
    residuals and gap are compared with besides the loads.
    """

    fem: SupportedFem
    W: Array
    x_hat: Array
    force_scale: float = 0.0
    energy_scale: float = 0.0

    def force(self, z: Array) -> Array:
        """T^T W (x_hat - x) (n,), N."""
        return -self.fem.gather(times(self.W, self.fem.positions(z) - self.x_hat))

    def energy(self, z: Array) -> float:
        """(x - x_hat).W (x - x_hat) / 2, N mm."""
        away = self.fem.positions(z) - self.x_hat
        return 0.5 * float((away * times(self.W, away)).sum())

    @cached_property
    def matrix(self) -> sparse.csc_matrix:
        """T^T W T (n, n): its part of Newton's matrix."""
        n, d = self.x_hat.shape
        whole = sparse.bsr_matrix((self.W, np.arange(n), np.arange(n + 1)), shape=(n * d, n * d))
        return sparse.csc_matrix(self.fem.T.T @ whole @ self.fem.T)

    def deficit(self, r: Array) -> float:
        """r.(T^T W T)^-1 r / 2, N mm: what unbalanced forces r (n,) can gain."""
        return 0.5 * float(r @ self._factor.solve(r))

    @cached_property
    def _factor(self) -> Any:
        return sparse.linalg.splu(self.matrix)


def times(W: Array, v: Array) -> Array:
    """W v at every node (n_nodes, d)."""
    return np.asarray((W @ v[:, :, None])[:, :, 0])


@dataclass(frozen=True, eq=False)
class Flow:
    """Rings that flow, by a `PlasticLaw`: strength (nq,), by how many times those at each point are stronger than those
    of the law; laws: those of the half-spaces that tau, and e of elastic strings, widen; is_limit: whether the largest
    factor on the load is asked for, and the way on which rings flow under it.
    """

    strength: Array
    laws: tuple[MembraneLaw, ...]
    is_limit: bool = False


@dataclass(frozen=True, eq=False)
class Terms:
    """What a curtain has beside its law and its load.

    compliance (3, 3): mm/N in tensor components. walls: half-spaces on points. inertia: of a step of motion. flow: of
    rings that flow.
    """

    compliance: Array = field(default_factory=lambda: np.zeros((3, 3)))
    walls: Walls | None = None
    inertia: Inertia | None = None
    flow: Flow | None = None


RIGID_TERMS = Terms()


@dataclass(frozen=True)
class PathResult(Judged):
    """Free unknowns z and stress of a curtain, with the numbers from which its status follows.

    `stop` is why the solver stopped, `evidence` the errors of the answer, `asked` what they must not exceed. `primal`
    is -l.z plus the stored energy, an upper bound of the least potential of this discretisation where the law is
    obeyed, `dual` a lower bound of it, N mm, without the constant that supports add. Equilibrated stress in N per mm of
    reference length: P (nq, d, 2), and tensile S = sum of lam_i S_i (nq, 3), lam (nc,) of the `cones`, with P = F S at
    the exact answer; psi (nq,): sum of c |y_FL|, no less than any P:F in the law, with what elastic strings
    store no less than P:F less that. wall_forces (m,), N: the reaction of each half-space.
    Of rings that flow tau (nq,), N/mm, is the plastic work per area, with what elastic strings store, and S_strings
    (nq, 3) what strings bear of S; where their limit is asked for, `dual` and `primal` bound the factor on the load.
    """

    stop: str
    evidence: Evidence
    asked: Evidence
    z: Array
    S: Array
    psi: Array
    cones: Cones
    P: Array
    primal: float
    dual: float
    iterations: int
    wall_forces: Array
    reach: Reach = FREE
    tau: Array | None = None
    S_strings: Array | None = None
    lam: Array | None = None

    @cached_property
    def verdict(self) -> Verdict:
        return judged(self.stop, self.evidence, self.asked, self.iterations, self.reach)
