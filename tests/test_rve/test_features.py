"""Extremes with the feature that tames them, and without: the same input must then fail."""

from dataclasses import replace

import numpy as np
import pytest

from rve import Cell, DirectOptions, solve_table
from rve.geometry import FOUR_IN_ONE, cauchy_line_load
from rve.locking import Equations, solve_equilibrium, with_limits
from rve.simulation import SimulationOptions, simulate

TEN = Equations.of(FOUR_IN_ONE, 0.1)


@pytest.mark.parametrize(
    ("ratio", "alpha", "beta"),
    [
        pytest.param(30.0, 43.0, 0.01, marks=pytest.mark.slow),
        pytest.param(100.0, 1.8965, 77.318, marks=pytest.mark.release),
    ],
)
def test_narrow_valleys_need_a_slow_fall_of_mu(ratio, alpha, beta):
    """Nearly uniaxial, and thin wire pulled near its grain; more iterations in one attempt do not help."""
    s, equations = cauchy_line_load([alpha], [beta]), Equations.of(FOUR_IN_ONE, 1.0 / ratio)
    quick = solve_equilibrium(s, equations, DirectOptions(attempts=1, max_iterations=4 * DirectOptions.max_iterations))
    assert quick.status[0] == "stalled"
    slow = solve_equilibrium(s, equations)
    assert slow.status[0] == "converged"
    assert slow.attempts[0] > 1
    assert slow.contacts.min_gap[0] > -1e-10


@pytest.mark.slow
def test_nearly_uniaxial_loads_need_the_way_from_inside_the_cone():
    s, equations, options = cauchy_line_load([30.0], [1e-3]), Equations.of(FOUR_IN_ONE, 0.05), DirectOptions()
    cold = solve_equilibrium(s, equations, replace(options, attempts=1))
    assert cold.status[0] == "stalled"
    found, unique = with_limits(s, equations, cold, options)
    assert found.status[0] == "converged"
    assert unique[0]
    assert found.R[0] < 1e-9
    # The strain lies on the way to the limit: between those of a larger second load and of none.
    near = solve_table(Cell(5.0, 0.25), ([30.0, 30.0], [0.0, 0.02]))
    assert np.abs(10.0 * found.pose.lattice[0, 0] / 2.0 - near.x2_mm[0, 0]) < 5.0 * np.abs(np.diff(near.x2_mm[:, 0]))[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("load", "options", "without"),
    [
        ((10.0, 10.0), SimulationOptions(max_steps=400), {"curvature": False}),  # of contacts that merge
        ((20.0, 30.0), SimulationOptions(h_max=1e3), {"h_min": 1e3}),  # large steps are not halved
    ],
)
def test_motions_come_to_rest_by_their_feature(load, options, without):
    assert simulate(Cell(), load, options).status[0] == "converged"
    assert simulate(Cell(), load, replace(options, **without)).status[0] == "time-step"


@pytest.mark.slow
def test_loads_of_any_size_need_scaled_units():
    """Only the direction of a load counts; unscaled, its size is compared with the path parameter."""
    s = cauchy_line_load([20.0], [30.0])
    plain = solve_equilibrium(s, TEN)
    for size in (1e-8, 1e8):
        scaled = solve_equilibrium(size * s, TEN)
        np.testing.assert_allclose(scaled.pose.lattice, plain.pose.lattice, atol=1e-9)
    sizes = np.append(10.0 ** np.arange(4, 16), 1.0)  # rounding leaves some of their matrices singular
    unscaled = replace(TEN, is_relative=False)
    status = solve_equilibrium(sizes[:, None] * s, unscaled, DirectOptions(attempts=1)).status.tolist()
    assert status == [*["stalled"] * 12, "converged"]


@pytest.mark.parametrize(("ratio", "load"), [(3.9, (20.0, 30.0)), (10.0, (20.0, -20.0))], ids=["jammed", "pushed"])
def test_cells_that_cannot_lock_end_by_name(ratio, load):
    bare = Equations.of(FOUR_IN_ONE, 1.0 / ratio)
    s = cauchy_line_load(*([angle] for angle in load))
    assert solve_equilibrium(s, bare, DirectOptions(attempts=1, max_iterations=30)).status[0] == "stalled"
