"""What a run of rings used and left out: words that agree with what was done."""

from dataclasses import replace

import numpy as np
import pytest

from rve.equilibrium.system import Equations
from rve.explain import features
from rve.geometry.cell import Cell
from rve.geometry.contacts import unlisted_gap
from rve.geometry.kinematics import cauchy_line_load
from rve.geometry.pose import start_pose
from rve.geometry.weave import FOUR_IN_ONE
from rve.paper.stewart_trinkle import StewartTrinkleOptions, solve
from rve.solve import solve_table

# Strains end at mu_end / force: 1e-13 over forces of 1e-4 and more.
TOLERANCE = 1e-9
LOADS = np.array([0.0, 20.0, 45.0, 10.0]), np.array([45.0, 30.0, 60.0, 80.0])
DIRECT = {"motion", "asymmetry", "unlisted-pairs", "attempts", "limits"}


@pytest.fixture(scope="module")
def plain():
    return solve_table(Cell(), LOADS)


def said(table):
    """Rows by feature."""
    return {row["feature"]: row for row in features(table.provenance)}


def test_the_words_agree_with_the_work(plain):
    work = plain.provenance["work"]
    assert (work["cases"], work["symmetric"], work["retried"], work["limits"]) == (4, 4, 0, 0)
    assert f"{work['least_near']} to {work['most_near']} of " in said(plain)["unlisted-pairs"]["why"]
    assert set(said(plain)) == DIRECT
    assert not any(row["used"] for row in said(plain).values())


@pytest.mark.slow
def test_limits_and_further_attempts_are_told():
    """A pull at 25 degrees leaves the strain free; at r1/r2 = 50 nearly uniaxial loads take further attempts."""
    free = said(solve_table(Cell(), ([25.0, 30.0], [0.0, 30.0])))["limits"]
    assert (free["used"], free["why"][:7]) == (True, "1 of 2 ")
    slow = solve_table(Cell(5.0, 0.1), ([30.0, 0.0, 20.0], [0.001, 0.005, 0.002]))
    assert slow.converged.all()
    assert said(slow)["attempts"]["used"]


def test_the_gap_of_unlisted_pairs_is_a_bound():
    pose = start_pose(FOUR_IN_ONE, 1)
    squeezed = replace(pose, lattice=pose.lattice * np.array([0.3, 0.3, 1.0]))
    assert unlisted_gap(pose, FOUR_IN_ONE, 0.1)[0] > 0.3
    assert unlisted_gap(squeezed, FOUR_IN_ONE, 0.1)[0] < 0.0


def test_motion_without_inertia_comes_to_rest_at_the_same_place():
    """A millionth of the mass: damping alone determines where the rings come to rest."""
    s, equations, paper = cauchy_line_load([20.0], [30.0]), Equations.of(FOUR_IN_ONE, 0.1), StewartTrinkleOptions()
    slow, fast = (solve(s, equations, replace(paper, density=share * paper.density)) for share in (1.0, 1e-6))
    assert fast.status[0] == "converged"
    assert fast.pose.lattice == pytest.approx(slow.pose.lattice, abs=1e-8)
    assert not np.array_equal(fast.pose.lattice, slow.pose.lattice)
