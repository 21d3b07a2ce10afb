"""What a scene of rings needs, what it leaves out, and why; `force` of DirectOptions puts it back in.

Decisions are made by the solvers, from the weave, the load and the poses they meet; here is what they did, in words.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple

from rve.common.errors import InputError
from rve.paper.motion import TERMS

FEATURES = (*TERMS, "asymmetry", "far-pairs", "unlisted-pairs", "idle-curvature")
"""What a direct run leaves out where it can; the first four belong to the motion of the paper's scheme."""
MOVING = ("gyroscopic",)
"""What the paper's scheme leaves out."""


class Decision(NamedTuple):
    """A feature, whether the run has used it, and why in this scene."""

    feature: str
    used: bool
    why: str

    def __str__(self) -> str:
        return f"{self.feature:<15} {'used' if self.used else 'left out':<9} {self.why}"


@dataclass(frozen=True)
class Work:
    """What the direct solver has met: cases; how many of them it solved in symmetric coordinates alone; listed pairs,
    and the least and the most of them in reach of each other in a locked state; least gap of unlisted pairs in r1
    (infinite if all are listed); whether they had to be listed.
    """

    cases: int
    symmetric: int
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
            max(self.listed, other.listed),
            min(self.least_near, other.least_near),
            max(self.most_near, other.most_near),
            min(self.unlisted_gap, other.unlisted_gap),
            self.widened or other.widened,
        )

    def to_dict(self) -> dict[str, Any]:
        """For the table's sidecar file."""
        return asdict(self)


def checked_force(names: tuple[str, ...], known: tuple[str, ...] = FEATURES) -> tuple[str, ...]:
    """The features to force, "all" written out; InputError for one that is not known.

    >>> checked_force(("far-pairs",))
    ('far-pairs',)
    """
    for name in names:
        if name not in (*known, "all"):
            raise InputError(f"--force = {name!r}: known are all, {', '.join(known)}")
    return tuple(name for name in known if name in names or "all" in names)


def motion_terms(force: tuple[str, ...]) -> tuple[str, ...]:
    """The terms of a motion that the forced features ask for, with those they need; none for a static run."""
    last = max((TERMS.index(name) for name in force if name in TERMS), default=-1)
    return TERMS[: last + 1]


def decisions(provenance: dict[str, Any]) -> list[Decision]:
    """What the run behind a table by the direct solver used and left out, from its provenance."""
    force = tuple(provenance["options"]["force"])
    work = Work(**{field.name: provenance["work"][field.name] for field in fields(Work)})
    terms = motion_terms(force)
    moves = "forced: the rings move into the locked state, and Newton's method closes their contacts"
    static = "static load: the equations of the locked state hold no speeds"
    whys = {
        "damping": static,
        "inertia": static,
        "gyroscopic": static,
        "constraints": "rings of one class move alike: 9 coordinates instead of 60 and their constraints",
    }
    found = [Decision(name, name in terms, moves if name in terms else why) for name, why in whys.items()]
    return [*found, _symmetry(work, force, terms), *_pairs(work, force), _curvature(force)]


def moving_decisions(provenance: dict[str, Any]) -> list[Decision]:
    """The same for the paper's scheme."""
    gyroscopic = provenance["options"]["gyroscopic"]
    spin = "forced: they vanish" if gyroscopic else "no contact without friction spins a torus about its own axis"
    paper = "the paper's scheme follows the motion"
    return [
        Decision("damping", True, paper),
        Decision("inertia", True, paper),
        Decision("gyroscopic", gyroscopic, spin),
        Decision("constraints", False, "eliminated: 9 coordinates instead of 60 and their constraints"),
    ]


def _symmetry(work: Work, force: tuple[str, ...], terms: tuple[str, ...]) -> Decision:
    if "asymmetry" in force or terms:
        return Decision(
            "asymmetry", True, "forced: all coordinates and pairs from the start" if not terms else "a motion"
        )
    rest = work.cases - work.symmetric
    if not work.symmetric:
        return Decision("asymmetry", True, "no locked state was confirmed in the symmetric coordinates of the weave")
    solved = f"{work.symmetric} of {work.cases} locked states are symmetric and resist all asymmetric motions"
    return Decision("asymmetry", rest > 0, solved + (f"; {rest} were solved with all coordinates" if rest else ""))


def _pairs(work: Work, force: tuple[str, ...]) -> list[Decision]:
    near = f"{work.least_near} to {work.most_near} of the {work.listed} pairs of rings are near enough to touch"
    is_forced = "far-pairs" in force
    far = Decision("far-pairs", is_forced, f"forced: all are sampled, though {near}" if is_forced else near)
    if "unlisted-pairs" in force:
        return [far, Decision("unlisted-pairs", True, "forced: all pairs up to four cells apart are listed")]
    if work.widened:
        return [far, Decision("unlisted-pairs", True, "rings that the weave does not list as neighbours would overlap")]
    why = f"the nearest stay at least {work.unlisted_gap:.2g} r1 apart"
    return [far, Decision("unlisted-pairs", False, why)]


def _curvature(force: tuple[str, ...]) -> Decision:
    if "idle-curvature" in force:
        return Decision("idle-curvature", True, "forced: the curvature of every contact is computed")
    return Decision("idle-curvature", False, "contacts that carry no force bend no path")
