"""The contact step: its conditions, which have one solution."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rve.simulation.stewart_trinkle import solve_contact_step


def programme(rng, n, c, stiffness):
    """A random contact step: A positive definite, some contacts closed, slots without contact among them."""
    root = rng.normal(size=(n, 9, 9))
    A = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(9)
    k = np.where(rng.random((n, c)) < 0.8, stiffness, 0.0)
    return A, rng.normal(size=(n, 9)), rng.normal(size=(n, c, 9)), rng.normal(size=(n, c)) * 0.1, k


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10**6), contacts=st.integers(1, 20), power=st.integers(0, 9))
def test_balance_and_complementarity_hold_in_every_step(seed, contacts, power):
    A, b, G, gap, k = programme(np.random.default_rng(seed), 6, contacts, 10.0**power)
    w, beta, is_solved = solve_contact_step(A, b, G[:, :, None], gap, k)
    lam = beta[..., 0]
    assert is_solved.all()
    assert (lam >= 0.0).all()
    assert not lam[k == 0.0].any()
    force = np.einsum("ncm,nc->nm", G, lam)
    assert np.einsum("nij,nj->ni", A, w) == pytest.approx(b + force, abs=1e-9 * max(1.0, np.abs(force).max()))
    real, size = k > 0.0, np.abs(G).sum(axis=2) * np.abs(w).max(axis=1)[:, None] + np.abs(gap)
    left = gap + np.einsum("ncm,nm->nc", G, w) + lam / np.where(real, k, 1.0)
    assert left[real].min(initial=0.0) > -1e-8 * size.max()
    assert np.abs(lam * left)[real].max(initial=0.0) < 1e-8 * size.max() * max(1.0, lam.max())


def test_a_step_whose_forces_are_not_found_says_so(monkeypatch):
    def fails(*_):
        raise RuntimeError

    monkeypatch.setattr("rve.simulation.stewart_trinkle.nnls", fails)
    A, b, G, gap, k = programme(np.random.default_rng(4), 3, 15, 1e4)
    assert not solve_contact_step(A, b, G[:, :, None], gap, k)[2].any()
