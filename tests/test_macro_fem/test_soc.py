"""Algebra of cones against its definitions, on random vectors."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from macro_fem.solvers import soc
from macro_fem.solvers.cones import symmetric_roots, times_root


def inside(rng, n=200, m=4):
    tail = rng.normal(size=(n, m))
    return soc.Vectors(np.linalg.norm(tail, axis=1) + rng.exponential(size=n), tail)


@pytest.mark.parametrize("seed", range(3))
def test_scaling_maps_both_vectors_to_one_point(seed):
    rng = np.random.default_rng(seed)
    s, y = inside(rng), inside(rng)
    W = soc.scaling(s, y)
    one, two = W.apply(y), W.undo(s)
    assert np.abs(one.head - two.head).max() < 1e-9 * one.head.max()
    assert np.abs(one.tail - two.tail).max() < 1e-9 * one.head.max()
    v = soc.Vectors(rng.normal(size=200), rng.normal(size=(200, 4)))
    back = W.undo(W.apply(v))
    assert np.abs(back.head - v.head).max() < 1e-8
    twice, at_once = W.undo(W.undo(v)), W.undo_twice(v)
    assert np.abs(at_once.head - twice.head).max() < 1e-8 * np.abs(twice.tail).max()
    assert np.abs(at_once.tail - twice.tail).max() < 1e-8 * np.abs(twice.tail).max()


def test_division_and_inverse_solve_the_product():
    rng = np.random.default_rng(7)
    a, d = inside(rng), soc.Vectors(rng.normal(size=200), rng.normal(size=(200, 4)))
    back = soc.product(a, soc.divide(a, d))
    assert np.abs(back.head - d.head).max() < 1e-9
    assert np.abs(back.tail - d.tail).max() < 1e-9
    unit = soc.product(a, soc.inverse(a, 2.5))
    assert np.abs(unit.head - 2.5).max() < 1e-9
    assert np.abs(unit.tail).max() < 1e-9


def test_largest_step_along_the_vector_itself_ends_at_the_tip_of_the_cone():
    """Where rounding makes the discriminant, 0 there, negative: heads of a limit that stalled at its first step."""
    heads = np.random.default_rng(1).uniform(0.1, 10.0, (2, 500))
    steps = [soc.largest_step(*(soc.Vectors(np.array([x]), np.zeros((1, 4))) for x in (v, -d))) for v, d in heads.T]
    assert steps == pytest.approx(heads[0] / heads[1], rel=1e-6)


@given(st.integers(0, 10_000))
@settings(deadline=None, max_examples=60)
def test_largest_step_ends_on_the_boundary(seed):
    rng = np.random.default_rng(seed)
    v, dv = inside(rng, 5), soc.Vectors(rng.normal(size=5), rng.normal(size=(5, 4)))
    step = soc.largest_step(v, dv)
    if np.isinf(step):
        assert (v + dv * 1e6).margin().min() > 0.0
    else:
        assert (v + dv * (0.999999 * step)).margin().min() > 0.0
        assert (v + dv * (1.000001 * step + 1e-12)).margin().min() < 1e-9 * max(1.0, step)


def test_roots_square_to_their_tensor_also_at_rank_one():
    a = np.random.default_rng(3).normal(size=(50, 2, 2))
    full = np.einsum("nij,nkj->nik", a, a)
    full[:25] = np.einsum("ni,nj->nij", a[:25, 0], a[:25, 0])
    S = np.stack([full[:, 0, 0], full[:, 0, 1], full[:, 1, 1]], axis=-1)
    L = symmetric_roots(S)
    square = times_root(np.stack([L[:, [0, 1]], L[:, [1, 2]]], axis=1), L).reshape(-1, 2, 2)
    assert np.abs(square - full).max() < 1e-12 * np.abs(full).max() * 10
