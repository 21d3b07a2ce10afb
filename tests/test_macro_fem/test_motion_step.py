"""One implicit step of a curtain: momentum, the energy account, rest, free fall, and the matrix of loose bodies."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy import sparse

from macro_fem import read_scene
from macro_fem.curtain import CurtainProblem
from macro_fem.fem import SupportedFem, load_vector, with_loose_nodes
from macro_fem.motion import Account, Moment, TimeStep, end_of, kinetic_energy, solve_step
from macro_fem.solvers import WARM, Inertia, WallRows, Walls, green_strain
from tests.test_macro_fem.sheets import posed, sheet

BALL = 0.5e-3
"""Mass in N s2/mm of the ball: 0.5 kg."""


def free_sheet(cells: int = 5, side: float = 300.0, *, balls: int = 0, elastic: bool = False):
    """A square sheet that nothing holds, with balls of 0.5 kg: its problem, discretisation and masses, and its nodes in
    the reference state (n, 3)."""
    scene = read_scene(sheet(side, side, cells, {"kind": "top"}, solver={"kind": "elastic"} if elastic else {}))
    problem = posed(scene)
    disc = problem.disc
    n = disc.n_nodes
    fem = with_loose_nodes(SupportedFem(disc, np.zeros((n, 3)), np.ones(3 * n, bool)), balls)
    mass = 1e-9 * problem.law.cell.areal_mass_kg_per_m2 * load_vector(disc, np.array([1.0]))[:, 0]
    mass = np.append(mass, np.full(balls, BALL))
    return Moving(problem, fem, mass), np.column_stack([disc.nodes, np.zeros(n)])


class Moving(NamedTuple):
    """A curtain that moves: its problem, its discretisation with balls, and masses (n,) in N s2/mm."""

    problem: CurtainProblem
    fem: SupportedFem
    mass: np.ndarray


def untouched(x: np.ndarray) -> Walls:
    return Walls.none(x.shape)


def advance(moving: Moving, moments: list[Moment], forces: Sequence[Any], h: float, accounts, tangents=untouched):
    """The next moment and account, appended; the end of the step."""
    problem, fem, mass = moving
    now, before = moments[-1], moments[-2] if len(moments) > 1 else None
    step = TimeStep(now, before, h, mass, *forces)
    result, walls = solve_step(problem, fem, step, (None, None), tangents)
    assert result.status == "converged", result.message
    end = end_of(problem, fem, step, result, walls)
    touched = 0.0
    if len(walls):
        n = len(now.x) - 1
        touched = float(result.wall_forces @ (np.linalg.norm(now.x[:n] - now.x[n], axis=1) - walls.offset))
    told = step.finish(accounts[-1], replace(end, touched=touched))
    accounts.append(told.account)
    moments.append(told.moment)
    return end


def balance(account: Account) -> float:
    """Energies plus losses minus work, N mm: constant as far as the steps are solved."""
    return sum(vars(account).values()) - 2.0 * account.work


def ball_tangents(n: int, radius: float):
    """Half-spaces of a ball of this radius, the last of n + 1 nodes, at all n others."""

    def tangents(x: np.ndarray) -> Walls:
        away = x[:n] - x[n]
        normal = away / np.linalg.norm(away, axis=1)[:, None]
        at = sparse.hstack([sparse.eye(n), np.full((n, 1), -1.0)], format="csr")
        return Walls(at, normal, np.full(n, radius), np.zeros(n, int))

    return tangents


@pytest.mark.slow
@pytest.mark.parametrize("elastic", [False, True], ids=["rigid", "elastic"])
def test_a_thrown_ball_and_a_free_sheet_keep_momentum_and_close_the_account(elastic):
    moving, X = free_sheet(balls=1, elastic=elastic)
    x = np.vstack([X, [140.0, 170.0, 41.0]])
    v = np.zeros_like(x)
    v[-1] = [200.0, 0.0, -3000.0]
    nothing = np.zeros_like(x), np.zeros_like(x)
    moments, accounts = [Moment(0.0, x, v)], [Account(kinetic=kinetic_energy(moving.mass, v))]
    p = moving.mass @ v
    for _ in range(4):
        end = advance(moving, moments, nothing, 4e-3, accounts, ball_tangents(len(X), 40.0))
        now = moments[-1]
        assert np.abs(moving.mass @ now.v - p).max() < 1e-10 * np.abs(p).max()
        assert abs(balance(accounts[-1]) / balance(accounts[0]) - 1.0) < 1e-8
        assert np.linalg.norm(now.x[:-1] - now.x[-1], axis=1).min() > 40.0 - 1e-6
        assert accounts[-1].lost_by_locking >= accounts[-2].lost_by_locking - 1e-8 * accounts[0].kinetic
        assert end.pushes[:-1].sum(axis=0) == pytest.approx(-end.pushes[-1], abs=1e-12 * np.abs(end.pushes).sum())
    assert moments[-1].v[-1, 2] > -2950.0  # the sheet has slowed it down


def angular_momenta(
    moving: Moving, x: np.ndarray, v: np.ndarray, h: float, *, tangents=untouched, euler=False
) -> np.ndarray:
    """Angular momenta (steps + 1, 3) about the origin over 48 ms in which nothing acts."""
    nothing = np.zeros_like(x), np.zeros_like(x)
    moments, accounts = [Moment(0.0, x, v)], [Account(kinetic=kinetic_energy(moving.mass, v))]
    for _ in range(round(0.048 / h)):
        known = moments[-1:] if euler else moments[-2:]
        advance(moving, known, nothing, h, accounts, tangents)
        moments.append(known[-1])
        assert not euler or accounts[-1].kinetic <= accounts[-2].kinetic + 1e-9 * accounts[0].kinetic
    return np.array([(moving.mass[:, None] * np.cross(one.x, one.v)).sum(axis=0) for one in moments])


@pytest.mark.slow
def test_angular_momentum_of_a_tumbling_sheet_is_kept_to_second_order():
    moving, X = free_sheet(3)
    x = X - (moving.mass @ X) / moving.mass.sum()
    v = np.cross([8.0, 5.0, 0.0], x)
    v[:, 2] += 300.0 * np.cos(2.0 * np.pi * x[:, 0] / 300.0)
    errors = []
    for h in (4e-3, 2e-3, 1e-3):
        kept = angular_momenta(moving, x, v, h)
        errors.append(np.abs(kept - kept[0]).max() / np.abs(kept[0]).max())
    assert errors[0] / errors[1] > 3.0
    assert errors[1] / errors[2] > 3.0
    assert errors[2] < 5e-4


@pytest.mark.slow
def test_angular_momentum_through_the_impact_of_a_ball_is_kept_to_first_order_and_energy_only_falls():
    moving, X = free_sheet(balls=1)
    x = np.vstack([X, [140.0, 170.0, 41.0]])
    x = x - (moving.mass @ x) / moving.mass.sum()
    v = np.zeros_like(x)
    v[-1] = [200.0, 0.0, -3000.0]
    errors = []
    for h in (4e-3, 2e-3):
        kept = angular_momenta(moving, x, v, h, tangents=ball_tangents(len(X), 40.0), euler=True)
        errors.append(np.abs(kept - kept[0]).max() / np.abs(kept[0]).max())
    assert errors[0] / errors[1] > 1.7
    assert errors[1] < 0.03


@pytest.mark.parametrize("speed", [0.0, 1000.0])
def test_damping_takes_what_its_formula_says_and_rest_stays_rest(speed):
    moving, X = free_sheet()
    v = np.tile([0.0, 0.0, speed], (len(X), 1))
    damped = np.zeros_like(X), np.zeros_like(X), None, 4.0
    moments, accounts = [Moment(0.0, 0.9 * X, v)], [Account(kinetic=kinetic_energy(moving.mass, v))]
    for _ in range(20):
        advance(moving, moments, damped, 5e-3, accounts)
    assert speed or np.abs(moments[-1].x - 0.9 * X).max() < 1e-9
    assert moments[-1].v[:, 2] == pytest.approx(speed * np.exp(-4.0 * 0.1), rel=2e-3)
    assert balance(accounts[-1]) == pytest.approx(balance(accounts[0]), rel=1e-8)
    assert accounts[-1].lost_by_damping == pytest.approx(accounts[0].kinetic * (1.0 - np.exp(-8.0 * 0.1)), rel=2e-2)


@pytest.mark.parametrize("is_tied", [False, True])
def test_matrix_of_loose_nodes_is_that_of_dense_algebra(is_tied):
    rng = np.random.default_rng(3)
    moving, X = free_sheet(cells=2)
    fem = replace(moving.fem, tie=moving.fem.T) if is_tied else moving.fem
    loose = with_loose_nodes(fem, 2)
    n, m = len(X), 5
    node = np.column_stack([rng.integers(0, n, m), n + rng.integers(0, 2, m)])
    at = sparse.csr_matrix((np.tile([1.0, -1.0], m), node.ravel(), 2 * np.arange(m + 1)), shape=(m, n + 2))
    walls = Walls(at, rng.normal(size=(m, 3)), np.zeros(m), np.zeros(m, int))
    rows, W = WallRows(loose, walls, 1.0), rng.normal(size=(n + 2, 3, 3))
    W = W @ W.transpose(0, 2, 1)
    inertia = Inertia(loose, W, rng.normal(size=(n + 2, 3)))
    weight = rng.uniform(0.1, 1.0, m)
    tangent = np.tile(np.eye(6).reshape(3, 2, 3, 2), (len(loose.disc.weight), 1, 1, 1, 1))
    solve = loose.factorize(tangent, rows.added(weight) + inertia.matrix)
    A = np.stack([rows.slack(e) - rows.slack(0.0 * e) for e in np.eye(loose.n)], axis=1)
    B = np.stack([loose.gradient_change(e).ravel() for e in np.eye(loose.n)], axis=1)
    K = B.T @ (np.repeat(loose.disc.weight, 6)[:, None] * B) + A.T @ ((rows.v * weight)[:, None] * A)
    K = K + sparse.block_diag(list(W)).toarray()
    b = rng.normal(size=loose.n)
    assert K @ solve(b) == pytest.approx(b, abs=1e-9)
    assert inertia.deficit(b) == pytest.approx(0.5 * b @ np.linalg.solve(sparse.block_diag(list(W)).toarray(), b))


@pytest.mark.parametrize("elastic", [False, True], ids=["rigid", "elastic"])
def test_steps_from_multipliers_are_those_in_cones_with_overlapping_bounds(elastic, monkeypatch):
    """A ball strikes a sheet that spins: the slack path needs no cones, and no more iterations from multipliers."""
    moving, X = free_sheet(3, balls=1, elastic=elastic)
    x = np.vstack([X, [140.0, 170.0, 41.0]])
    v = np.cross([0.0, 0.0, 6.0], x - x.mean(axis=0))
    v[-1] = [200.0, 0.0, -3000.0]
    step = TimeStep(Moment(0.0, x, v), None, 4e-3, moving.mass, np.zeros_like(x), np.zeros_like(x))

    def solve(known):
        return solve_step(moving.problem, moving.fem, step, known, ball_tangents(len(X), 40.0))[0]

    with monkeypatch.context() as patch:
        patch.setattr("macro_fem.solvers.warm_path.solve_path", None)
        cold = solve((None, None))
        warm = solve((cold.cones, cold.lam))
    monkeypatch.setattr("macro_fem.solvers.warm_path.WARM", replace(WARM, most_steps=0))
    in_cones = solve((None, None))
    assert warm.iterations <= cold.iterations
    scale, largest = kinetic_energy(moving.mass, v), np.abs(in_cones.P).max()
    for one in (cold, warm):
        assert one.status == in_cones.status == "converged"
        assert one.dual <= in_cones.primal + 1e-8 * scale
        assert in_cones.dual <= one.primal + 1e-8 * scale
        assert moving.fem.positions(one.z) == pytest.approx(moving.fem.positions(in_cones.z), abs=1e-3)
        assert moving.fem.force(one.P - in_cones.P) == pytest.approx(0.0, abs=1e-3 * largest * 300.0)


def test_an_answer_of_a_step_has_a_gap_and_no_better_neighbour():
    rng = np.random.default_rng(5)
    moving, X = free_sheet(cells=3)
    v = rng.normal(scale=2000.0, size=X.shape)
    step = TimeStep(Moment(0.0, X, v), None, 0.02, moving.mass, np.zeros_like(X), np.zeros_like(X))
    result, _ = solve_step(moving.problem, moving.fem, step, (None, None), untouched)
    end = moving.fem.positions(result.z)
    assert 0.0 <= result.evidence.gap < 1e-8

    def value(x):
        return 0.5 * float((moving.mass[:, None] * (x - step.x_hat) ** 2).sum()) / step.differences[0] ** 2

    better = 0
    for _ in range(200):
        x = end + rng.uniform(0.0, 1.0) * (X * rng.uniform(0.5, 1.0) - end)
        x = x + rng.normal(scale=3.0, size=x.shape)
        E = green_strain(moving.fem.gradient(moving.fem.unknowns(x)))
        better += bool(moving.problem.law.cut(E).violation.max() <= 0.0 and value(x) < value(end))
    assert not better
