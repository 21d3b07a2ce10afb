"""What a run on demand is asked for, its turns, and its answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from homogenize import LawInterval
from macro_fem.bounds.adapt import Level
from macro_fem.demand.ring_answers import Samples
from rve.common.errors import InputError

LEAST_ACCURACY, MOST_ACCURACY = 1e-5, 0.5


@dataclass(frozen=True)
class DemandOptions:
    """accuracy: width of the interval over total load times height, which for a curtain under its weight alone is that
    of the mean height over the height. The rest are limits at which a run gives up; InputError for values out of range.
    """

    accuracy: float = 5e-3
    most_cells: int = 30_000
    most_solves: int = 3_000
    most_turns: int = 60

    def __post_init__(self) -> None:
        if not LEAST_ACCURACY <= self.accuracy <= MOST_ACCURACY:
            raise InputError(
                f"accuracy = {self.accuracy:g}: must lie between {LEAST_ACCURACY:g} and {MOST_ACCURACY:g}, the width "
                "of the interval over the height"
            )


DEMAND = DemandOptions()
"""The defaults."""


@dataclass(frozen=True)
class Turn:
    """One turn: triangles, rows known, ring problems solved and read so far, bounds and their law's part in N mm.

    lower is nan in turns that only asked the rings.
    """

    cells: int
    rows: int
    ring_solves: int
    cache_hits: int
    upper: float
    lower: float
    law_part: float
    wall_s: float

    def to_dict(self) -> dict[str, Any]:
        """For summary.json, units in the names."""
        names = {"upper": "upper_N_mm", "lower": "lower_N_mm", "law_part": "law_part_N_mm"}
        return {names.get(key, key): value for key, value in vars(self).items()}


@dataclass(frozen=True, eq=False)
class Demand:
    """The answer on demand: the last curtain with its bounds, the law that the rings were asked for, and the way there.

    status: "converged" if the interval is as narrow as asked; `message` says what limits it otherwise.
    """

    level: Level
    law: LawInterval
    asked: Samples
    turns: tuple[Turn, ...]
    accuracy: float
    status: str
    message: str

    def to_dict(self) -> dict[str, Any]:
        """For summary.json: status and message of the whole, how the rings were asked, and every turn."""
        return {
            "status": self.status,
            "message": self.message,
            "accuracy": self.accuracy,
            "ring_solves": self.asked.solves,
            "cache_hits": self.asked.hits,
            "ring_failures": self.asked.failed,
            "rows": self.asked.count,
            "largest_contradiction_of_rows": self.law.raised,
            "turns": [turn.to_dict() for turn in self.turns],
        }


SENTENCES = {
    "converged": "the interval of rings and continuous curtain is as narrow as asked",
    "mesh_limit": "the mesh would need more than {cells} triangles; ask for less accuracy, or start with fewer cells",
    "law_limit": "the law's part, {law:.2g} of the height, is the larger one and further ring solves cannot "
    "narrow the interval within {solves} ring problems ({failed} directions without an answer); ask for less accuracy",
    "bound_limit": "the lower bound ended with status {bound}; allow more [solver] max_iterations or start with other "
    "cells",
    "contradiction": "answers of the rings contradict each other by {raised:.1e}: some are not the largest work, the "
    "lower bound is not proved; make a table with rve table, which seeks the largest states, and begin with it",
    "turn_limit": "the limit of turns was reached; ask for less accuracy",
    "curtain_limit": "the curtain of the next turn was not solved, and the interval is that of the turn before: {why}",
}
"""What each status says; only the first means that the accuracy was reached."""
