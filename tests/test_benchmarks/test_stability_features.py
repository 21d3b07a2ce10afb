"""Each extreme with the feature that tames it, and without: the same input must then fail."""

from dataclasses import replace

import numpy as np
import pytest

import homogenize.laws.net
import homogenize.laws.polyhedral
import rve.common.errors
import rve.geometry.circles
from benchmarks.extremes import law_kinds
from homogenize.io import default_law
from homogenize.laws.net import ring_cell, ring_net
from macro_fem import curtain as solvers
from macro_fem.curtain import solve_scene
from macro_fem.scene.schema import read_scene
from macro_fem.solvers import central_path
from macro_fem.solvers.status import FREE
from rve.common.errors import InputError
from rve.equilibrium.interior_point import DirectOptions, follow, solve_equilibrium
from rve.equilibrium.limits import with_limits
from rve.equilibrium.system import Equations
from rve.geometry.cell import Cell
from rve.geometry.circles import local_minima
from rve.geometry.kinematics import cauchy_line_load
from rve.geometry.weave import FOUR_IN_ONE
from rve.paper.stewart_trinkle import StewartTrinkleOptions
from rve.paper.stewart_trinkle import solve as come_to_rest
from rve.solve import solve_table

TEN = Equations.of(FOUR_IN_ONE, 0.1)


VALLEYS = [(20.0, 45.0, 0.005), (50.0, 3.2234, 83.1244), (100.0, 1.8965, 77.318)]
"""r1/r2, alpha, beta: nearly uniaxial, and thin wire pulled near its grain."""


def assert_needs_a_slow_fall(ratio, alpha, beta, most):
    s, equations = cauchy_line_load([alpha], [beta]), Equations.of(FOUR_IN_ONE, 1.0 / ratio)
    quick = solve_equilibrium(s, equations, DirectOptions(attempts=1, max_iterations=most))
    assert quick.status[0] == "stalled"
    slow = solve_equilibrium(s, equations)
    assert slow.status[0] == "converged"
    assert slow.attempts[0] > 1
    assert slow.contacts.min_gap[0] > -1e-10


def test_narrow_valleys_need_a_slow_fall_of_mu():
    assert_needs_a_slow_fall(*VALLEYS[0], most=DirectOptions.max_iterations)


@pytest.mark.slow
@pytest.mark.parametrize("valley", VALLEYS)
def test_narrow_valleys_need_a_slow_fall_of_mu_not_more_iterations(valley):
    """The first attempt gets as many iterations as the slow ones have."""
    assert_needs_a_slow_fall(*valley, most=4 * DirectOptions.max_iterations)


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


def test_coinciding_circles_need_the_allowance_for_round_off(monkeypatch):
    pair = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, 1.0]])
    assert len(local_minima(*pair, 1.0).distance) == 1
    monkeypatch.setattr(rve.geometry.circles, "_ROUND_OFF", 0.0)
    assert len(local_minima(*pair, 1.0).distance) == 0


def test_merging_contacts_of_a_motion_need_their_curvature():
    s = cauchy_line_load([10.0], [10.0])
    bent = come_to_rest(s, TEN, StewartTrinkleOptions(max_steps=400))
    assert bent.status[0] == "converged"
    plain = come_to_rest(s, TEN, StewartTrinkleOptions(max_steps=400, curvature=False))
    assert plain.status[0] == "time-step"


def test_large_time_steps_need_halving():
    s = cauchy_line_load([20.0], [30.0])
    options = StewartTrinkleOptions(h_max=1e3)
    assert come_to_rest(s, TEN, options).status[0] == "converged"
    assert come_to_rest(s, TEN, replace(options, h_min=1e3)).status[0] == "time-step"


def test_loads_of_any_size_need_scaled_units():
    """Only the direction of a load counts; unscaled, its size is compared with the path parameter."""
    s = cauchy_line_load([20.0], [30.0])
    plain = solve_equilibrium(s, TEN)
    for size in (1e-8, 1e8):
        scaled = solve_equilibrium(size * s, TEN)
        np.testing.assert_allclose(scaled.pose.lattice, plain.pose.lattice, atol=1e-9)
    assert follow(1e8 * s, TEN, DirectOptions(attempts=1)).status[0] == "stalled"


def test_jammed_wire_needs_its_refusal():
    with pytest.raises(rve.common.errors.InputError, match="jams at"):
        Cell(5.0, 5.0 / 3.9)
    jammed = Equations.of(FOUR_IN_ONE, 1.0 / 3.9)
    found = solve_equilibrium(cauchy_line_load([20.0], [30.0]), jammed, DirectOptions(attempts=1, max_iterations=30))
    assert found.status[0] == "stalled"


def test_loads_that_push_need_their_name():
    assert solve_table(Cell(), ([20.0], [-1.0])).status[0] == "compressive"
    bare = solve_equilibrium(cauchy_line_load([20.0], [-20.0]), TEN, DirectOptions(attempts=1))
    assert bare.status[0] == "stalled"


def test_laws_need_their_check_for_numbers(monkeypatch):
    laws = law_kinds()
    nan = np.array([[np.nan, 0.0, 0.1]])
    for law in laws.values():
        for function in (law.response, law.cut, law.support):
            with pytest.raises(InputError, match="finite numbers, row 0"):
                function(nan)
    for module in (homogenize.laws.net, homogenize.laws.polyhedral):
        monkeypatch.setattr(module, "check_finite", lambda *_: None)
    assert np.isnan(laws["net"].support(nan)).all()
    assert np.isnan(laws["polyhedral"].cut(nan).violation).all()


def square(**tables):
    plain = {"curtain": {"width": 100.0, "height": 100.0}, "mesh": {"cells": 8}}
    return read_scene(plain | tables)


def test_impossible_supports_need_the_certificate(monkeypatch):
    law = ring_net(ring_cell(5.0, 0.5, 11.0, 12.646069623526))
    scene = square(support={"kind": "top", "gather": 1.65}, solver={"max_iterations": 80})
    assert solve_scene(scene, law).status == "infeasible"
    monkeypatch.setattr(solvers, "supports_reach", lambda _: FREE)
    refuted = solve_scene(scene, law)  # by the curtain's own multipliers
    assert refuted.status == "infeasible"
    proved = float(refuted.message.split(" %")[0].split()[-1])
    assert proved == pytest.approx(100.0 * (1.65 / (18.0 / 11.0) - 1.0), abs=0.05)
    monkeypatch.setattr(central_path, "is_certificate", lambda *_: False)
    assert solve_scene(scene, law).status in ("stalled", "iterations")


def test_stiff_rings_are_solved():
    law = replace(default_law(), stiffness=1e9 * np.eye(3))
    scene = square(mesh={"cells": 6}, support={"kind": "corners", "gather": 0.9}, solver={"kind": "elastic"})
    assert solve_scene(scene, law).status == "converged"
