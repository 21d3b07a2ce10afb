"""What the Newton solver is asked for and what it answers with: options, load steps, statuses, records of its work."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from macro_fem.fem.assembly import Array
from macro_fem.fem.linear import LinearOptions


class NewtonStatus(Enum):
    """How a solve ended, with what to try."""

    CONVERGED = "the forces balance to the tolerance"
    ITERATION_LIMIT = "max_iterations was reached before the forces balanced; allow more, or take smaller load steps"
    ROUND_OFF = (
        "the potential is at its minimum to round-off and the forces balance to better than 1e-5, but not to rtol: "
        "the answer is as good as the law's stress allows"
    )
    STALLED = (
        "the potential no longer falls along the step although the forces do not balance; "
        "the tangent of the law does not fit its stress, or max_gradient_step is too small"
    )
    NOT_CONVEX = "no regularisation made the tangent definite: the state is unstable; take smaller load steps"
    NOT_FINITE = (
        "the law has no finite energy at the start of a load step: a cell is turned inside out; take smaller steps"
    )

    @property
    def is_solution(self) -> bool:
        """Whether the displacement is an equilibrium: CONVERGED or ROUND_OFF."""
        return self in (NewtonStatus.CONVERGED, NewtonStatus.ROUND_OFF)


@dataclass(frozen=True)
class LoadStep:
    """Shares of the membrane's dead force and of its prescribed displacement that act at the end of a step."""

    force: float = 1.0
    displacement: float = 1.0


@dataclass(frozen=True)
class NewtonOptions:
    """When to stop and how to step.

    rtol: the free nodes' residual over the larger of applied and internal nodal forces, all in the 2-norm; whatever
    round-off in the strains allows is added and reported. max_iterations: per load step. max_gradient_step: largest
    change of F at any point in one Newton step; keeps the first steps from a slack start inside the curtain's size.
    regularisation: eps over the typical line load of the sheet at a relative residual of 1, as long as steps are long;
    compared with the stiffness of the law instead, stiff sheets took twice as many iterations.
    soften_after: iterations of the plain attempt before the law is softened and hardened again by `soften_ratio`, each
    stage to `soften_rtol`, in at most `soften_iterations`. Larger ratios or tolerances take more iterations in the end.
    soften_warm: largest softness when a stress to remember is given to `solve`.
    idle_steps: steps in a row, with neither a fall of the potential beyond round-off nor a new least residual, that end
    the search.
    predictor_order: highest order of extrapolation over past load steps (0: the tangent is used each time).
    """

    rtol: float = 1e-9
    max_iterations: int = 1000
    max_gradient_step: float = 1.0
    regularisation: float = 0.3
    predictor_order: int = 3
    soften_after: int = 20
    soften_ratio: float = 1.5
    soften_rtol: float = 1e-3
    soften_iterations: int = 150
    soften_warm: float = 30.0
    idle_steps: int = 15
    linear: LinearOptions = field(default_factory=LinearOptions)

    def __post_init__(self) -> None:
        """Refuse values that would stop the solver from working."""
        least = {
            "rtol": 0.0,
            "max_gradient_step": 0.0,
            "regularisation": 0.0,
            "soften_ratio": 1.0,
            "soften_rtol": 0.0,
        }
        for name, bound in least.items():
            if not getattr(self, name) > bound:
                raise ValueError(f"{name} = {getattr(self, name)} must be greater than {bound:g}")
        for name in ("max_iterations", "predictor_order", "soften_after", "idle_steps"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} = {getattr(self, name)} must not be negative")


@dataclass(frozen=True)
class NewtonRecord:
    """One iteration: the state it started from and the step it took.

    softness: factor on the compliance; potential N mm; residual relative (see `NewtonOptions.rtol`); length of the step
    that the line search took and evaluations of the law in it; eps N/mm; slack: share of the area without energy;
    seconds of assembly and of the factor with its solve; relative residual of the linear system, which conjugate
    gradients may leave above their tolerance: the step is then poorer, not wrong.
    """

    load_step: int
    iteration: int
    softness: float
    potential: float
    residual: float
    length: float
    evaluations: int
    eps: float
    slack: float
    assembly_s: float
    linear_s: float
    linear_residual: float


@dataclass(frozen=True, eq=False)
class StepResult:
    """The end of a load step: u (n_nodes, d), status, potential and stored energy N mm, and the bound on its error.

    energy_bound N mm: see the module header; it holds for convex laws. residual and tolerance: relative, both as used.
    reactions (n_nodes, d): forces of the supports on the sheet, N, zero at free components. With NOT_FINITE, u is where
    the step began, energies and residual are infinite and reactions zero.
    """

    load: LoadStep
    u: Array
    status: NewtonStatus
    potential: float
    stored: float
    energy_bound: float
    residual: float
    tolerance: float
    iterations: int
    reactions: Array


@dataclass(frozen=True)
class NewtonStatistics:
    """Work done: Newton iterations, factorizations, calls of the law, seconds, and who solved the linear systems."""

    iterations: int
    factorizations: int
    evaluations: int
    assembly_s: float
    linear_s: float
    wall_s: float
    unknowns: int
    matrix_entries: int
    linear_method: str


@dataclass(frozen=True, eq=False)
class NewtonSolution:
    """All load steps that were solved (the last one is the one that failed, if any), the history and the work."""

    steps: tuple[StepResult, ...]
    history: tuple[NewtonRecord, ...]
    statistics: NewtonStatistics

    @property
    def status(self) -> NewtonStatus:
        """Status of the last step."""
        return self.steps[-1].status

    @property
    def u(self) -> Array:
        """Displacement (n_nodes, d) at the end of the last step, mm."""
        return self.steps[-1].u

    @property
    def reactions(self) -> Array:
        """Forces of the supports (n_nodes, d) at the end of the last step, N."""
        return self.steps[-1].reactions
