"""The batched contact step against independent solvers of the same convex programme."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from rve.paper.contact_qp import Programme, solve_contact_step


def programme(rng, n, c, stiffness):
    """A random contact step: A positive definite, some contacts closed, slots without contact among them."""
    root = rng.normal(size=(n, 9, 9))
    A = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(9)
    k = np.where(rng.random((n, c)) < 0.8, stiffness, 0.0)
    return A, rng.normal(size=(n, 9)), rng.normal(size=(n, c, 9)), rng.normal(size=(n, c)) * 0.1, k


def dual_forces(A, b, G, gap, k):
    """Contact forces of one case by non-negative least squares on the dual."""
    if not len(k):
        return np.zeros(0)  # scipy's nnls aborts the interpreter on an empty matrix
    inverse = np.linalg.inv(A)
    L = np.linalg.cholesky(np.diag(1.0 / k) + G @ inverse @ G.T)
    lam, _ = nnls(L.T, -solve_triangular(L, gap + G @ inverse @ b, lower=True))
    return lam


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10**6), contacts=st.integers(1, 20), power=st.integers(0, 5))
def test_forces_are_those_of_non_negative_least_squares(seed, contacts, power):
    A, b, G, gap, k = programme(np.random.default_rng(seed), 6, contacts, 10.0**power)
    _, forces, converged = solve_contact_step(Programme(A, b, G, gap, k))
    assert converged.all()
    for i in range(6):
        real = k[i] > 0.0
        lam = dual_forces(A[i], b[i], G[i][real], gap[i][real], k[i][real])
        assert forces[i][real] == pytest.approx(lam, rel=1e-7, abs=1e-7 * max(1.0, lam.max(initial=0.0)))
        assert np.all(forces[i][~real] == 0.0)


def test_a_step_that_is_cut_short_says_so():
    problem = programme(np.random.default_rng(4), 20, 15, 1e4)
    assert not solve_contact_step(Programme(*problem), max_iterations=1)[2].all()
