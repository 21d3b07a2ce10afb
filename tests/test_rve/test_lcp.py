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
    step = solve_contact_step(Programme(A, b, G, gap, k))
    assert step.converged.all()
    for i in range(6):
        real = k[i] > 0.0
        lam = dual_forces(A[i], b[i], G[i][real], gap[i][real], k[i][real])
        assert step.lam[i][real] == pytest.approx(lam, rel=1e-7, abs=1e-7 * max(1.0, lam.max(initial=0.0)))
        assert np.all(step.lam[i][~real] == 0.0)


def test_optimality_conditions_hold_to_round_off():
    A, b, G, gap, k = programme(np.random.default_rng(1), 200, 12, 1e4)
    step = solve_contact_step(Programme(A, b, G, gap, k))
    left = np.einsum("nij,nj->ni", A, step.w) - b - np.einsum("nci,nc->ni", G, step.lam)
    scale = 1.0 + np.abs(b).max(axis=1) + np.abs(step.lam).sum(axis=1)
    assert np.all(np.abs(left).max(axis=1) <= 1e-11 * scale)
    slack = np.where(k > 0.0, gap + np.einsum("nci,ni->nc", G, step.w) + step.lam / np.where(k > 0.0, k, 1.0), 0.0)
    assert slack.min() > -1e-12
    assert step.lam.min() >= 0.0
    assert np.abs(slack * step.lam).max() < 1e-9


def test_clarabel_finds_no_lower_energy():
    import clarabel
    from scipy.sparse import block_diag, csc_matrix, eye

    A, b, G, gap, k = programme(np.random.default_rng(2), 1, 10, 100.0)
    k[:] = 100.0
    # min 1/2 w A w - b w + 1/2 k |p|^2 with p >= -(gap + G w), p >= 0
    P = csc_matrix(block_diag([A[0], k[0, 0] * eye(10)]))
    q = np.concatenate([-b[0], np.zeros(10)])
    rows = csc_matrix(np.block([[-G[0], -np.eye(10)], [np.zeros((10, 9)), -np.eye(10)]]))
    options = clarabel.DefaultSettings()
    options.verbose = False
    cones = [clarabel.NonnegativeConeT(20)]
    found = clarabel.DefaultSolver(P, q, rows, np.concatenate([gap[0], np.zeros(10)]), cones, options).solve()
    step = solve_contact_step(Programme(A, b, G, gap, k))
    assert step.w[0] == pytest.approx(np.array(found.x)[:9], abs=1e-6)
    mine = Programme(A, b, G, gap, k).energy(step.w)[0]
    assert mine <= found.obj_val + 1e-8


def test_a_case_does_not_depend_on_its_company():
    problem = programme(np.random.default_rng(3), 40, 15, 1e5)
    together = solve_contact_step(Programme(*problem))
    alone = solve_contact_step(Programme(*problem).take(np.array([7])))
    assert np.array_equal(together.w[7:8], alone.w)
    assert np.array_equal(together.lam[7:8], alone.lam)


def test_a_step_that_is_cut_short_says_so():
    problem = programme(np.random.default_rng(4), 20, 15, 1e4)
    assert not solve_contact_step(Programme(*problem), max_iterations=1).converged.all()


def test_without_contacts_one_iteration_is_enough():
    A, b, G, gap, k = programme(np.random.default_rng(5), 3, 4, 1.0)
    step = solve_contact_step(Programme(A, b, G, gap, 0.0 * k))
    assert np.all(step.iterations == 1)
    assert np.einsum("nij,nj->ni", A, step.w) == pytest.approx(b)
