"""The locked strain under a Cauchy load: right on known sets, at vertices, on flat faces, and honest otherwise."""

import numpy as np
import pytest

from homogenize.law import default_law, diagonal_net
from homogenize.polyhedral import outer_law, polyhedral_law
from homogenize.refine import refined_half_spaces
from homogenize.strain import StrainOptions, locked_strain
from homogenize.tensor import dyad, trace
from rve.table import cauchy_line_load, deformation_gradient, second_pk

from .conftest import disc_grid, rows_of


def load_at(E, alpha, beta):
    S = second_pk(deformation_gradient(E), cauchy_line_load(alpha, beta))
    return S / trace(S)[:, None]


def test_smooth_set_is_found_to_the_error_of_its_rows(ellipsoid):
    rng = np.random.default_rng(10)
    alpha, beta = rng.uniform(-90.0, 90.0, 200), rng.uniform(0.0, 90.0, 200)
    law = polyhedral_law(*refined_half_spaces(rows_of(ellipsoid, disc_grid(12, 48))))
    found = locked_strain(law, alpha, beta)
    assert np.all(found.status == "converged")
    assert np.allclose(found.S, load_at(found.E, alpha, beta), atol=2e-9)
    assert found.iterations.mean() < 15.0
    truth = ellipsoid.strain(found.S)
    assert np.abs(found.E - truth).max() < 0.02  # one facet of the polyhedron: spacing of the rows times curvature
    assert np.abs(found.E - truth).mean() < 0.004


def test_a_vertex_answers_itself():
    corner = np.array([0.1, 0.02, -0.1])
    S = np.vstack([np.eye(3)[[0, 2]], dyad(np.array([[1.0, 1.0], [1.0, -1.0], [1.0, 3.0], [3.0, 1.0]]))])
    law = polyhedral_law(S, S @ (corner * [1.0, 2.0, 1.0]))
    found = locked_strain(law, np.array([10.0, 40.0]), np.array([60.0, 50.0]))
    assert np.all(found.status == "converged")
    assert np.allclose(found.E, corner, atol=1e-12)


def test_a_fibre_under_its_own_load_is_not_unique():
    """The load along a taut fibre leaves the other one free: the answer is one of many, and says so."""
    net = diagonal_net(1.1)
    found = locked_strain(net, np.array([45.0]), np.array([0.0]))
    assert found.status[0] == "converged"
    assert not found.unique[0]
    assert found.E[0] @ (net.half_spaces().S[0] * [1.0, 2.0, 1.0]) == pytest.approx(0.105, abs=1e-9)


def test_the_shipped_law_carries_every_load():
    alpha, beta = (a.ravel() for a in np.meshgrid(np.arange(-90.0, 91.0, 7.5), np.arange(0.0, 91.0, 7.5)))
    law = default_law()
    found = locked_strain(law, alpha, beta)
    assert (found.status == "converged").mean() == 1.0
    assert law.cut(found.E).violation.max() < 1e-10


def test_options_are_obeyed(ellipsoid):
    law = outer_law(rows_of(ellipsoid, disc_grid(4, 16)))
    tired = locked_strain(law, np.array([20.0]), np.array([30.0]), StrainOptions(newton_steps=1, path_steps=1))
    assert tired.status[0] == "no_convergence"
    assert tired.residual[0] > 1e-9
    assert np.isfinite(tired.E).all()
