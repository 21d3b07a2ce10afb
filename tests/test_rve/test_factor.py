"""Factors of sparse symmetric matrices against numpy's dense solver, and what they refuse."""

import numpy as np
import pytest
from scipy import sparse

from rve.common import Factorizer, linear_solver

METHODS = ["superlu", *(["cholmod"] if linear_solver() == "cholmod" else [])]


def laplacian(weight):
    """A positive definite matrix with the pattern of a square grid."""
    line = sparse.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(12, 12))
    grid = sparse.kron(line, sparse.eye(12)) + sparse.kron(sparse.eye(12), line)
    scale = sparse.diags(weight)
    found = (scale @ grid @ scale).tocsc()
    found.sort_indices()
    return found


@pytest.mark.parametrize("method", METHODS)
def test_matrices_of_one_pattern_and_of_another_are_each_solved(method):
    rng = np.random.default_rng(0)
    factorize, b = Factorizer(method), rng.standard_normal((144, 2))
    matrices = [laplacian(np.exp(rng.standard_normal(144))) for _ in range(3)]
    matrices += [matrices[0] + sparse.diags([np.full(100, 1e-3), np.full(100, 1e-3)], [44, -44], format="csc")]
    # The first factor is used after the second was made: nothing is shared.
    for solve, matrix in zip([factorize(matrix) for matrix in matrices], matrices, strict=True):
        assert callable(solve)
        exact = np.linalg.solve(matrix.toarray(), b)
        np.testing.assert_allclose(solve(b), exact, atol=1e-9 * np.abs(exact).max())
        np.testing.assert_allclose(solve(b[:, 0]), solve(b)[:, 0], rtol=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_an_indefinite_matrix_is_refused_and_its_row_is_told(method):
    factorize, good = Factorizer(method), laplacian(np.ones(144))
    for _ in range(2):  # without an order, then with one
        bad = good.copy()
        bad[70, 70] = -1.0
        rows = factorize(bad)
        assert not callable(rows)
        assert 70 in rows or method == "cholmod"
        assert not callable(factorize(0.0 * good))
        assert callable(factorize(good))
