"""Weaves: jamming limits and start poses found again by sequential linear programming, symmetries, larger cells."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog

from rve import WEAVES, Cell, DirectOptions, InputError, solve_table
from rve.geometry import (
    FOUR_IN_ONE,
    SIX_IN_ONE,
    cauchy_line_load,
    distance_gradient,
    find_contacts,
    moved,
    pair_maps,
    reduction,
    start_pose,
    supercell,
)
from rve.locking import Equations, solve_equilibrium


@pytest.mark.parametrize("name", WEAVES)
def test_start_pose_has_the_largest_clearance_and_it_is_the_jamming_limit(name):
    weave = WEAVES[name]
    maps = pair_maps(weave)
    rng = np.random.default_rng(0)
    pose = moved(start_pose(weave, 1), 0.02 * rng.uniform(-1, 1, (1, 4 * weave.classes + 1)))
    contacts = find_contacts(pose, weave, 0.0, 1.2)
    radius = 0.05
    while radius > 1e-8:
        pair = contacts.minima.pair
        G = np.einsum("mi,mij,jk->mk", distance_gradient(contacts.minima), maps[pair], reduction(pose)[0])
        m = G.shape[1]
        step = linprog(
            np.append(np.zeros(m), -1.0),
            A_ub=np.column_stack([-G, np.ones(len(G))]),
            b_ub=contacts.minima.distance,
            bounds=[(-radius, radius)] * m + [(None, None)],
        ).x[:m]
        trial = moved(pose, step[None])
        found = find_contacts(trial, weave, 0.0, 1.2)
        if found.links_intact[0] and found.min_gap[0] > contacts.min_gap[0]:
            pose, contacts, radius = trial, found, 1.3 * radius
        else:
            radius *= 0.5
    assert 2.0 / contacts.min_gap[0] == pytest.approx(weave.jamming_ratio, rel=1e-6)
    start = find_contacts(start_pose(weave, 1), weave, 0.0, 1.2)
    assert start.min_gap[0] == pytest.approx(contacts.min_gap[0], rel=1e-6)


def mirrored(weave):
    return replace(
        weave,
        start_lattice=weave.start_lattice * [1, 1, -1],
        start_centres=weave.start_centres * [-1, 1],
        start_normals=weave.start_normals * [-1, 1, 1],
    )


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
