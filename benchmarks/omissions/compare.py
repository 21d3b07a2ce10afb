"""A feature left out and put in: times, the change of the result, and the table of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.pages.measuring import at_most
from benchmarks.pages.model import Column, Curve, Diagram, Table

NOISE = 1e-14
"""Changes below are round-off and shown by this bound."""
USED, LEFT_OUT = "used", "left out"
COLUMNS = (
    Column("feature"),
    Column("scene"),
    Column("by itself"),
    Column("time without, s", ".3f", timed=True),
    Column("time with, s", ".3f", timed=True),
    Column("with / without", ".2f", timed=True),
    Column("change of the result"),
    Column("tolerance"),
    Column("same"),
)


@dataclass(frozen=True)
class Trial:
    """One feature in one scene: processor times in s without and with it, and the change of the result.

    `change` and `tolerance` share the unit of `unit`; by_itself: what the scene decides; ok: whether the run with the
    feature came to its end.
    """

    feature: str
    scene: str
    by_itself: str
    without: float
    with_it: float
    change: float
    tolerance: float
    unit: str = "strain"
    ok: bool = True

    @property
    def is_same(self) -> bool:
        """Whether the feature changes nothing above the solver's tolerance."""
        return self.ok and self.change <= self.tolerance

    @property
    def ratio(self) -> float:
        """Time with the feature over time without."""
        return self.with_it / self.without


def table(title: str, trials: Sequence[Trial], note: str = "") -> Table:
    """The trials as rows."""
    rows = [
        (
            trial.feature,
            trial.scene,
            trial.by_itself,
            trial.without,
            trial.with_it,
            trial.ratio,
            f"{at_most(trial.change, NOISE)} {trial.unit}" if trial.ok else "failed",
            f"{trial.tolerance:.1e} {trial.unit}",
            "yes" if trial.is_same else "no",
        )
        for trial in trials
    ]
    return Table(title, COLUMNS, tuple(rows), note)


def bars(key: str, title: str, trials: Sequence[Trial]) -> Diagram:
    """Time with each feature over the time without, a bar for each scene."""
    features = list(dict.fromkeys(trial.feature for trial in trials))
    curves = []
    for scene in dict.fromkeys(trial.scene for trial in trials):
        here = [trial for trial in trials if trial.scene == scene]
        places = tuple(float(features.index(trial.feature)) for trial in here)
        curves.append(Curve(scene, places, tuple(trial.ratio for trial in here)))
    ticks = tuple(feature.replace("-", "-\n", 1).replace(" ", "\n") for feature in features)
    return Diagram(key, title, "feature", "time with / time without", tuple(curves), bars=True, ticks=ticks, base=1.0)


def verdict(trials: Sequence[Trial]) -> str:
    """What the trials say together, as a sentence made of their numbers."""
    same = sum(trial.is_same for trial in trials)
    text = f"{same} of {len(trials)} forced features leave the result where it was, to the solver's tolerance."
    changed = [f"`{trial.feature}` ({trial.scene})" for trial in trials if not trial.is_same]
    return text + (f" Not the same: {', '.join(changed)}." if changed else "")
