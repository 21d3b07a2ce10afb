"""What the report says of a trial follows from its numbers, and every section's small pieces work."""

import numpy as np
import pytest

from benchmarks.measure import at_most
from benchmarks.omissions import motion, rings
from benchmarks.omissions.compare import LEFT_OUT, NOISE, bars, trial, trial_table, verdict
from benchmarks.omissions.curtains import by_option, third_coordinate
from homogenize.io import default_law
from macro_fem.solvers.options import PathOptions
from rve.geometry.cell import Cell
from rve.geometry.kinematics import cauchy_line_load

SAME = trial("far-pairs", "rings", (1.0, 1.5), 3e-12, 1e-9)
CHANGED = trial("asymmetry", "rings", (1.0, 1.5), 2e-9, 1e-9)
FAILED = trial("inertia", "rings", (1.0, 1.5), 3e-12, 1e-9, ok=False)


def test_a_change_above_the_tolerance_and_a_failure_are_told():
    rows = trial_table("Features", (SAME, CHANGED, FAILED)).rows
    assert [row[-1] for row in rows] == ["yes", "no", "no"]
    assert rows[2][6] == "failed"
    said = verdict((SAME, CHANGED, FAILED))
    assert said.startswith("1 of 3 ")
    assert "`asymmetry` (rings), `inertia` (rings)" in said
    assert "Changed" not in verdict((SAME,))


def test_round_off_keeps_its_decade():
    assert at_most(2e-16, NOISE) == at_most(9e-15, NOISE) == "<= 1e-14"
    assert at_most(1.1e-9, NOISE) == "<= 1e-8"
    assert at_most(float("nan"), NOISE) == "-"


def test_bars_stand_at_their_feature():
    diagram = bars("key", "title", (SAME, CHANGED, CHANGED | {"scene": "other"}))
    assert [(curve.label, curve.x) for curve in diagram.curves] == [("rings", (0.0, 1.0)), ("other", (1.0,))]
    assert len(diagram.ticks) == 2


@pytest.mark.parametrize("feature", rings.FORCED)
def test_a_feature_of_rings_forced(feature):
    s = cauchy_line_load([20.0, 10.0], [30.0, 60.0])
    row = rings.forced(feature, "two loads", Cell(), (rings.solved(Cell(), s), 1.0), s)
    assert row["same"]
    assert row["default"] == LEFT_OUT


@pytest.mark.parametrize("term", motion.TERMS)
def test_a_motion_ends_in_the_locked_state(term):
    assert motion.moved(term, (np.array([0.0]), np.array([45.0])))["same"]


def test_supports_across_the_plane_carry_nothing():
    """A ring that is held would carry 0.1. Forces are known to the square root of the tolerance where minima merge."""
    assert max(motion.support_across(ratio)[motion.ACROSS] for ratio in (5.0, 10.0, 20.0)) < 1e-5


def test_features_of_curtains_forced():
    law = default_law()
    assert third_coordinate(law, "corners", 3)["same"]
    row = by_option(law, "idle half-spaces", 3, PathOptions(), PathOptions(pruned_at=()))
    assert row["same"]
    assert row["default"] == LEFT_OUT
