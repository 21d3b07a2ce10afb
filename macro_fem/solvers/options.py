"""Numbers that steer the cone programs: what each controls and what larger or smaller values do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from macro_fem.solvers.cones import Cones
from macro_fem.solvers.status import Accuracy
from rve.common.types import Array

LIFT = 0.1
"""Least relative distance from the boundary of a cone at which an iteration begins. Larger lifts make larger cone
residuals at the start, smaller ones short first steps."""
BOUNDARY = 0.98
"""Part of the way to the boundary of the cones that a step may go. Closer to 1 the next steps become short."""
SETTLED = 1e-2
"""Stagnation is checked only below this error; earlier, gap and residuals fall alternately."""
PATIENCE = 15
"""Steps below `SETTLED` without a new least error or half-space after which rounding stops the iteration."""

NEAR = 0.9
"""A missing half-space joins when it is nearer than this part of the distance to the nearest known one. Larger parts
add more half-spaces, smaller ones add them late, so that steps are cut short."""
SHARE = 0.3
"""A violated half-space enters with at most this part of the load of its point. Larger shares unbalance more."""
ROUNDED = 1e-13
"""Least relative distance from the boundary that double precision can tell from none."""
STRAY = 1e-2
"""A point gets no half-spaces while a cone vector of its own is off by more than this part of its radius."""
IDLE = 0.03
"""A half-space is idle below this part of its point's load and above this relative distance. Larger values drop more,
some of which have to join again."""
GOOD = 0.5
"""A step is found anew with the half-spaces in its way if they leave less than this part of it,"""
ANEW = 2
"""but not more often than this in a row. More often costs factorisations, less often short steps."""

RELEASED = 1e-7
"""Relative gap at which a guiding load is taken away. Earlier, slack parts move from where it has put them; later,
steps are short, as the path is closer to the boundary."""
COUNTED = 10.0
"""The gap of the answer may be this many times `gap`: it counts unbalanced forces REACH times and the cost of drawing
the answer inside."""
INSIDE = 1e-3
"""Relative margin in the law from which a state is good enough to draw the answer back to. Larger values keep earlier
states, farther from the answer."""
MOST_DRAWN = 1e-3
"""Longest part of the way to that state that the answer is drawn. More would hide a wrong answer."""


@dataclass(frozen=True)
class PathOptions:
    """When to stop. `gap` is relative to the energy scale, total load times size, and holds for unbalanced forces too.

    `violation` (relative to h + tr S/2) is what the last step may leave of the law. `cones` are half-spaces to begin
    with instead of the law's own few, say those of a curtain on the same triangles. `drawn`: whether a rigid answer is
    drawn back inside the law; without, only its dual value is a bound. `enough` ends the path as soon as it is true of
    the unknowns z and the dual value.
    """

    gap: float = 1e-9
    violation: float = 1e-8
    max_iterations: int = 400
    cones: Cones | None = None
    drawn: bool = True
    enough: Callable[[Array, float], bool] | None = None
    first_gap: float = 10.0
    """Gap of the first state in energy scales: 0.1 to 100 take about as many steps."""
    least_gap: float = 0.1
    """The path is followed to this part of the gap asked for, then residuals are removed. Smaller parts lose digits of
    Newton's matrix to gaps far below the residuals; larger ones leave less of the gap for rounding."""
    pruned_at: tuple[float, ...] = (1e-1, 1e-2, 1e-3)
    """Relative gaps at which idle half-spaces are dropped, largest first; none keeps all. Small gaps risk circles."""

    @property
    def accuracy(self) -> Accuracy:
        """What the numbers of the answer must not exceed."""
        return Accuracy(COUNTED * self.gap, self.gap, self.violation)


PATH = PathOptions()
"""The defaults."""
