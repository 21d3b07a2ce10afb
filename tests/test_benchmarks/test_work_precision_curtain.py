"""Curtain and chain sections: the reference lies between bounds, ladders end, and what is recommended holds."""

import pytest

from benchmarks.measure import ROOT
from benchmarks.work_precision import curtain
from examples.curtain import SETTINGS


@pytest.mark.slow
def test_coarse_certified_interval_holds_the_extrapolated_height():
    reference, doubt = curtain.reference_height(16)
    (level, _), *_ = curtain.certified(curtain.corner_problem(), 8, 0)
    low, high = curtain.interval(level)
    assert low < reference - doubt < reference + doubt < high


def test_recommended_settings_held_when_they_were_last_measured():
    page = (ROOT / "docs" / "reports" / "work_precision.md").read_text()
    lines = page.split("**Recommended")[1].split("\n\n")[1].splitlines()
    head, _, *rows = [line.strip("| ").split(" | ") for line in lines]
    assert [row[0] for row in rows] == [f"{accuracy:.2%}" for accuracy in SETTINGS]
    assert {row[head.index("held")] for row in rows} == {"yes"}
    assert [(row[1], row[2].split(",")[0]) for row in rows] == [
        (f"{setting.spacing:g}", " and ".join(map(str, setting.cells))) for setting in SETTINGS.values()
    ]
