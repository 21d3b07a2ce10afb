"""What a run of rings used and left out, and why: one short table made from what the solver met."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any


@dataclass(frozen=True)
class SolverWork:
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

    def plus(self, other: SolverWork) -> SolverWork:
        """Both blocks of cases together."""
        return SolverWork(
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


def features(provenance: dict[str, Any]) -> list[dict[str, Any]]:
    """What the run behind a table used and left out, from the table's provenance: rows of feature, used and why."""
    if provenance["method"] != "direct":
        return [{"feature": "motion", "used": True, "why": "the paper's scheme follows damped rings with inertia"}]
    work = SolverWork(**{field.name: provenance["work"][field.name] for field in fields(SolverWork)})
    near = f"{work.least_near} to {work.most_near} of {work.listed} pairs of rings are near enough to touch"
    apart = f"{near}, others stay {work.unlisted_gap:.2g} r1 apart"
    overlap = "rings that the weave does not list as neighbours would overlap"
    rows = [
        ("motion", False, "static load: the equations of the locked state hold no velocities"),
        ("asymmetry", work.symmetric < work.cases, f"{work.symmetric} of {work.cases} locked states are symmetric"),
        ("unlisted-pairs", work.widened, overlap if work.widened else apart),
        ("attempts", work.retried > 0, f"{work.retried} of {work.cases} cases took more than one attempt"),
        ("limits", work.limits > 0, f"{work.limits} of {work.cases} cases are limits from inside the tensile cone"),
    ]
    return [dict(zip(("feature", "used", "why"), row, strict=True)) for row in rows]
