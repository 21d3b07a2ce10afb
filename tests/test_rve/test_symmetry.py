"""Locked states in symmetric coordinates: exact derivatives, the same states, and no state that would give way."""

from dataclasses import replace

import numpy as np
import pytest

from rve.equilibrium.interior_point import DirectOptions, solve_equilibrium, unit_loads
from rve.equilibrium.symmetry import (
    is_confirmed,
    is_symmetric,
    solve_equilibrium_symmetric,
    symmetric_equations,
    symmetry_of,
)
from rve.equilibrium.system import Equations
from rve.geometry.kinematics import cauchy_line_load
from rve.geometry.pose import moved, start_pose
from rve.geometry.weave import FOUR_IN_ONE, SIX_IN_ONE, supercell

OPTIONS = DirectOptions()
WEAVES = ((FOUR_IN_ONE, 0.1), (SIX_IN_ONE, 0.12))


@pytest.mark.parametrize(("weave", "wire"), WEAVES)
def test_symmetric_motions_keep_the_symmetry(weave, wire):
    rng = np.random.default_rng(3)
    symmetry = symmetry_of(weave)
    half = symmetric_equations(Equations.of(weave, wire), symmetry)
    pose = start_pose(weave, 5)
    for _ in range(4):
        pose = moved(pose, half.displacement(0.05 * rng.uniform(-1.0, 1.0, (5, 5)), pose))
        assert is_symmetric(pose, symmetry.middle, 1e-14).all()
    assert not is_symmetric(moved(pose, 1e-6 * np.ones((5, 9))), symmetry.middle, 1e-9).any()


def test_derivative_of_the_symmetric_equations_by_differences():
    """With forces held, dr/dy is J: the second ring follows the lattice along a curved path, which counts."""
    rng = np.random.default_rng(5)
    symmetry = symmetry_of(FOUR_IN_ONE)
    half = symmetric_equations(Equations.of(FOUR_IN_ONE, 0.05), symmetry)
    pose = start_pose(FOUR_IN_ONE, 1)
    pose = moved(pose, half.displacement(0.08 * rng.uniform(-1.0, 1.0, (1, 5)), pose))
    s = cauchy_line_load([25.0], [30.0])
    here = half.contacts(pose, 0.75)
    assert here.present.sum() > 4
    lam = np.where(here.present, rng.uniform(0.5, 1.5, here.gap.shape), 0.0)

    def lattice_residual(y):
        there = moved(pose, half.displacement(y[None], pose))
        contacts = half.contacts(there, 0.9)
        force = np.zeros(contacts.gap.shape)
        for p, slot in np.argwhere(here.present[0]):
            way = np.linalg.norm(contacts.rho[0, p] - here.rho[0, p, slot], axis=1)
            force[0, p, np.argmin(np.where(contacts.present[0, p], way, np.inf))] += lam[0, p, slot]
        return half.assemble(there, contacts, force, s).r[0, :3]

    J = half.assemble(pose, here, lam, s).J[0, :3, :3]
    h = 1e-6
    for column in range(3):
        step = h * np.eye(5)[column]
        slope = (lattice_residual(step) - lattice_residual(-step)) / (2.0 * h)
        assert slope == pytest.approx(J[:, column], abs=1e-6)


@pytest.mark.parametrize(("weave", "wire"), WEAVES)
def test_the_same_states_with_the_forces_of_all_pairs(weave, wire):
    s = cauchy_line_load([0.0, 20.0, 45.0, 30.0, 10.0], [45.0, 30.0, 5.0, 80.0, 90.0])
    equations = Equations.of(weave, wire)
    all_free = solve_equilibrium(s, equations, OPTIONS)
    found = solve_equilibrium_symmetric(s, equations, OPTIONS)
    assert (found.attempts == 1).all()  # in symmetric coordinates alone
    assert (found.status == "converged").all()
    assert found.pose.lattice == pytest.approx(all_free.pose.lattice, abs=1e-9)
    assert found.pose.centres == pytest.approx(all_free.pose.centres, abs=1e-9)
    assert found.R.max() < OPTIONS.tolerance
    system = equations.assemble(found.pose, found.contacts, found.lam, unit_loads(s))
    assert system.weighted_residual == pytest.approx(found.R, abs=1e-15)
    assert found.lam.sum(axis=(1, 2)) == pytest.approx(all_free.lam.sum(axis=(1, 2)), rel=1e-6)


def test_a_state_that_gives_way_to_an_asymmetric_motion_is_not_confirmed():
    """All loads and forces turned round: the same balance, but no contact holds and every motion gains work."""
    s = unit_loads(cauchy_line_load([0.0], [5.0]))
    equations = Equations.of(FOUR_IN_ONE, 0.1)
    half = symmetric_equations(equations, symmetry_of(FOUR_IN_ONE))
    found = solve_equilibrium_symmetric(s, equations, OPTIONS)
    assert found.attempts[0] == 1
    turned = replace(found, lam=-found.lam)
    assert equations.assemble(turned.pose, turned.contacts, turned.lam, -s).weighted_residual[0] < OPTIONS.tolerance
    assert is_confirmed(found, half, equations, s, OPTIONS.tolerance).all()
    assert not is_confirmed(turned, half, equations, -s, OPTIONS.tolerance).any()


def test_pairs_are_halved():
    assert len(symmetry_of(FOUR_IN_ONE).kept) == 14
    assert symmetry_of(SIX_IN_ONE).middle == (0, 1)
    assert symmetry_of(supercell(FOUR_IN_ONE, 2, 1)) is None
    assert symmetry_of(replace(FOUR_IN_ONE, start_centres=FOUR_IN_ONE.start_centres * 1.1)) is None


def test_the_limit_of_iterations_holds_in_symmetric_coordinates():
    """Three iterations from the slack pose do not lock a cell; forty do."""
    equations = Equations.of(FOUR_IN_ONE, 0.1)
    s = cauchy_line_load([20.0], [45.0])
    found = solve_equilibrium_symmetric(s, equations, DirectOptions(max_iterations=3, attempts=1))
    assert (found.status[0], found.attempts[0]) == ("stalled", 2)
    assert solve_equilibrium_symmetric(s, equations, DirectOptions()).status[0] == "converged"
