"""Linear solvers against numpy's dense one, and what they refuse."""

import numpy as np
import pytest
import skfem

from macro_fem.fem.assembly import stiffness
from macro_fem.fem.discretization import discretize
from macro_fem.fem.linear import NotPositiveDefiniteError, analyze, cholmod, linear_solver, superlu
from macro_fem.fem.sparsity import sparsity

METHODS = [superlu, *([cholmod] if linear_solver() == "cholmod" else [])]


@pytest.fixture(scope="module")
def problem():
    """An isotropic sheet held at its left edge, and a function from stiffness per cell to matrix data."""
    ticks = np.linspace(0.0, 1.0, 13)
    disc = discretize(skfem.MeshQuad.init_tensor(ticks, ticks), "Q1")
    pattern = sparsity(disc, 2, disc.nodes[:, 0] > 0.0)
    A = np.zeros((2, 2, 2, 2))
    for i, j in np.ndindex(2, 2):
        A[i, j, i, j] += 1.0
        A[i, j, j, i] += 1.0
        A[i, i, j, j] += 0.5
    return disc, pattern, lambda E: stiffness(disc, pattern, E[:, None, None, None, None] * A)


@pytest.mark.parametrize("method", METHODS)
def test_two_matrices_of_one_pattern_are_each_solved(problem, method):
    disc, pattern, data_of = problem
    rng = np.random.default_rng(0)
    b = rng.standard_normal(pattern.n)
    factorize = method(pattern)
    matrices = [data_of(np.ones(disc.n_points)), data_of(np.exp(rng.standard_normal(disc.n_points)))]
    # The first factor is used after the second was made: nothing is shared.
    for solve, data in zip([factorize(data) for data in matrices], matrices, strict=True):
        exact = np.linalg.solve(pattern.full(data).toarray(), b)
        np.testing.assert_allclose(solve(b), exact, atol=1e-9 * np.abs(exact).max())


@pytest.mark.parametrize("method", METHODS)
def test_an_indefinite_matrix_is_refused(problem, method):
    disc, pattern, data_of = problem
    factorize = method(pattern)
    data = data_of(np.ones(disc.n_points))
    data[pattern.diagonal[pattern.n // 2]] = -1.0
    with pytest.raises(NotPositiveDefiniteError, match="not positive"):
        factorize(data)
    with pytest.raises(NotPositiveDefiniteError):
        factorize(data_of(np.zeros(disc.n_points)))
    data[pattern.diagonal[3]] = np.nan
    with pytest.raises(NotPositiveDefiniteError):
        factorize(data)
    assert np.all(np.isfinite(factorize(data_of(np.ones(disc.n_points)))(np.ones(pattern.n))))


def test_no_unknowns_no_trouble():
    disc = discretize(skfem.MeshTri(), "P1")
    pattern = sparsity(disc, 2, np.zeros(disc.n_nodes, dtype=bool))
    assert analyze(pattern)(np.zeros(0))(np.zeros(0)).shape == (0,)
