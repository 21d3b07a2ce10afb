"""The status of an answer, from the numbers that are reported with it: the gap between its bounds, the forces that do
not balance, the violation of the law, how far apart the supports are, and why the solver stopped.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from rve.common import Array

ROUNDING = 1e-6
"""Errors this much above what was asked are accepted once rounding stops a solver; the message gives them."""
AT_LIMIT = 1e-4
"""Relative stretch within which supports count as being at the mesh's largest stretch: `Reach`."""


def load_scale(force: Array, weight: Array) -> float:
    """What forces are compared with, N: the sum of the loads `force`, or a small part of the areas `weight`."""
    # N/mm2: what unbalanced forces are compared with in a curtain without load.
    return float(np.abs(force).sum()) or float(weight.sum()) * 1e-6


@dataclass(frozen=True)
class Evidence:
    """What an answer's own numbers say, all relative; or the largest ones with which it counts as one.

    gap: upper minus lower bound over load times size; unbalanced: sum of the forces on free unknowns that do not
    balance over the sum of the loads; violation: of the law, over h + tr S / 2, negative inside. drawn: where supports
    draw rings that flow harder than loads, the first two are over so many times the loads.
    """

    gap: float
    unbalanced: float
    violation: float
    drawn: float = 1.0

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are."""
        return bool(np.isfinite([self.gap, self.unbalanced, self.violation]).all())

    @property
    def error(self) -> float:
        """The largest of the three; infinite if one is not finite."""
        return max(abs(self.gap), self.unbalanced, self.violation) if self.is_finite else float("inf")

    def meets(self, asked: Evidence, more: float = 0.0) -> bool:
        """Whether no number is larger than asked by more than `more`."""
        found, limits = ((abs(one.gap), one.unbalanced, one.violation) for one in (self, asked))
        return self.is_finite and all(error <= limit + more for error, limit in zip(found, limits, strict=True))


@dataclass(frozen=True)
class Reach:
    """Bounds of the factor by which the supports could be moved apart before no admissible state is left.

    Above 1 some state leaves every half-space slack (Slater's condition), and multipliers are of the order of the load
    over (factor - 1). At 1 stresses that balance no load may be added, and the load does not bound line loads.
    """

    lower: float
    upper: float

    @property
    def is_free(self) -> bool:
        """Whether the mesh can certainly stretch further."""
        return self.lower > 1.0 + AT_LIMIT

    @property
    def excess(self) -> float:
        """The relative stretch beyond locking that the supports certainly ask for; 0 where they may be in reach."""
        return max(0.0, 1.0 / self.upper - 1.0) if self.upper > 0.0 else 0.0

    @property
    def is_out(self) -> bool:
        """Whether the supports are certainly out of reach."""
        return self.excess > AT_LIMIT

    @property
    def is_at_limit(self) -> bool:
        """Neither."""
        return not self.is_free and not self.is_out


FREE = Reach(np.inf, np.inf)
"""Supports that can be moved apart for ever, such as a single point."""


class Status(StrEnum):
    """How an answer ended; its message says what that means. Of curtains, then of rings on demand, of every ring."""

    CONVERGED = "converged"
    TAUT = "taut"
    INFEASIBLE = "infeasible"
    COLLAPSED = "collapsed"
    STALLED = "stalled"
    ITERATIONS = "iterations"
    NOT_FINITE = "not_finite"
    UNSETTLED = "unsettled"
    PIERCED = "pierced"
    MESH_LIMIT = "mesh_limit"
    LAW_LIMIT = "law_limit"
    BOUND_LIMIT = "bound_limit"
    CURTAIN_LIMIT = "curtain_limit"
    CONTRADICTION = "contradiction"
    OUT_OF_REACH = "out-of-reach"

    __repr__ = str.__repr__


@dataclass(frozen=True)
class Verdict:
    """One status per way to end, and its sentence: what happened and what to try."""

    status: Status
    message: str


class Judged:
    """An answer whose status and message are those of its verdict."""

    @property
    def verdict(self) -> Verdict:
        """Status and message, from the numbers of the answer."""
        raise NotImplementedError

    @property
    def status(self) -> Status:
        """One word for how it ended."""
        return self.verdict.status

    @property
    def message(self) -> str:
        """The sentence of the status."""
        return self.verdict.message


@dataclass(frozen=True)
class Settling:
    """How far the rounds of a curtain that depends on its own shape have come, relative to the loads.

    misfit: forces that turned in the last round; complementarity: reactions times the distance of their nodes from the
    body, over load times size; asked: what both must not exceed; between_nodes_mm: how deep bodies are inside the mesh
    between its nodes; depth: the same over half the least width of the body; crossed: how deep the mesh has been on its
    way there; is_wind: whether nothing but wind depends on the shape; smoothing: the stabilising tension that was tried
    since folds did not come to rest with the one asked for, else 0.
    """

    rounds: int
    misfit: float
    complementarity: float
    asked: float
    between_nodes_mm: float
    depth: float
    crossed: float = 0.0
    is_wind: bool = False
    smoothing: float = 0.0

    @property
    def is_settled(self) -> bool:
        """Whether both residuals are as small as asked."""
        return self.misfit <= self.asked and self.complementarity <= self.asked

    def verdict(self, last: Verdict) -> Verdict:
        """The verdict of the last round, or "unsettled" where that has converged and the rounds have not."""
        if last.status not in (Status.CONVERGED, Status.TAUT):
            return last
        if max(self.depth, self.crossed) > PIERCED:
            return Verdict(Status.PIERCED, THROUGH.format(self, 100.0 * max(self.depth, self.crossed)))
        if self.is_settled:
            return replace(last, message=last.message + SMOOTHED.format(self)) if self.smoothing else last
        return Verdict(Status.UNSETTLED, (RESTLESS if self.is_wind else UNSETTLED).format(self))


PIERCED = 0.5
"""Depth of a body between nodes from which it counts as having gone through the mesh."""
THROUGH = (
    "an obstacle has gone through the mesh between its nodes: cells were inside it by up to {1:.3g} % of half its "
    "least width, here or on the way; take a finer mesh, or more load steps"
)
UNSETTLED = (
    "contact with bodies, or wind on the present shape, has not settled after {0.rounds} rounds: forces of "
    "{0.misfit:.1e} of the load still turn, reactions times distances are {0.complementarity:.1e} of load times size; "
    "take more load steps, or a finer mesh"
)
SMOOTHED = "; its folds came to rest in the wind with stabilising_tension = {0.smoothing:g}"
RESTLESS = (
    "wind on the present shape has not settled after {0.rounds} rounds: forces of {0.misfit:.1e} of the load still "
    "turn, and a sheet that flutters has no rest; take less wind, a heavier bar at its "
    "lower edge, or a pressure that does not follow"
)
INFEASIBLE = (
    "the supports are farther apart than the mesh can stretch: its rings would have to give at least {excess:.3g} % "
    "more; move the supports together or use {remedy}"
)
BLOCKED = (
    "the curtain cannot clear its obstacles: no state that hangs from its supports is in their half-spaces, of which "
    "the cone program has a certificate; move the obstacles away or in smaller load steps, or the supports together, "
    "or take a finer mesh if a body is not much larger than its cells"
)
COLLAPSED = (
    "the loads are beyond the limit of the curtain (limit_factor): it stretches without end under them, and what is "
    "shown is the curtain whose rings do not flow; take smaller loads, thicker wire or a stronger metal"
)
CONVERGED = "the gap between upper and lower bound is closed"
DRAWN = "; supports draw rings {:.3g} times as hard as loads do, which is what errors are relative to"
ROUNDED = "the gap between upper and lower bound is closed up to rounding: {numbers}"
TAUT = (
    "the supports are as far apart as the mesh can stretch, within {limit:g} %: loads do not decide the line loads and "
    "support forces there. Those of this answer are those of rings that give{give}; move the supports together"
)
WHY = {
    "closed": "the answer does not have the accuracy asked for: {numbers}; ask for a wider solver.tolerance",
    "iterations": "stopped after {n} iterations with {numbers}: raise solver.max_iterations",
    "stalled": "rounding leaves no progress at {numbers}: ask for a wider solver.tolerance",
    "not_finite": "the law has no finite energy: a cell is turned inside out; take smaller load steps",
}
"""What a solver stopped for, where its answer is none."""
NUMBERS = (
    "a relative gap of {0.gap:.1e}, unbalanced forces of {0.unbalanced:.1e} of the load, a violation of the law of "
    "{0.violation:.1e}"
)


def judged(
    stop: str,
    evidence: Evidence,
    asked: Evidence,
    n: int,
    reach: Reach = FREE,
    relaxation: float | None = None,
    remedy: str = "a smaller gather",
) -> Verdict:
    """The status of an answer after `n` iterations.

    stop: why the solver stopped, "infeasible" by the supports, "blocked" by obstacles, "collapsed" by loads beyond the
    limit of rings that flow, or a key of `WHY`; relaxation:
    by how much the law was relaxed, None where rings are elastic; remedy: what helps where supports are out of reach.
    """
    if stop == "infeasible" or reach.is_out:
        return Verdict(Status.INFEASIBLE, INFEASIBLE.format(excess=100.0 * reach.excess, remedy=remedy))
    if stop == "collapsed":
        return Verdict(Status.COLLAPSED, COLLAPSED)
    if stop == "blocked":
        return Verdict(Status.INFEASIBLE, BLOCKED)
    numbers = NUMBERS.format(evidence) + DRAWN.format(evidence.drawn) * (evidence.drawn > 1.0)
    if not evidence.is_finite:
        return Verdict(Status.NOT_FINITE, WHY["not_finite"])
    is_rounded = stop in ("closed", "stalled") and evidence.meets(asked, ROUNDING)
    if not (evidence.meets(asked) or is_rounded):
        return Verdict(Status.STALLED if stop == "closed" else Status(stop), WHY[stop].format(n=n, numbers=numbers))
    if reach.is_at_limit:
        how = ", by their stiffness" if relaxation is None else f" {100.0 * relaxation:.3g} % beyond locking"
        return Verdict(Status.TAUT, TAUT.format(limit=100.0 * AT_LIMIT, give=how))
    closed = CONVERGED + DRAWN.format(evidence.drawn) * (evidence.drawn > 1.0)
    return Verdict(Status.CONVERGED, closed if evidence.meets(asked) else ROUNDED.format(numbers=numbers))
