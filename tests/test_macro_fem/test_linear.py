"""Linear solvers against numpy's dense one, and what they refuse."""

import numpy as np
import pytest
import skfem

import macro_fem
from macro_fem.fem.assembly import stiffness
from macro_fem.fem.discretization import discretize
from macro_fem.fem.linear import NotPositiveDefiniteError, analyze, has_cholmod
from macro_fem.fem.sparsity import sparsity
from rve.common.errors import InputError

METHODS = ["superlu", pytest.param("cholmod", marks=pytest.mark.skipif(not has_cholmod(), reason="no CHOLMOD"))]


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
    solver = analyze(pattern, method)
    assert solver.method == method
    matrices = [data_of(np.ones(disc.n_points)), data_of(np.exp(rng.standard_normal(disc.n_points)))]
    # The first factor is used after the second was made: nothing is shared.
    for solve, data in zip([solver.factorize(data) for data in matrices], matrices, strict=True):
        exact = np.linalg.solve(pattern.full(data).toarray(), b)
        np.testing.assert_allclose(solve(b), exact, atol=1e-9 * np.abs(exact).max())


@pytest.mark.parametrize("method", METHODS)
def test_an_indefinite_matrix_is_refused(problem, method):
    disc, pattern, data_of = problem
    solver = analyze(pattern, method)
    data = data_of(np.ones(disc.n_points))
    data[pattern.diagonal[pattern.n // 2]] = -1.0
    with pytest.raises(NotPositiveDefiniteError, match="not positive"):
        solver.factorize(data)
    with pytest.raises(NotPositiveDefiniteError):
        solver.factorize(data_of(np.zeros(disc.n_points)))
    data[pattern.diagonal[3]] = np.nan
    with pytest.raises(NotPositiveDefiniteError):
        solver.factorize(data)
    assert np.all(np.isfinite(solver.factorize(data_of(np.ones(disc.n_points)))(np.ones(pattern.n))))


def test_auto_takes_what_is_installed(problem):
    _, pattern, _ = problem
    assert analyze(pattern).method == ("cholmod" if has_cholmod() else "superlu")
    if not has_cholmod():
        with pytest.raises(ValueError, match="needs scikit-sparse, which is not installed"):
            analyze(pattern, "cholmod")


def test_unknown_methods_are_refused(problem):
    with pytest.raises(ValueError, match="'pardiso' is not one of auto, cholmod, superlu"):
        analyze(problem[1], "pardiso")


def test_a_method_that_is_not_installed_is_one_sentence_of_the_scene(monkeypatch):
    monkeypatch.setattr("macro_fem.fem.linear.find_spec", lambda name: None)
    tables = {"curtain": {"width": 100.0, "height": 80.0}, "support": {"kind": "top"}}
    scene = macro_fem.read_scene(tables | {"solver": {"linear_solver": "mumps"}})
    with pytest.raises(InputError, match="linear_solver: method = 'mumps' needs petsc4py, which is not installed"):
        macro_fem.solve(scene)
    with pytest.raises(InputError, match="linear_solver = 'superlu': has no effect with kind = 'clarabel'"):
        macro_fem.read_scene(tables | {"solver": {"kind": "clarabel", "linear_solver": "superlu"}})


def test_no_unknowns_no_trouble():
    disc = discretize(skfem.MeshTri(), "P1")
    pattern = sparsity(disc, 2, np.zeros(disc.n_nodes, dtype=bool))
    assert analyze(pattern).factorize(np.zeros(0))(np.zeros(0)).shape == (0,)
