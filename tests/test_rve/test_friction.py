"""Friction between rings: closed forms of slipping, states of rest that balance, loops, and the limit without it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

from rve import Cell, InputError, SimulationOptions, friction_loop, simulate
from rve.geometry import distance_gradient, local_minima, slip_gradient
from rve.locking import lattice_load
from rve.simulation import ROUND_OFF, Dynamics
from rve.simulation.stewart_trinkle import solve_contact_step

ROUGH = SimulationOptions(friction=0.1, tolerance=1e-6)


def test_slip_is_how_the_points_of_both_skins_move_past_each_other():
    """Material points of two rigid rings, moved by a small step; a rotation of both together slips nowhere."""
    rng, r_a, r_b, h = np.random.default_rng(3), 0.1, 0.07, 1e-6
    for _ in range(5):
        d, n_a, n_b = rng.normal(size=(3, 1, 3))
        n_a, n_b = (n / np.linalg.norm(n) for n in (n_a, n_b))
        found = local_minima(d, n_a, n_b).take(np.array([0]))
        (rows,), u = slip_gradient(found, n_a, r_a, r_b), found.normal[0]
        step = h * rng.normal(size=9)
        p_a, p_b = found.rho_a[0] + r_a * u, found.rho_b[0] - r_b * u
        moved = (
            step[:3]
            + Rotation.from_rotvec(step[6:]).apply(p_b)
            - p_b
            - Rotation.from_rotvec(step[3:6]).apply(p_a)
            + p_a
        )
        along = np.cross(n_a[0], found.rho_a[0])
        tangents = np.stack([along, np.cross(u, along)])
        assert rows @ step / h == pytest.approx(tangents @ moved / h, abs=1e-5)
        assert tangents @ u == pytest.approx(0.0, abs=1e-7)
        w = rng.normal(size=3)
        apart = (found.distance[0] - r_a - r_b) * np.cross(w, u)  # skins that do not touch turn past each other
        assert rows @ np.concatenate([np.cross(w, d[0]), w, w]) == pytest.approx(tangents @ apart, abs=1e-7)


def moves(force, normals, tangents, friction):
    """How far a block of little drag moves by a force on it, pressed on planes with these normals (c, m)."""
    m = len(force)
    edges = np.stack([friction * np.outer([1, -1], t) for t in tangents]) + normals[:, None]
    A, none = 1e-6 * np.eye(m)[None], np.zeros((1, len(normals)))
    w, beta, is_solved = solve_contact_step(A, np.asarray(force)[None], edges[None], none, none + 1e6)
    assert is_solved.all()
    assert beta.min() >= 0.0
    return float(np.abs(w).max())


@pytest.mark.parametrize("friction", [0.05, 0.3, 1.2])
def test_a_block_on_a_slope_slips_at_the_friction_angle(friction):
    for share, slips in ((0.999, False), (1.001, True)):
        angle = share * np.arctan(friction)
        weight = np.array([np.sin(angle), -np.cos(angle)])
        assert (moves(weight, np.array([[0.0, 1.0]]), np.array([[1.0, 0.0]]), friction) > 1.0) == slips


@pytest.mark.parametrize("half_angle", [20.0, 45.0, 80.0])
def test_a_ring_in_a_wedge_is_pushed_along_it_by_friction_times_weight_over_the_sine(half_angle):
    c, s, friction = np.cos(np.radians(half_angle)), np.sin(np.radians(half_angle)), 0.2
    walls = np.array([[c, s, 0.0], [-c, s, 0.0]])
    for share, slips in ((0.999, False), (1.001, True)):
        push = np.array([0.0, -1.0, share * friction / s])
        assert (moves(push, walls, np.array([[0.0, 0.0, 1.0]] * 2), friction) > 1.0) == slips


@pytest.mark.parametrize(("friction", "count"), [(0.3, 8), (0.1, 20)])
def test_a_rope_over_rings_slips_at_the_capstan_ratio(friction, count):
    """A polygon of stiff springs, half a turn over `count` points: the tension grows by (1 + mu tan(d/2))/(1 - mu
    tan(d/2)) at each, which tends to Euler's exp(mu pi)."""
    d = np.pi / count
    angle = (np.arange(count) + 0.5) * d
    normals, tangents = np.stack([np.cos(angle), np.sin(angle)], 1), np.stack([-np.sin(angle), np.cos(angle)], 1)
    ratio = ((1.0 + friction * np.tan(0.5 * d)) / (1.0 - friction * np.tan(0.5 * d))) ** count
    assert ratio == pytest.approx(np.exp(friction * np.pi), rel=0.02)
    A, place = 1e-4 * np.eye(2 * count), np.eye(2 * count).reshape(count, 2, -1)
    for i in range(count - 1):
        e = normals[i + 1] - normals[i]
        row = (e / np.linalg.norm(e)) @ (place[i + 1] - place[i])
        A += 1e4 * np.outer(row, row)
    N, T = (np.einsum("ix,ixm->im", one, place) for one in (normals, tangents))
    cone, none = np.stack([N + friction * T, N - friction * T], 1), np.zeros((1, count))
    for share, slips in ((0.99, False), (1.01, True)):
        pull = place[0].T @ [0.0, -1.0] + share * ratio * (place[-1].T @ [0.0, -1.0])
        w, _, is_solved = solve_contact_step(A[None], pull[None], cone[None], none, none + 1e6)
        assert is_solved.all()
        assert (np.abs(w).max() > 1.0) == slips


@pytest.mark.parametrize(("start", "end"), [(0.2, 0.2), (0.5, np.arctan(0.3))])
def test_a_ring_that_hangs_on_a_tilted_wire_slips_down_to_the_friction_angle(start, end):
    """Ring a stands in the plane y = 0 and is held; ring b hangs on its wire, `start` rad beside the lowest point. Its
    weight is vertical, so it rests where the normal of the contact leans no more than atan(mu)."""
    friction, wire, h = 0.3, 0.1, 0.05
    n_a, n_b = np.array([[0.0, 1.0, 0.0]]), np.array([[1.0, 0.0, 0.0]])
    u = np.array([-np.sin(start), 0.0, np.cos(start)])
    d = (-u + 2.0 * wire * u - [0.0, 0.0, 1.0])[None]
    corners = 2.0 * np.pi * np.arange(64) / 64
    polygon = friction * np.stack([np.cos(corners), np.sin(corners)], axis=1)
    A, weight = np.eye(6) / h, np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
    b_only = np.r_[0:3, 6:9]
    for _ in range(500):
        found = local_minima(d, n_a, n_b, reach=0.4)
        slip = slip_gradient(found, n_a[found.pair], wire, wire)[..., b_only]
        cone = distance_gradient(found)[:, None, b_only] + np.einsum("jx,cxm->cjm", polygon, slip)
        gap = found.distance[None] - 2.0 * wire
        w, _, is_solved = solve_contact_step(A[None], weight[None], cone[None], gap, np.full_like(gap, 1e5))
        assert is_solved.all()
        d, n_b = d + w[:, :3], Rotation.from_rotvec(w[0, 3:]).apply(n_b)
    u = local_minima(d, n_a, n_b, reach=0.4).normal[0]
    assert np.arccos(u[2]) == pytest.approx(end, abs=0.012)
    assert np.abs(w).max() < 1e-4


@pytest.fixture(scope="module")
def held():
    return simulate(Cell(), ([0.0, 20.0, 30.0], [45.0, 30.0, 60.0]), ROUGH)


def test_what_friction_takes_never_falls_and_the_energy_does(held):
    assert (held.status == "converged").all()
    assert held.history.rise.max() <= ROUND_OFF
    for case in range(3):
        assert np.diff(held.history.lost[held.history.case == case], prepend=0.0).min() > -1e-12
    assert held.rest.lost.min() > 0.01


def test_forces_within_the_cones_balance_the_load_at_rest_but_none_along_the_normals_do(held):
    """Nonnegative least squares over 64 directions of friction, spins of rings included: another way to the forces."""
    dynamics = Dynamics.of(Cell(), replace(ROUGH, directions=64))
    T = dynamics.velocities(held.rest.pose)
    con = held.rest.contacts
    G, _ = dynamics.equations.gap_derivatives(held.rest.pose, con, T, held.rest.lam)
    slip = dynamics.slip(held.rest.pose, con, T)
    load = np.einsum("nx,nxm->nm", lattice_load(held.rest.pose, held.rest.s)[0], T[:, :4])
    touches = (con.present & (con.gap < 1e-4)).reshape(3, -1)
    for i in range(3):
        cone = G[i, touches[i], None] + np.einsum("jx,cxm->cjm", dynamics.polygon(), slip[i, touches[i]])
        size = np.linalg.norm(load[i])
        assert nnls(cone.reshape(-1, T.shape[2]).T, -load[i])[1] < 1e-5 * size
        assert nnls(G[i, touches[i]].T, -load[i])[1] > 1e-2 * size


@pytest.mark.slow
def test_friction_holds_strain_back_and_with_less_of_it_less(held):
    """S:E of what a load reaches falls with friction, in proportion where there is little, to today's answer at 0."""
    free = simulate(Cell(), ([0.0], [45.0]))
    few = [simulate(Cell(), ([0.0], [45.0]), replace(ROUGH, friction=mu, directions=8)) for mu in (1e-3, 1e-6)]
    away = [float(np.abs(run.E[0] - free.E[0]).max()) for run in (held, *few)]
    assert away[0] > 0.05
    assert away[1] < 0.03 * away[0]
    assert away[2] < 1e-5


def test_a_mesh_goes_on_where_its_load_turns_on_and_stays_where_it_turns_back():
    stages = np.array([[45.0, 50.0, 45.0]])
    found, smooth = (simulate(Cell(), (0.0 * stages, stages), replace(ROUGH, friction=mu)) for mu in (0.1, 0.0))
    (on, back), (free_on, free_back) = (np.diff(run.strain(run.lattice)[0], axis=0) for run in (found, smooth))
    assert np.abs(on).max() > 0.01
    assert np.abs(back).max() < 1e-6
    assert free_on == pytest.approx(-free_back, abs=1e-5)
    assert np.abs(free_back).max() > 0.01


@pytest.mark.slow
def test_the_area_of_a_loop_is_what_friction_takes():
    """The closed integral of S:dE by trapezoids, and forces times slips: to the steps of the load."""
    loop = friction_loop(Cell(), (0.0, 30.0), (0.0, 60.0), replace(ROUGH, tolerance=1e-5))
    assert loop.lost > 0.03
    assert loop.area == pytest.approx(loop.lost, rel=0.02)
    assert loop.E[0] == pytest.approx(loop.E[-1], abs=1e-4)  # the cycle closes
    assert loop.band[0] > 0.1
    assert loop.band == pytest.approx(np.abs(loop.E - loop.E[::-1]).max(axis=0))
    amplitude = 0.25 * (loop.S[0] - loop.S[12]) * (loop.E[0] - loop.E[12]) @ [1.0, 2.0, 1.0]
    assert loop.damping_ratio == pytest.approx(loop.lost / (2.0 * np.pi * amplitude))
    assert loop.record()["friction_N_per_mm"] == pytest.approx(2.5e-3 * loop.lost)
    finer = friction_loop(Cell(), (0.0, 30.0), (0.0, 60.0), replace(ROUGH, tolerance=1e-5), increments=24)
    assert finer.lost == pytest.approx(loop.lost, rel=0.02)


def test_a_load_that_turns_too_little_moves_nothing():
    loop = friction_loop(Cell(), (0.0, 45.0), (0.0, 46.0), replace(ROUGH, friction=0.3, directions=8), increments=1)
    assert "do not move" in str(loop)
    assert np.isnan(loop.damping_ratio)
    with pytest.raises(InputError, match="friction"):
        replace(ROUGH, friction=-0.1)
