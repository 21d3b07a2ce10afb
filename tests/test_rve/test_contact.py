"""Contact of two tori against dense sampling, closed forms and differences."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from rve.geometry import (
    FOUR_IN_ONE,
    are_linked,
    distance_gradient,
    distance_hessian,
    foot_on_circle,
    local_minima,
    start_pose,
    tangent_frame,
    unlisted_gap,
)


def unit(x):
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def random_pairs(rng, n, low=0.3, high=2.2):
    d = unit(rng.normal(size=(n, 3))) * rng.uniform(low, high, (n, 1))
    return d, unit(rng.normal(size=(n, 3))), unit(rng.normal(size=(n, 3)))


def sampled_distance(d, n_a, n_b, angles):
    """Distance from each point of circle A to circle B, by the plain formula, pair by pair."""
    e1, e2 = tangent_frame(n_a)
    point = np.cos(angles)[:, None] * e1 + np.sin(angles)[:, None] * e2 - d
    height = point @ n_b
    return np.hypot(height, np.linalg.norm(point - height[:, None] * n_b, axis=1) - 1.0)


def brute_minima(d, n_a, n_b, count=20000):
    f = sampled_distance(d, n_a, n_b, 2 * np.pi * np.arange(count) / count)
    return np.sort(f[(f <= np.roll(f, 1)) & (f < np.roll(f, -1))])


@pytest.mark.slow
def test_every_close_minimum_is_found():
    rng = np.random.default_rng(1)
    d, n_a, n_b = random_pairs(rng, 400)
    found = local_minima(d, n_a, n_b)
    compared = 0
    for i in range(len(d)):
        brute = brute_minima(d[i], n_a[i], n_b[i])
        mine = np.sort(found.distance[found.pair == i])
        # Contacts are looked for below 1; farther ones may sit on the axis of the other ring, where f has a kink.
        brute, mine = brute[(brute > 0.02) & (brute < 1.0)], mine[(mine > 0.02) & (mine < 1.0)]
        assert len(brute) == len(mine)
        np.testing.assert_allclose(mine, brute, atol=2e-5)
        compared += len(mine)
    assert compared > 300


def test_minima_in_basins_narrower_than_the_samples_are_found(monkeypatch):
    """Their slope keeps its sign from sample to sample and is least beside them; no pair has more than two minima."""
    pairs = random_pairs(np.random.default_rng(11), 4000)

    def counts(samples):
        return np.bincount(local_minima(*pairs, reach=0.9, samples=samples).pair, minlength=4000)

    truth = counts(1536)
    np.testing.assert_array_equal(counts(48), truth)
    assert truth.max() == 2
    monkeypatch.setattr("rve.geometry.ring_pair._shoulders", lambda *_: (np.zeros(0, int), np.zeros(0, int)))
    assert (counts(48) < truth).any()


def test_minima_of_rings_of_other_sizes_within_reach_are_those_of_a_search_without_end():
    rng = np.random.default_rng(4)
    radii = rng.uniform(0.3, 4.0, (2, 3000))
    d, n_a, n_b = random_pairs(rng, 3000, 0.3, 5.0)
    near, all_ = (local_minima(d, n_a, n_b, tuple(radii), reach=reach) for reach in (0.1, np.inf))
    within = all_.take(all_.distance <= 0.1)
    assert len(within.pair) > 100
    np.testing.assert_array_equal(near.pair, within.pair)
    np.testing.assert_allclose(near.distance, within.distance, atol=1e-12)


def test_twins_closer_than_the_samples_are_both_found():
    # Two taut rings in planes at the angle chi: one contact for |cos chi| < 1 - d', two beyond; here just beyond.
    wire = 0.1
    d = np.array([[2.0 - 2.0 * wire, 0.0, 0.0]])
    for excess, count in ((-1e-3, 1), (1e-3, 2), (1e-2, 2)):
        half = 0.5 * np.arccos(1.0 - 2.0 * wire + excess)
        n_a = np.array([[0.0, np.sin(half), np.cos(half)]])
        n_b = np.array([[0.0, -np.sin(half), np.cos(half)]])
        found = local_minima(d, n_a, n_b, reach=0.5)
        assert len(found.pair) == count, excess


@pytest.mark.parametrize("seed", range(3))
def test_gradient_and_hessian_are_derivatives(seed):
    rng = np.random.default_rng(seed)
    d, n_a, n_b = random_pairs(rng, 60)
    found = local_minima(d, n_a, n_b)
    found = found.take((found.curvature > 0.05) & (found.distance > 0.05))
    assert len(found.pair) > 50
    gradient, hessian = distance_gradient(found), distance_hessian(found, n_a[found.pair], n_b[found.pair])

    def moved(row, q):
        i = found.pair[row]
        turned = [Rotation.from_rotvec(q[3:6]).apply(n_a[i]), Rotation.from_rotvec(q[6:]).apply(n_b[i])]
        near = local_minima((d[i] + q[:3])[None], turned[0][None], turned[1][None])
        same = np.argmin(np.linalg.norm(near.rho_a - found.rho_a[row], axis=1))
        return near.distance[same], distance_gradient(near)[same]

    h = 3e-6  # third derivatives reach 1e3 where the curvature is 0.05: truncation 1e-9, round-off 1e-11
    for row in range(0, len(found.pair), 7):
        plus, minus = zip(*(((moved(row, h * e)), moved(row, -h * e)) for e in np.eye(9)), strict=True)
        g = np.array([(p[0] - m[0]) / (2 * h) for p, m in zip(plus, minus, strict=True)])
        H = np.array([(p[1] - m[1]) / (2 * h) for p, m in zip(plus, minus, strict=True)])
        np.testing.assert_allclose(gradient[row], g, atol=1e-8)
        scale = max(1.0, np.abs(hessian[row]).max())
        # The gradient in turned coordinates differs from the Hessian by a skew part that is no second derivative.
        tilts = block_diag(np.eye(3), *(np.stack(tangent_frame(n[found.pair[row]]), axis=1) for n in (n_a, n_b)))
        mine, other = (tilts.T @ of @ tilts for of in (hessian[row], 0.5 * (H + H.T)))
        np.testing.assert_allclose(mine, other, atol=1e-5 * scale**2)


@settings(deadline=None, max_examples=50)
@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3), st.integers(0, 2**31))
def test_distance_does_not_care_about_the_frame_or_the_order(x, y, z, seed):
    rng = np.random.default_rng(seed)
    d, n_a, n_b = random_pairs(rng, 1)
    R = Rotation.from_rotvec([x, y, z])
    plain = np.sort(local_minima(d, n_a, n_b, reach=0.9).distance)
    turned = np.sort(local_minima(R.apply(d), R.apply(n_a), R.apply(n_b), reach=0.9).distance)
    swapped = np.sort(local_minima(-d, n_b, n_a, reach=0.9).distance)
    np.testing.assert_allclose(turned, plain, atol=1e-12)
    np.testing.assert_allclose(swapped, plain, atol=1e-12)


Z, Y, TILT = [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, np.sin(1e-8), np.cos(1e-8)]
PAIRS = {
    "coaxial": ([0.0, 0.0, 0.7], Z, [0.7]),
    "identical": ([0.0, 0.0, 0.0], Z, [0.0]),
    "identical, turned by 1e-8": ([0.0, 0.0, 0.0], TILT, [0.0, 0.0]),
    "concentric, perpendicular": ([0.0, 0.0, 0.0], Y, [0.0, 0.0]),
    "coplanar, apart": ([2.5, 0.0, 0.0], Z, [0.5]),
    "coplanar, crossing": ([1.0, 0.0, 0.0], Z, [0.0, 0.0]),
    "parallel planes, crossing projections": ([1.0, 0.0, 0.3], Z, [0.3, 0.3]),
    "nearly parallel planes": ([1.0, 0.0, 0.3], TILT, [0.3, 0.3]),
    "taut in perpendicular planes": ([1.8, 0.0, 0.0], Y, [0.2]),
    "about to slip out": ([2.0 - 1e-6, 0.0, 0.0], Y, [1e-6]),
}
"""Centre and normal of circle B, A being at the origin with normal z, and all least distances below 0.8."""


@pytest.mark.parametrize("name", PAIRS)
def test_degenerate_pairs_by_name(name):
    d, n_b, expected = PAIRS[name]
    circles = np.array([d]), np.array([Z]), np.array([n_b])
    found = local_minima(*circles, reach=0.8)
    np.testing.assert_allclose(np.sort(found.distance), expected, atol=1e-8)
    derivatives = distance_gradient(found), distance_hessian(found, *(n[found.pair] for n in circles[1:]))
    assert all(np.isfinite(part).all() for part in (found.normal, *derivatives))


def gauss_linking(d, n_a, n_b, count=400):
    t = 2 * np.pi * np.arange(count) / count
    e1, e2 = tangent_frame(np.stack([n_a, n_b]))
    a = np.cos(t)[:, None] * e1[0] + np.sin(t)[:, None] * e2[0]
    b = d + np.cos(t)[:, None] * e1[1] + np.sin(t)[:, None] * e2[1]
    da, db = np.cross(n_a, a), np.cross(n_b, b - d)
    x = a[:, None] - b[None]
    triple = np.einsum("ijk,ijk->ij", x, np.cross(da[:, None], db[None]))
    return (triple / np.linalg.norm(x, axis=2) ** 3).sum() * (t[1]) ** 2 / (4 * np.pi)


@pytest.mark.slow
def test_linking_agrees_with_the_gauss_integral():
    rng = np.random.default_rng(3)
    d, n_a, n_b = random_pairs(rng, 300)
    closest = np.array([brute_minima(d[i], n_a[i], n_b[i], 2000).min() for i in range(len(d))])
    linked = are_linked(d, n_a, n_b)
    clear = np.flatnonzero(closest > 0.15)
    number = np.array([gauss_linking(d[i], n_a[i], n_b[i]) for i in clear])
    np.testing.assert_allclose(np.abs(number), linked[clear].astype(float), atol=0.05)
    assert 10 < linked[clear].sum() < len(clear) - 10


def test_the_foot_of_a_point_on_a_circle_is_the_nearest_of_many_also_on_its_axis():
    rng = np.random.default_rng(3)
    n = unit(rng.normal(size=(6, 3)))
    p = rng.normal(size=(6, 3))
    p[:2] = [[1.5], [0.0]] * n[:2]  # on the axis, and at the centre
    foot = foot_on_circle(p, n)
    assert np.linalg.norm(foot, axis=1) == pytest.approx(1.0, abs=1e-12)
    assert (foot * n).sum(axis=1) == pytest.approx(0.0, abs=1e-12)
    e, f = tangent_frame(n)
    angle = np.linspace(0.0, 2.0 * np.pi, 2001)[:, None, None]
    sampled = np.linalg.norm(np.cos(angle) * e + np.sin(angle) * f - p, axis=2).min(axis=0)
    assert np.linalg.norm(foot - p, axis=1) == pytest.approx(sampled, abs=1e-5)


def test_the_gap_of_unlisted_pairs_is_a_bound():
    pose = start_pose(FOUR_IN_ONE, 1)
    squeezed = replace(pose, lattice=pose.lattice * np.array([0.3, 0.3, 1.0]))
    assert unlisted_gap(pose, FOUR_IN_ONE, 0.1)[0] > 0.3
    assert unlisted_gap(squeezed, FOUR_IN_ONE, 0.1)[0] < 0.0
