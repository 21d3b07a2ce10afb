"""What a run of rings used and left out, and why: the decisions of the solver in words."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, NamedTuple


class Decision(NamedTuple):
    """A feature, whether the run has used it, and why."""

    feature: str
    used: bool
    why: str

    def __str__(self) -> str:
        return f"{self.feature:<15} {'used' if self.used else 'left out':<9} {self.why}"


@dataclass(frozen=True)
class Work:
    """What the direct solver met.

    cases; symmetric: how many were solved in symmetric coordinates alone; retried: cases that took more than one
    attempt in all coordinates; limits: cases replaced by the limit from inside the tensile
    cone; listed: pairs of rings in the equations; least_near, most_near: how many pairs of the weave are near enough to
    touch in a locked state; unlisted_gap: least gap of pairs that the weave does not list, in r1; widened: whether such
    pairs overlapped and all pairs were listed.
    """

    cases: int
    symmetric: int
    retried: int
    limits: int
    listed: int
    least_near: int
    most_near: int
    unlisted_gap: float
    widened: bool

    def plus(self, other: Work) -> Work:
        """Both blocks of cases together."""
        return Work(
            self.cases + other.cases,
            self.symmetric + other.symmetric,
            self.retried + other.retried,
            self.limits + other.limits,
            max(self.listed, other.listed),
            min(self.least_near, other.least_near),
            max(self.most_near, other.most_near),
            min(self.unlisted_gap, other.unlisted_gap),
            self.widened or other.widened,
        )


def decisions(provenance: dict[str, Any]) -> list[Decision]:
    """What the run behind a table used and left out, from the table's provenance."""
    gyroscopic = "no frictionless contact spins a torus about its own axis"
    constraints = "eliminated: rings of one class move alike, 9 coordinates instead of 60"
    if provenance["method"] != "direct":
        paper = "the paper's scheme follows the motion"
        return [
            Decision("damping", True, paper),
            Decision("inertia", True, paper),
            Decision("gyroscopic", False, gyroscopic),
            Decision("constraints", False, constraints),
        ]
    work = Work(**{field.name: provenance["work"][field.name] for field in fields(Work)})
    static = "static load: the equations of the locked state hold no velocities"
    near = f"{work.least_near} to {work.most_near} of the pairs of rings are near enough to touch"
    apart = f"the nearest stay at least {work.unlisted_gap:.2g} r1 apart"
    overlap = "rings that the weave does not list as neighbours would overlap"
    rest = work.cases - work.symmetric
    symmetric = f"{work.symmetric} of {work.cases} locked states are symmetric and stable against asymmetric motions"
    retried = f"{work.retried} of {work.cases} cases took more than one attempt in all coordinates"
    limits = f"{work.limits} of {work.cases} cases are limits from inside the tensile cone"
    return [
        Decision("damping", False, static),
        Decision("inertia", False, static),
        Decision("gyroscopic", False, static),
        Decision("constraints", False, constraints),
        Decision("asymmetry", rest > 0, symmetric + (f"; {rest} were solved in all coordinates" if rest else "")),
        Decision("far-pairs", False, f"{near}; {work.listed} are listed"),
        Decision("unlisted-pairs", work.widened, overlap if work.widened else apart),
        Decision("idle-curvature", False, "contacts without force have no curvature in the Jacobian"),
        Decision("attempts", work.retried > 0, retried),
        Decision("limits", work.limits > 0, limits),
    ]
