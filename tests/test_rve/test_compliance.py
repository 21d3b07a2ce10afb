"""Finite contact stiffness: equilibrium, rigid limit and locking compliance against differences and a potential."""

import numpy as np
import pytest

from rve.equilibrium.compliance import soften
from rve.equilibrium.interior_point import solve_equilibrium
from rve.equilibrium.system import Equations
from rve.geometry.kinematics import cauchy_line_load, second_pk
from rve.geometry.pose import deformation, strain_of
from rve.geometry.weave import FOUR_IN_ONE

EQUATIONS = Equations.of(FOUR_IN_ONE, 0.1)
ALPHA = np.array([0.0, 0.0, 20.0, 10.0, 45.0, 30.0, 0.0])
BETA = np.array([90.0, 45.0, 30.0, 20.0, 90.0, 65.0, 0.0])
WEIGHT = np.array([1.0, 2.0, 1.0])


@pytest.fixture(scope="module")
def loads():
    return cauchy_line_load(ALPHA, BETA)


@pytest.fixture(scope="module")
def rigid(loads):
    return solve_equilibrium(loads, EQUATIONS)


@pytest.fixture(scope="module")
def cell(rigid):
    return tuple(rigid.pose.lattice[0, :2])


@pytest.mark.parametrize("kappa", [50.0, 1e3, 1e6, 5e11])
def test_forces_are_stiffness_times_penetration(rigid, loads, cell, kappa):
    soft = soften(rigid, loads, EQUATIONS, kappa, cell)
    assert list(soft.status) == ["converged"] * len(ALPHA)
    assert np.all(soft.R < 1e-11)
    pressed = np.where(soft.contacts.present, np.maximum(-soft.contacts.gap, 0.0), 0.0)
    assert np.abs(pressed - soft.lam / kappa).max() <= 1.1e-14
    static = EQUATIONS.assemble(soft.pose, soft.contacts, soft.lam, loads)
    assert np.all(static.weighted_residual < 1e-10)
    assert soft.lam.max() > 0.1


def test_strain_goes_to_the_rigid_one_like_one_over_stiffness(rigid, loads, cell):
    exact = strain_of(rigid.pose, cell)
    at = {kappa: strain_of(soften(rigid, loads, EQUATIONS, kappa, cell).pose, cell) for kappa in (1e3, 1e4, 1e5)}
    error = {kappa: np.abs(E - exact).max(axis=1) for kappa, E in at.items()}
    unique = np.arange(len(ALPHA)) < 6  # the kink (0, 0) is softer: two minima merge
    assert error[1e4][unique] / error[1e5][unique] == pytest.approx(10.0, rel=0.01)
    coarse, fine = (
        np.abs((10.0 * at[10.0 * kappa] - at[kappa]) / 9.0 - exact).max(axis=1)[unique] for kappa in (1e3, 1e4)
    )
    assert fine.max() < 1e-7
    assert np.all(coarse / fine > 50.0)  # second order: a hundred times less for a ten times stiffer contact


@pytest.mark.parametrize("kappa", [pytest.param(200.0, marks=pytest.mark.slow), 1e4])
def test_compliance_is_the_derivative_of_strain_by_load(rigid, loads, cell, kappa):
    """The stiffness k is constant while the size of the load changes, so the ratio k/s_hat changes."""
    D = soften(rigid, loads, EQUATIONS, kappa, cell).compliance
    for direction in np.eye(3):
        step = 1e-5
        E, S = [], []
        for sign in (1.0, -1.0):
            s = loads + sign * step * direction
            size = np.sqrt((s**2 * WEIGHT).sum(axis=1))
            for i in range(len(s)):
                one = slice(i, i + 1)
                start = _row(rigid, i)
                soft = soften(start, s[one], EQUATIONS, kappa / size[i], cell)
                assert soft.status[0] == "converged"
                E.append(strain_of(soft.pose, cell)[0])
                S.append(second_pk(deformation(soft.pose, cell), s[one])[0])
        half = len(loads)
        dE, dS = np.array(E[:half]) - np.array(E[half:]), np.array(S[:half]) - np.array(S[half:])
        predicted = np.einsum("nij,nj->ni", D, dS)
        assert predicted == pytest.approx(dE, rel=2e-4, abs=2e-4 * np.abs(dE).max())


def _row(rigid, i):
    one = np.array([i])
    return rigid.take(one)


def test_compliance_comes_from_a_convex_potential(rigid, loads, cell):
    D = soften(rigid, loads, EQUATIONS, 1e4, cell).compliance
    W = WEIGHT[:, None] * D
    defect = np.abs(W - W.transpose(0, 2, 1)).max(axis=(1, 2)) / np.abs(W).max(axis=(1, 2))
    assert defect.max() < 1e-9  # round-off 1e-12 where contacts merge; a missing term makes 1e-2
    lowest = np.linalg.eigvalsh(0.5 * WEIGHT[:, None] * D + 0.5 * (WEIGHT[:, None] * D).transpose(0, 2, 1))[:, 0]
    assert np.all(lowest > -1e-12)


def test_stretch_along_the_load_is_the_contact_compliance(rigid, loads, cell):
    """D S falls like 1/kappa, D itself does not: it tends to the curvature of the locking surface."""
    S = second_pk(deformation(rigid.pose, cell), loads)
    D = {kappa: soften(rigid, loads, EQUATIONS, kappa, cell).compliance for kappa in (1e4, 1e5)}
    along = {kappa: np.einsum("ni,i,nij,nj->n", S, WEIGHT, D[kappa], S) for kappa in D}
    assert np.all(along[1e4] > 0.0)
    assert along[1e4][:6] / along[1e5][:6] == pytest.approx(10.0, rel=0.02)
    assert D[1e4][1] == pytest.approx(D[1e5][1], rel=2e-3, abs=1e-3)
    assert np.abs(D[1e5][1]).max() > 0.1
    # The reference (0, 90) is an edge of the surface: stretches are rigid, only shear is not.
    for i in (0, 2):
        for j in (0, 2):
            assert D[1e4][0, i, j] / D[1e5][0, i, j] == pytest.approx(10.0, rel=0.01)
    assert D[1e5][0, 1, 1] == pytest.approx(D[1e4][0, 1, 1], rel=1e-3)
    assert D[1e5][0, 1, 1] > 0.05


def test_one_stiffness_for_each_pair_of_rings(rigid, loads, cell):
    same = soften(rigid, loads, EQUATIONS, np.full(len(FOUR_IN_ONE.pairs), 1e4), cell)
    scalar = soften(rigid, loads, EQUATIONS, 1e4, cell)
    assert same.pose.lattice == pytest.approx(scalar.pose.lattice, abs=1e-14)
    links_only = np.where(FOUR_IN_ONE.linked, 1e4, 1e6)
    assert np.abs(soften(rigid, loads, EQUATIONS, links_only, cell).pose.lattice - scalar.pose.lattice).max() > 1e-7


def test_free_strain_has_no_compliance(cell):
    s = cauchy_line_load([30.0], [0.0])
    soft = soften(solve_equilibrium(s, EQUATIONS), s, EQUATIONS, 1e4, cell)
    assert soft.status[0] == "stalled"
    assert np.isnan(soft.compliance).all()
