"""A ring drawn to a string: against rigid bars with plastic hinges, followed by linear programs; statics; energy."""

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.sparse import bmat, csr_matrix, eye

from rve import InputError, pulled_ring
from rve.common.materials import STEEL
from rve.wire import straightened_ring


def hinged_path(forces, bars, steps, upto):
    """Reach and force of `bars` rigid bars on a circle of radius 1, M_p = 1: every step turns them in the way that
    costs least (kinematic theorem), with the same speed outwards at every force, whose directions stay."""
    angle = 2.0 * np.pi * (np.arange(bars) + 0.5) / bars + 0.5 * np.pi
    length, at = 2.0 * np.sin(np.pi / bars), np.arange(forces) * bars // forces
    out = np.stack([np.cos(2.0 * np.pi * at / bars), np.sin(2.0 * np.pi * at / bars)], axis=1)
    bend = eye(bars).tocsr() - csr_matrix(np.roll(np.eye(bars), -1, axis=1))
    cost = np.concatenate([np.zeros(bars + 2), np.ones(bars)])
    sides = bmat([[bend, csr_matrix((bars, 2)), -eye(bars)], [-bend, csr_matrix((bars, 2)), -eye(bars)]])
    reach, force = [], []
    for _ in range(steps):
        way = length * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        corner = np.vstack([np.zeros(2), np.cumsum(way, axis=0)])
        centre = corner[:-1].mean(axis=0)
        turn = length * np.stack([-np.sin(angle), np.cos(angle)], axis=1)
        before = np.tri(bars + 1, bars, -1)[at]  # bars before each force
        moves = [np.hstack([(turn * one[:, None]).T, np.eye(2), np.zeros((2, bars))]) for one in before]
        rows = [way @ move for way, move in zip(out, moves, strict=True)]
        rows += [np.concatenate([turn[:, axis], np.zeros(2 + bars)]) for axis in range(2)]  # the ring stays closed
        rows += [sum(np.array([-y, x]) @ move for (x, y), move in zip(out, moves, strict=True))]  # and does not turn
        right = np.concatenate([np.ones(forces), -(corner[-1] - corner[0]) / upto * steps, [0.0]])
        found = linprog(cost, sides, np.zeros(2 * bars), rows, right, bounds=(None, None), method="highs")
        reach.append(((corner[at] - centre) * out).sum(axis=1).mean())
        force.append(found.fun / forces)
        angle = angle + found.x[:bars] * upto / steps
    return np.array(reach), np.array(force)


@pytest.mark.parametrize("forces", [2, 3, 4])
def test_rigid_bars_with_hinges_follow_the_path(forces):
    path = straightened_ring(1.0, 1.0, 0.75, forces, 2001)  # M_p = 1
    whole = path.reach_mm[-1] - 1.0
    reach, force = hinged_path(forces, 96, 80, 0.6 * whole)
    exact = np.interp(reach, path.reach_mm[:-1], path.force_N[:-1])
    assert reach[-1] - 1.0 == pytest.approx(0.6 * whole * 79 / 80, rel=0.03)  # steps of first order
    assert np.abs(force / exact - 1.0).max() < 0.06
    assert np.abs(force / exact - 1.0).mean() < 0.015


@pytest.mark.parametrize("forces", [2, 3, 4, 6])
def test_it_begins_at_collapse_ends_as_a_string_and_costs_the_bending_of_the_circle(forces):
    r1, r2 = 5.0, 0.5
    path, moment = straightened_ring(r1, r2, 235.0, forces, 20_001), 4.0 / 3.0 * r2**3 * 235.0
    h = np.pi / forces
    assert path.force_N[0] == pytest.approx(4.0 * moment / r1 * np.sin(h) / (1.0 - np.cos(h)), rel=1e-12)
    assert 2.0 * forces * path.reach_mm[-1] * np.sin(h) == pytest.approx(2.0 * np.pi * r1, rel=1e-12)
    assert path.work_Nmm[-1] == pytest.approx(4.0 * np.pi * moment, rel=1e-12)
    assert (np.diff(path.force_N) > 0.0).all()
    middle = 0.5 * (path.force_N[1:-1] + path.force_N[:-2])
    way = np.cumsum(forces * middle * np.diff(path.reach_mm[:-1]))
    assert way == pytest.approx(path.work_Nmm[1:-1], rel=1e-3)  # force times way is the work of the hinges


def test_two_forces_balance_two_hinges_at_the_width_of_the_ring():
    path = straightened_ring(1.0, 1.0, 0.75, 2, 50)
    psi = path.work_Nmm / 8.0
    assert path.force_N[:-1] == pytest.approx(4.0 / (1.0 - np.sin(psi[:-1])), rel=1e-9)  # F/2 half-width = 2 M_p
    assert path.force_N[0] == pytest.approx(pulled_ring(1.0, 0.1, STEEL).collapse_N / (4 / 3 * 0.1**3 * 235), rel=1e-6)
    with pytest.raises(InputError, match="forces = 1"):
        straightened_ring(5.0, 0.5, 235.0, 1)
