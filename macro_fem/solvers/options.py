"""Numbers that steer the cone programs: what each controls and what larger or smaller values do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from macro_fem.solvers.cones import Cones
from macro_fem.solvers.status import Accuracy
from rve.common.types import Array
from rve.common.values import Options, entry, finite, list_of, number, whole


@dataclass(frozen=True)
class StepOptions(Options):
    """How the interior-point iteration steps; InputError for values that would stop it from working."""

    first_gap: float = number(10.0, above=0.0, most=1e6)
    """Gap of the first state in energy scales: 0.1 to 100 take about as many steps."""
    lift: float = number(0.1, above=0.0, most=1.0)
    """Least relative distance from the boundary of a cone at which an iteration begins. Larger lifts make larger cone
    residuals at the start, smaller ones short first steps."""
    boundary: float = number(0.98, above=0.0, most=1.0 - 1e-6)
    """Part of the way to the boundary of the cones that a step may go. Closer to 1 the next steps become short."""
    least_gap: float = number(0.1, above=0.0, most=1.0)
    """The path is followed to this part of the gap asked for, then residuals are removed. Smaller parts lose digits of
    Newton's matrix to gaps far below the residuals; larger ones leave less of the gap for rounding."""
    settled: float = number(1e-2, above=0.0, most=1.0)
    """Below this error stagnation is checked; earlier, gap and residuals fall alternately."""
    patience: int = whole(15, least=1, most=1000)
    """Steps below `settled` without a new least error or half-space after which rounding stops the iteration."""


STEPS = StepOptions()
"""The defaults."""


@dataclass(frozen=True)
class CutOptions(Options):
    """When half-spaces join and leave a program; InputError for values that make no sense."""

    near: float = number(0.9, least=0.0, most=1.0)
    """A missing half-space joins when it is nearer than this part of the distance to the nearest known one. Larger
    parts add more half-spaces, smaller ones add them late, so that steps are cut short."""
    share: float = number(0.3, above=0.0, most=1.0)
    """A violated half-space enters with at most this part of the load of its point. Larger shares unbalance more."""
    rounded: float = number(1e-13, above=0.0, most=1e-3)
    """Least relative distance from the boundary that double precision can tell from none."""
    stray: float = number(1e-2, above=0.0, most=1.0)
    """A point gets no half-spaces while a cone vector of its own is off by more than this part of its radius."""
    idle: float = number(0.03, least=0.0, most=1.0)
    """A half-space is idle below this part of its point's load and above this relative distance. Larger values drop
    more, some of which have to join again."""
    pruned_at: tuple[float, ...] = entry(list_of(finite(above=0.0, most=1.0), "gaps", most=100), (1e-1, 1e-2, 1e-3))
    """Relative gaps at which idle half-spaces are dropped, largest first; none keeps all. Small gaps risk circles."""
    good: float = number(0.5, least=0.0, most=1.0)
    """A step is found anew with the half-spaces in its way if they leave less than this part of it,"""
    anew: int = whole(2, least=0, most=100)
    """but not more often than this in a row. More often costs factorisations, less often short steps."""


CUTS = CutOptions()
"""The defaults."""


@dataclass(frozen=True)
class PathOptions(Options):
    """When to stop. `gap` is relative to the energy scale, total load times size, and holds for unbalanced forces too.

    `violation` (relative to h + tr S/2) is what the last step may leave of the law. `cones` are half-spaces to begin
    with instead of the law's own few, say those of a curtain on the same triangles. `corrector`: whether steps are
    corrected to second order. `drawn`: whether a rigid answer is drawn back inside the law; without, only its dual
    value is a bound. `enough` ends the path as soon as it is true of the unknowns z and the dual value. InputError for
    tolerances that are not positive and for no iterations.
    """

    gap: float = number(1e-9, above=0.0, most=1.0)
    violation: float = number(1e-8, above=0.0, most=1.0)
    max_iterations: int = whole(400, least=1, most=1_000_000)
    cones: Cones | None = None
    corrector: bool = True
    drawn: bool = True
    enough: Callable[[Array, float], bool] | None = None
    released: float = number(1e-7, above=0.0, most=1.0)
    """Relative gap at which a guiding load is taken away. Earlier, slack parts move from where it has put them; later,
    steps are short, as the path is closer to the boundary."""
    counted: float = number(10.0, least=1.0, most=1e3)
    """The gap of the answer may be this many times `gap`: it counts unbalanced forces REACH times and the cost of
    drawing the answer inside."""
    inside: float = number(1e-3, above=0.0, most=1.0)
    """Relative room in the law from which a state is good enough to draw the answer back to. Larger values keep earlier
    states, farther from the answer."""
    most_drawn: float = number(1e-3, above=0.0, most=1.0)
    """Longest part of the way to that state that the answer is drawn. More would hide a wrong answer."""
    steps: StepOptions = STEPS
    cuts: CutOptions = CUTS

    @property
    def accuracy(self) -> Accuracy:
        """What the numbers of the answer must not exceed."""
        return Accuracy(self.counted * self.gap, self.gap, self.violation)


PATH = PathOptions()
"""The defaults."""
