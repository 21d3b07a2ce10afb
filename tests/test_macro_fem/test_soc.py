"""Algebra of cones against its definitions, on random vectors."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from homogenize.laws.net import ring_net
from homogenize.laws.protocol import CellInfo
from macro_fem.fem.hung_law import HungLaw, rotation_on_triples
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
    rng = np.random.default_rng(3)
    a = rng.normal(size=(50, 2, 2))
    full = np.einsum("nij,nkj->nik", a, a)
    full[:25] = np.einsum("ni,nj->nij", a[:25, 0], a[:25, 0])
    S = np.stack([full[:, 0, 0], full[:, 0, 1], full[:, 1, 1]], axis=-1)
    L = symmetric_roots(S)
    square = times_root(np.stack([L[:, [0, 1]], L[:, [1, 2]]], axis=1), L).reshape(-1, 2, 2)
    assert np.abs(square - full).max() < 1e-12 * np.abs(full).max() * 10


@given(st.floats(-360.0, 360.0))
@settings(deadline=None, max_examples=40)
def test_a_turned_law_is_the_law_seen_turned(angle):
    law = ring_net(CellInfo(5.0, 0.5, 11.0, 12.646069623526, 2.785))
    rng = np.random.default_rng(1)
    E = 0.3 * rng.normal(size=(20, 3))
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    R = np.array([[c, -s], [s, c]])
    full = np.stack([E[:, [0, 1]], E[:, [1, 2]]], axis=1)
    there = np.einsum("ki,nkl,lj->nij", R, full, R)
    in_weave = np.stack([there[:, 0, 0], there[:, 0, 1], there[:, 1, 1]], axis=-1)
    assert np.abs(E @ rotation_on_triples(-angle).T - in_weave).max() < 1e-12
    one, two = HungLaw(law, angle), law
    assert np.abs(one.cut(E).violation - two.cut(in_weave).violation).max() < 1e-9
    assert np.abs(one.response(E).energy - two.response(in_weave).energy).max() < 1e-9 * 1000.0
    S = np.abs(rng.normal(size=(5, 1))) * np.array([[0.5, 0.1, 0.5]])
    assert np.abs(one.support(S) - two.support(S @ rotation_on_triples(-angle).T)).max() < 1e-9
    # work conjugacy: the response's stress is the gradient of its energy, in the turned frame too
    h = 1e-6
    gradient = np.stack(
        [(one.response(E + h * e).energy - one.response(E - h * e).energy) / (2 * h) for e in np.eye(3)], axis=-1
    )
    assert np.abs(gradient / np.array([1.0, 2.0, 1.0]) - one.response(E).S).max() < 1e-2
