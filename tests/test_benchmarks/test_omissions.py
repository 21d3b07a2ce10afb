"""What the report says of a trial follows from its numbers, and every section's small pieces work."""

from benchmarks.omissions import motion, rings
from benchmarks.omissions.compare import LEFT_OUT
from rve import Cell
from rve.geometry import cauchy_line_load


def test_a_feature_of_rings_forced():
    s = cauchy_line_load([20.0, 10.0], [30.0, 60.0])
    row = rings.forced("two loads", Cell(), (rings.solved(Cell(), s), 1.0), s)
    assert row["same"]
    assert row["default"] == LEFT_OUT


def test_supports_across_the_plane_carry_nothing():
    """A ring that is held would carry 0.1. Forces are known to the square root of the tolerance where minima merge."""
    assert max(motion.support_across(ratio)[motion.ACROSS] for ratio in (5.0, 10.0, 20.0)) < 1e-5
