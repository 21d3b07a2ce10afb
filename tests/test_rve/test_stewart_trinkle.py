"""The paper's scheme in its periodic form: against a second method, against scaling laws, and against itself."""

from dataclasses import replace

import numpy as np
import pytest

from rve import Cell
from rve.geometry import FOUR_IN_ONE, cauchy_line_load, strain_of
from rve.locking import Equations, solve_equilibrium
from rve.simulation import ROUND_OFF, Dynamics, SimulationOptions, copies, simulate
from rve.simulation import stewart_trinkle as st

EQUATIONS = Equations.of(FOUR_IN_ONE, 0.1)
OPTIONS = SimulationOptions()
STUCK = replace(OPTIONS, h_min=0.9, largest_move=1e-6)
ALPHA = np.array([0.0, 20.0, 10.0, 0.0, 30.0, 20.0])
BETA = np.array([45.0, 30.0, 20.0, 90.0, 50.0, 75.0])


def come_to_rest(rows, options):
    """The rings at the end of these loads."""
    return simulate(Cell(), (ALPHA[rows], BETA[rows]), options).rest


@pytest.fixture(scope="module")
def loads():
    return cauchy_line_load(ALPHA, BETA)


@pytest.fixture(scope="module")
def run():
    return simulate(Cell(), (ALPHA, BETA), OPTIONS)


@pytest.fixture(scope="module")
def rest(run):
    return run.rest


@pytest.fixture(scope="module")
def rigid(loads):
    return solve_equilibrium(loads, EQUATIONS)


def reference(rigid):
    return tuple(rigid.pose.lattice[3, :2])


def test_cases_come_to_rest(rest):
    assert list(rest.status) == ["converged"] * len(ALPHA)
    assert np.all(OPTIONS.tolerance > rest.R)
    assert rest.contacts.links_intact.all()
    assert np.all(rest.time > 10.0)
    assert np.all(rest.time <= OPTIONS.h_max * rest.steps)


def test_energy_never_rises_in_an_accepted_step(run):
    assert len(run.history.rise) == run.rest.steps.sum()
    assert run.history.rise.max() <= ROUND_OFF
    assert run.history.rise.min() < -0.1  # it does fall, by far more than the allowance
    assert run.history.h.min() > 0.0
    assert run.history.time[run.history.case == 2][-1] == run.rest.time[2]


def test_residual_of_eq_9_is_that_of_the_static_system(rest, loads):
    static = EQUATIONS.assemble(rest.pose, rest.contacts, rest.lam, loads)
    assert np.all(static.weighted_residual < 10.0 * OPTIONS.tolerance)


def test_penetration_falls_in_proportion_to_load_over_stiffness(rest, rigid, loads):
    rows = np.array([0, 1, 4])
    stiffer = replace(OPTIONS, stiffness=4.0 * OPTIONS.stiffness)
    harder = come_to_rest(rows, stiffer)
    exact = strain_of(rigid.pose, reference(rigid))[rows]
    soft_error = np.abs(strain_of(rest.pose, reference(rigid))[rows] - exact).max(axis=1)
    hard_error = np.abs(strain_of(harder.pose, reference(rigid)) - exact).max(axis=1)
    assert soft_error / hard_error == pytest.approx(4.0, rel=0.01)
    assert soft_error.max() < 2e-6
    limit = (4.0 * strain_of(harder.pose, reference(rigid)) - strain_of(rest.pose, reference(rigid))[rows]) / 3.0
    assert np.abs(limit - exact).max() < 1e-8


def test_results_do_not_depend_on_company_or_order(rest):
    rows = np.array([4, 1])
    pair = come_to_rest(rows, OPTIONS)
    for name in ("lattice", "centres", "normals"):
        assert np.array_equal(getattr(pair.pose, name), getattr(rest.pose, name)[rows])
    for name in ("R", "steps", "rejected", "time", "lam"):
        assert np.array_equal(getattr(pair, name), getattr(rest, name)[rows])
    assert np.array_equal(pair.contacts.gap, rest.contacts.gap[rows])


@pytest.mark.parametrize("kind", ["mass", "length"])
def test_units_change_no_bit(kind):
    factor, density, cell, other = 2.0, 2.0**-17, Cell(density=2.0**-17), OPTIONS  # no round-off of powers of two
    if kind == "mass":
        names = ("damping", "stiffness", "load")
        double = Cell(density=factor * density)
        other = replace(OPTIONS, **{name: factor * getattr(OPTIONS, name) for name in names})
    else:
        double = Cell(factor * cell.r1, factor * cell.r2, density=density / factor**3)
    few = ((20.0,), (30.0,))
    one = simulate(cell, few, replace(OPTIONS, max_steps=40))
    two = simulate(double, few, replace(other, max_steps=40))
    assert np.array_equal(one.rest.pose.lattice, two.rest.pose.lattice)
    assert np.array_equal(one.rest.R, two.rest.R)


def test_twice_the_load_runs_twice_as_fast_when_inertia_is_small():
    """Overdamped motion: time goes with damping over load. Steps small enough for both clocks."""
    slow = replace(OPTIONS, h_max=0.02, max_steps=100, stiffness=1e6)
    fast = replace(slow, load=2.0 * slow.load, h_max=0.01, stiffness=2e6)
    one, two = (come_to_rest(slice(0, 1), options) for options in (slow, fast))
    assert one.time == pytest.approx(2.0 * two.time)
    assert one.pose.lattice == pytest.approx(two.pose.lattice, abs=2e-4)
    assert np.abs(one.pose.lattice[0, :2] - FOUR_IN_ONE.start_lattice[:2]).max() > 0.1


def test_first_step_from_rest_is_the_implicit_one(loads):
    """No contact yet: (M/h + D) v = f on the free velocities."""
    dynamics = Dynamics.of(Cell(), replace(OPTIONS, h_max=1e-3))
    rest = st.begin(loads[:1], dynamics)
    after, _, _ = st.advance(rest, dynamics)
    assert rest.h[0] == 1e-3
    assert after.lam.max() == 0.0
    s = loads[0]
    x2, y3 = FOUR_IN_ONE.start_lattice[:2]
    force = np.array([s[0] * y3, s[1] * y3 - 0.0, s[1] * x2, s[2] * x2])
    left = (dynamics.mass / rest.h[0] + dynamics.drag) @ after.v[0]
    assert left[[0, 3]] == pytest.approx(force[[0, 3]], rel=1e-12)
    assert left[4:6] == pytest.approx(0.0, abs=1e-12)
    after.v[0] = [*np.zeros(len(after.v[0]) - 3), 0.0, -3.0, 4.0]  # the last ring spins in place
    assert dynamics.largest_motion(after.v) == pytest.approx([5.0])


def test_too_few_steps_and_a_step_that_cannot_shrink_are_told():
    for options, status in ((replace(OPTIONS, max_steps=3), "step-limit"), (STUCK, "time-step")):
        found = come_to_rest(slice(0, 1), options)
        assert (found.status[0], bool(np.isfinite(found.pose.lattice).all())) == (status, True)


def test_copies_of_a_link_among_the_ten_rings():
    count = {tuple(pair): n for pair, n in zip(FOUR_IN_ONE.pairs.tolist(), copies(FOUR_IN_ONE), strict=True)}
    assert [count[0, 1, i, j] for i, j in ((0, 0), (0, -1), (-1, 0), (-1, -1))] == [4, 4, 2, 2]
    assert count[0, 0, 1, 0] == 3
    assert count[0, 0, 2, 0] == 0


@pytest.mark.slow
def test_motion_without_inertia_comes_to_rest_at_the_same_place():
    """A millionth of the mass: damping alone determines where the rings come to rest."""
    steel = Cell().density
    slow, fast = (simulate(Cell(density=f * steel), ((20.0,), (30.0,))).rest for f in (1.0, 1e-6))
    assert fast.status[0] == "converged"
    assert fast.pose.lattice == pytest.approx(slow.pose.lattice, abs=1e-8)
    assert not np.array_equal(fast.pose.lattice, slow.pose.lattice)
