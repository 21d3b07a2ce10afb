"""Which feature makes which extreme solvable, and the test that fails without it: the rows of features.csv."""

import csv
from pathlib import Path

from benchmarks.report.records import Section, table

with Path(__file__).with_suffix(".csv").open(encoding="utf-8") as file:
    FEATURES = tuple(csv.DictReader(file))
TEST = "test"


def measure(full: bool) -> Section:
    """The table; tests/test_benchmarks/test_stability.py checks that every module and every test exists."""
    files = dict.fromkeys(row[TEST].split("::")[0] for row in FEATURES)
    text = (
        "Each test solves the extreme, then switches the feature off and asserts that the same input fails. Run "
        f"`python -m pytest {' '.join(files)}`, and the long ones with `-m slow`."
    )
    rows = [row | {TEST: f"`{row[TEST]}`"} for row in FEATURES]
    conclusion = f"For {len(FEATURES)} features a test shows that the extreme fails without them."
    return Section("Features for the extremes", text, (table("Features and their tests", rows),), (), conclusion)
