"""A feature left out and switched on: times, the change of the result, and the table of it."""

from collections.abc import Sequence

from benchmarks.frame import Table, table
from benchmarks.measure import Row, at_most, count_of

NOISE = 1e-14
"""Changes below are round-off and shown by this bound."""
USED, LEFT_OUT = "used", "left out"
RATIO = "with / without"


def trial(
    feature: str,
    scene: str,
    seconds: tuple[float, float],
    change: float,
    tolerance: float,
    unit: str = "strain",
    default: str = LEFT_OUT,
    ok: bool = True,
) -> Row:
    """One feature in one scene: processor seconds without and with it, and the change of the result.

    `default`: what the scene decides; `ok`: whether both runs converged.
    """
    row = {"feature": feature, "scene": scene, "default": default, "time without, s": seconds[0]}
    row |= {"time with, s": seconds[1], RATIO: seconds[1] / seconds[0]}
    row |= {"change of the result": f"{at_most(change, NOISE)} {unit}" if ok else "failed"}
    return row | {"tolerance": f"{tolerance:.1e} {unit}", "same": bool(ok and change <= tolerance)}


def trial_table(title: str, trials: Sequence[Row]) -> Table:
    """The trials."""
    return table(title, trials, {"time without, s": ".3f", "time with, s": ".3f", RATIO: ".2f"})


def verdict(trials: Sequence[Row]) -> str:
    """How many features leave the result unchanged, and which do not."""
    changed = [f"`{row['feature']}` ({row['scene']})" for row in trials if not row["same"]]
    unchanged = count_of([row["same"] for row in trials])
    text = f"{unchanged} features leave the result unchanged, to the solver's tolerance."
    return text + (f" Changed: {', '.join(changed)}." if changed else "")
