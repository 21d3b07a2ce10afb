"""The page of published numbers: what it calls inside is inside, and quick numbers are ours as the page has them."""

import re

import numpy as np
import pytest
from scipy.special import jn_zeros

from benchmarks import others
from benchmarks.measure import ROOT

PAGE = (ROOT / "docs" / "measured" / "others.md").read_text(encoding="utf-8")


def rows_below(head: str) -> list[dict[str, str]]:
    """The rows of the table of the page whose first column is `head`."""
    lines = re.search(rf"^\| {head} \|.*\n\|[- |]+\n((?:\|.*\n?)+)", PAGE, re.MULTILINE)
    names = cells(lines[0].split("\n")[0])
    return [dict(zip(names, cells(line), strict=True)) for line in lines[1].strip().split("\n")]


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip("| ").split("|")]


def span(text: str) -> tuple[float, float]:
    low, high = map(float, text.split(" to "))
    assert low <= high
    return low, high


def test_what_the_page_calls_inside_is_inside_and_what_is_outside_stands_first():
    rows, outside = rows_below("number"), []
    assert len(rows) >= 12
    for row in rows:
        scatter, ours = span(row["scatter"]), span(row["range of ours"])
        value = float(row["ours"].replace(",", ""))
        assert ours[0] * (1.0 - 1e-3) <= value <= ours[1] * (1.0 + 1e-3), row
        meets = max(scatter[0], ours[0]) <= min(scatter[1], ours[1])
        assert row["inside"] == ("yes" if meets else "no"), row
        outside += [] if meets else [f"- {row['number']}, {row['of']}: "]
    first = PAGE[: PAGE.index("| number |")]
    assert f"**Outside of the scatter: {len(outside)} of {len(rows)}.**" in first
    assert all(one in first for one in outside)
    assert {row["source"] for row in rows} == {row["source"] for row in rows_below("source")}
    assert all(row["where"] and row["not known; scatter"] for row in rows_below("source"))


@pytest.mark.slow
@pytest.mark.parametrize("make", others.QUICK, ids=lambda make: make.__name__)
def test_quick_numbers_are_those_of_the_page(make):
    told = {(row["number"], row["of"]): row for row in rows_below("number")}
    for row in make():
        text = told[row["number"], row["of"]]
        assert float(text["published"].replace(",", "")) == pytest.approx(row["published"], rel=1e-4)
        assert text["scatter"] == row["scatter"]
        assert float(text["ours"].replace(",", "")) == pytest.approx(row["ours"], rel=2e-3)
        assert span(text["range of ours"]) == pytest.approx(span(row["range of ours"]), rel=2e-3)


@pytest.mark.slow
def test_numbers_of_theory_are_its_closed_forms():
    found = {(row["number"], row["of"]): row["ours"] for make in (others.rings, others.hanging_chain) for row in make()}
    assert found["opening, P R3/EI", "thin ring"] == pytest.approx(np.pi / 4.0 - 2.0 / np.pi, rel=1e-5)
    modes = [found["frequency", f"mode {k}"] for k in (1, 2, 3)]
    assert modes == pytest.approx(jn_zeros(0, 3).tolist(), rel=1e-3)
    assert others.kept(1.0) == pytest.approx(0.8472, abs=1e-4)  # Calkin and March
    assert others.kept(1e-6) == pytest.approx(1.0, abs=1e-6)


def test_a_number_is_inside_where_the_ranges_meet():
    rows = [others.number("", "", 1.0, (0.9, 1.1), ours, "") for ours in ([1.0], [2.0, 1.05], [1.2, 1.3], [0.5, 0.8])]
    assert [row["inside"] for row in rows] == [True, True, False, False]
    assert rows[1]["ours"] == 2.0
    assert rows[1]["range of ours"] == "1.05 to 2"


def test_a_free_fall_takes_the_time_of_free_fall_and_is_timed_down_to_its_lowest_place():
    times = np.linspace(0.0, 0.5, 26)
    way = np.minimum(0.5 * others.G * times**2, 1000.0)
    legs = [np.array([[0.0, 1000.0, 0.0], [0.0, 400.0, 10.0], [0.0, 1000.0 - fallen, 30.0]]) for fallen in way]
    share, ratio = others.timed(zip(times, legs, strict=True), 1000.0)
    assert share == pytest.approx(way[1 : 1 + len(share)] / 1000.0)
    assert ratio[:-1] == pytest.approx(1.0)
    assert share[-1] == 1.0
    assert len(share) == np.argmax(way)
