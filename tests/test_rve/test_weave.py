"""Weaves: jamming limits and start poses found again by sequential linear programming, symmetries, larger cells."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar, nnls

from rve import WEAVES, Cell, DirectOptions, InputError, solve_table
from rve.geometry import (
    FOUR_IN_ONE,
    SIX_IN_ONE,
    cauchy_line_load,
    moved,
    pair_geometry,
    start_pose,
    supercell,
    tangent_frame,
)
from rve.locking import Equations, solve_equilibrium


def clearances(pose, weave, along=()):
    """Local minima of the distance of the centre circles over both wires, by sampling one circle and a line search;
    and the distances at the places `along`, or some of them all round parallel circles over each other."""
    found = []
    t = np.linspace(0.0, 2.0 * np.pi, 4000, endpoint=False)
    d, n_a, n_b = (part[0] for part in pair_geometry(pose, weave))
    radii = np.column_stack(weave.pair_radii)
    for pair in np.flatnonzero(np.linalg.norm(d, axis=1) < 1.4 * radii.sum(axis=1)):
        e1, e2 = tangent_frame(n_a[pair])
        a, b = radii[pair]

        def distance(t, pair=pair, e1=e1, e2=e2, a=a, b=b):
            p = a * (np.multiply.outer(np.cos(t), e1) + np.multiply.outer(np.sin(t), e2)) - d[pair]
            z = p @ n_b[pair]
            return np.hypot(z, np.sqrt(np.maximum((p * p).sum(axis=-1) - z * z, 0.0)) - b)

        f = distance(t)
        if (np.ptp(f) < 1e-6 and f[0] < 0.8) or any(pair == other for other, _ in along):
            at = np.array([place for other, place in along if other == pair]) if along else t[::400]
            found += [(int(pair), x, y / weave.pair_wires[pair]) for x, y in zip(at, distance(at), strict=True)]
            continue
        for k in np.flatnonzero((f <= np.roll(f, 1)) & (f < np.roll(f, -1)) & (f < 0.8)):
            bracket = t[k] + np.array([-1.0, 1.0]) * (t[1] - t[0])
            least = minimize_scalar(distance, bounds=bracket, method="bounded", options={"xatol": 1e-11})
            found.append((int(pair), float(least.x), float(least.fun) / float(weave.pair_wires[pair])))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", WEAVES)
def test_start_pose_has_the_largest_clearance_and_it_is_the_jamming_limit(name):
    """Multipliers of the least clearances balance: no small motion enlarges them all. Distances and derivatives are the
    test's own."""
    weave, step = WEAVES[name], 1e-5
    start = start_pose(weave, 1)
    least = min(size for *_, size in clearances(start, weave))
    assert 1.0 / least == pytest.approx(weave.jamming_ratio, rel=1e-6)
    active = [(pair, at) for pair, at, size in clearances(start, weave) if size < least + 1e-6]
    along = [(pair, at) for pair, at in active if sum(pair == other for other, _ in active) > 2]

    def sizes(way):
        there = clearances(moved(start, way[None]), weave, along)
        apart = [[(abs(np.sin(0.5 * (at - t))), s) for p, t, s in there if p == pair] for pair, at in active]
        return np.array([min(one)[1] for one in apart])

    ways = step * np.eye(weave.coordinates)
    slope = np.array([(sizes(way) - sizes(-way)) / (2.0 * step) for way in ways])
    weight, residual = nnls(np.vstack([slope, np.ones(len(active))]), np.append(np.zeros(len(slope)), 1.0))
    assert residual < 1e-4
    assert weight.sum() == pytest.approx(1.0, rel=1e-3)


def mirrored(weave):
    return replace(
        weave,
        start_lattice=weave.start_lattice * [1, 1, -1],
        start_centres=weave.start_centres * [-1, 1],
        start_normals=weave.start_normals * [-1, 1, 1],
    )


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [6.5, 10.0])
def test_six_in_one_locks_convexly_and_has_two_mirror_forms(ratio):
    alpha, beta = (x.ravel() for x in np.meshgrid([-45.0, 0.0, 20.0], [0.0, 30.0, 60.0, 90.0]))
    one = solve_table(Cell(5.0, 5.0 / ratio, SIX_IN_ONE), (alpha, beta))
    other = solve_table(Cell(5.0, 5.0 / ratio, mirrored(SIX_IN_ONE)), (-alpha, beta))
    assert (one.status == "converged").all()
    np.testing.assert_allclose(other.E, one.E * [1, -1, 1], atol=1e-8)
    work = np.einsum("ik,ijk->ij", one.S * [1, 2, 1], one.E[:, None] - one.E[None])
    assert work.min() > -1e-9
    assert SIX_IN_ONE.linked.sum() == 6  # links of one ring A; those of ring B are the same ones


def test_six_in_one_jams_earlier():
    with pytest.raises(InputError, match=r"6-in-1 weave, which jams at r1/r2 = 5\.94"):
        Cell(5.0, 1.0, SIX_IN_ONE)


@pytest.mark.parametrize("shape", [(2, 1), (2, 2), pytest.param((3, 3), marks=pytest.mark.slow)])
def test_small_cell_is_representative(shape):
    """2 x 2 and 3 x 3 independent primitive cells, disturbed at the start, lock in the strain of the small cell."""
    alpha, beta = np.array([0.0, 10.0, 35.0, -20.0]), np.array([90.0, 30.0, 60.0, 45.0])
    large = supercell(FOUR_IN_ONE, *shape)
    s = cauchy_line_load(alpha, beta)
    start = start_pose(large, len(s))
    rng = np.random.default_rng(1)
    start = moved(start, 0.03 * rng.uniform(-1, 1, (len(s), 4 * large.classes + 1)))
    found = solve_equilibrium(s, Equations.of(large, 0.1), DirectOptions(), start)
    assert (found.status == "converged").all()
    small = solve_equilibrium(s, Equations.of(FOUR_IN_ONE, 0.1))
    np.testing.assert_allclose(found.pose.lattice / [*shape, 1], small.pose.lattice, atol=1e-7)
