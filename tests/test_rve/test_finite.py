"""Finite meshes: layout, contacts, derivatives, equilibria with known answers."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import minimize

from benchmarks.every_ring.cell import edge_loaded
from rve import WEAVES, Cell, FiniteMesh, InputError
from rve.common import Factorizer
from rve.finite import FiniteOptions, HalfSpace, cell_of_sides
from rve.finite.contacts import (
    MeshPose,
    find_mesh_contacts,
    is_passage_safe,
    links_intact,
    make_fixed_points,
    track_gaps,
    transfer_forces,
    travel_bounds,
)
from rve.finite.newton import METRIC, NewtonSystem, blocks, forces_that_stop, gradients, negative_part, rows_of, spread
from rve.finite.problem import Iterate, Problem, ScaledProblem
from rve.finite.solution import SolverResult, as_solution
from rve.finite.solve import solve_rings
from rve.finite.walls import wall_derivatives, wall_gaps
from rve.geometry import local_minima, tangent_frame
from rve.placed.drawn import ALONG

G = 9.81


def hung(mesh, top):
    """Weight, held coordinates and places of a mesh whose rings `top` are held where they are."""
    n = len(mesh.X)
    force = np.zeros((n, 3))
    force[:, 1] = -G * mesh.mass
    held = np.zeros((n, 3), dtype=bool)
    held[top] = True
    return force, held, np.column_stack([mesh.X, np.zeros(n)])


def top_of(mesh):
    return np.isclose(mesh.X[:, 1], mesh.X[:, 1].max())


def check(solution):
    assert solution.status == "converged"
    assert solution.contacts.links_intact
    assert solution.contacts.min_gap_mm >= -1e-9
    assert solution.kkt_residual <= 1e-8


def test_a_rectangle_of_whole_cells_has_rings_on_its_corners_and_the_weight_of_its_area():
    cell = Cell()
    mesh = FiniteMesh.rectangle(cell, 3, 2)
    b_x, b_y = mesh.sides
    assert len(mesh.X) == 4 * 3 + 3 * 2
    for corner in ((0.0, 0.0), (3 * b_x, 0.0), (3 * b_x, 2 * b_y), (0.0, 2 * b_y)):
        ring = np.linalg.norm(mesh.X - corner, axis=1).argmin()
        assert np.allclose(mesh.X[ring], corner, atol=1e-9)
        assert mesh.area[ring] == pytest.approx(0.25 * b_x * b_y / 2)
    assert mesh.mass.sum() == pytest.approx(cell.ring_mass * 2 * 3 * 2)
    assert len(mesh.linked) == 4 * 3 * 2


def test_any_outline_keeps_its_area_and_leaves_out_holes():
    outline = [(0.0, 0.0), (120.0, 10.0), (90.0, 100.0), (5.0, 80.0)]
    hole = [(40.0, 40.0), (60.0, 40.0), (60.0, 60.0), (40.0, 60.0)]
    whole, holed = FiniteMesh.inside(Cell(), outline), FiniteMesh.inside(Cell(), outline, [hole], 30.0)
    x, y = np.array(outline).T
    area = 0.5 * abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
    assert whole.area.sum() == pytest.approx(area)
    assert holed.area.sum() == pytest.approx(area - 400.0)
    assert not ((np.abs(holed.X - 50.0) < 9.9).all(axis=1)).any()


def test_the_slack_start_has_gaps_and_the_links_of_the_weave():
    mesh = FiniteMesh.rectangle(Cell(), 4, 3)
    centre, normal = mesh.slack()
    pose = MeshPose(centre / 5.0, normal)
    con = find_mesh_contacts(pose, mesh.linked, 0.1, 0.6)
    assert con.deepest.min() > 0.25
    assert links_intact(con, mesh.linked[:, 0] * len(mesh.X) + mesh.linked[:, 1])
    assert not links_intact(con, mesh.linked[1:, 0] * len(mesh.X) + mesh.linked[1:, 1])


@pytest.mark.parametrize("small", [1.0, 0.5])
def test_a_taut_pair_turns_freely_until_its_contact_splits(small):
    """About the line of the pull, as far as cos^2 = (1 - D)(1 - D / r): nothing turns a joining ring back before."""
    apart = 0.2
    limit = np.arccos(np.sqrt((1.0 - apart) * (1.0 - apart / small)))
    for angle, count in ((0.5 * np.pi, 1), (limit + 0.01, 1), (limit - 0.01, 2)):
        d, a = np.array([[1.0 - apart + small, 0.0, 0.0]]), np.array([[0.0, 0.0, 1.0]])
        b = np.array([[0.0, -np.sin(angle), np.cos(angle)]])
        minima = local_minima(d, a, b, (np.ones(1), np.full(1, small)), reach=np.full(1, 1.02 * apart))
        assert len(minima.distance) == count
        assert (minima.distance == pytest.approx(apart, abs=1e-12)) == (count == 1)


def disturbed(seed, size=0.05, weave="4-in-1"):
    """A small mesh near its slack pose in space."""
    mesh = FiniteMesh.rectangle(Cell(weave=weave), 2, 2)
    centre, normal = mesh.slack()
    radii, wires = mesh.sizes
    rng = np.random.default_rng(seed)
    q = size * rng.uniform(-1.0, 1.0, (len(mesh.X), 5))
    return mesh, MeshPose(centre / 5.0, normal, radii=radii, wires=wires).moved(q), rng


@pytest.mark.parametrize("weave", ["4-in-1", "japanese-4-in-1"])
def test_gradients_and_newton_matrix_are_those_of_differences(weave):
    mesh, pose, rng = disturbed(1, weave=weave)
    n = len(mesh.X)
    q = rng.standard_normal((n, 5))
    step = 1e-5

    def at(t):
        con = find_mesh_contacts(pose.moved(t * q), mesh.linked, 0.1, 0.6)
        return con, con.gap

    con, gap = at(0.0)
    (fore, g1), (aft, g2) = at(step), at(-step)
    # near a merge of two minima the third derivative has no bound
    same = ~con.fixed & (con.minima.curvature > 0.2)
    assert same.sum() > 30
    assert (fore.key == con.key).all()
    assert (fore.count == con.count).all()
    jac = gradients(con)
    unit = np.broadcast_to(np.eye(7), (len(gap), 7, 7))
    moved = (rows_of(con, con.minima.pair, unit) @ q.ravel()).reshape(-1, 7)
    rate = rows_of(con, con.minima.pair, jac[:, None]) @ q.ravel()
    assert np.allclose(rate, (jac * moved).sum(axis=1))
    assert np.abs(rate - (g1 - g2) / (2 * step))[same].max() < 1e-6
    assert (fore.count == aft.count).all()
    for row in np.flatnonzero(same)[::7]:
        force = np.zeros(len(gap))
        force[row] = 1.0
        K = blocks(con, jac, np.zeros(len(gap)), force)
        v = moved[row]
        second = (g1[row] - 2 * gap[row] + g2[row]) / step**2
        assert v @ -K[con.minima.pair[row]] @ v == pytest.approx(second, abs=1e-3 * (1.0 + abs(second)))


def taut_pair(angle, gap, wide=True, lean=0.0, reach=0.3):
    """A joining ring of half the radius that hangs on a flat one, turned about the line of the pull."""
    x, lean = np.array([[0.0, 0, 0], [1.0 - 0.2 - gap + 0.5, 0, 0]]), np.array([0.0, 0.0, 0.0, lean, 0.0])
    normal = np.array([[0.0, 0.0, 1.0], [0.0, -np.sin(angle), np.cos(angle)]])
    pose = MeshPose(x, normal, radii=np.array([1.0, 0.5]), wires=np.ones(2)).moved(np.stack([0.0 * lean, lean]))
    links, none = np.array([[0, 1]]), np.zeros(0, int)
    return find_mesh_contacts(pose, links, 0.1, reach, guard_points=False, wide=none if wide else None)


def test_a_wide_contact_beyond_the_reach_has_no_force():
    """Its mean gap may be where its least one is not; a negative force would stop those of all contacts in a step."""
    within, beyond = taut_pair(0.9, 0.05), taut_pair(0.9, 0.05, reach=0.055)
    assert beyond.deepest[0] < beyond.reach < within.gap[0] == beyond.wide.mean(beyond.wide.gap)[0]
    assert beyond.gap[0] == beyond.reach
    assert beyond.central_forces(1.0)[0] < 1e-6 < within.central_forces(1.0)[0]


def test_the_gap_of_a_wide_contact_is_smooth_where_its_minimum_splits():
    """Beside the two minima, which are there only below the angle of the closed form above."""
    gap = 1e-3
    limit = np.arccos(np.sqrt((0.8 - gap) * (0.6 - 2.0 * gap)))
    angles = limit + np.linspace(-0.012, 0.012, 9)
    assert [len(taut_pair(angle, gap, wide=False).gap) for angle in angles[[0, -1]]] == [2, 1]
    pairs = [taut_pair(angle, gap) for angle in angles]
    assert all(len(con.gap) == con.is_wide.sum() == 1 for con in pairs)
    gaps = np.array([con.gap[0] for con in pairs])
    assert np.abs(np.diff(gaps, 3)).max() < 0.02 * np.ptp(gaps)
    for con in pairs:
        shares = con.wide.shares(con.gap)
        assert shares @ con.wide.gap == pytest.approx(con.gap[0])  # force times gap is that of the whole contact
        assert con.whole == pytest.approx(shares.sum())
        assert con.wide.gap.min() == pytest.approx(con.deepest[0], rel=5e-2)
    near, far = (taut_pair(limit, gap, lean=lean) for lean in (1e-4, 2e-4))
    assert track_gaps(near, far.pose) == pytest.approx(far.gap, rel=1e-4)  # other points, the same integral


@pytest.mark.parametrize("weave", ["japanese-4-in-1", "kings-4-in-1"])
def test_gradients_and_curvatures_of_wide_contacts_are_those_of_differences(weave):
    mesh, pose, rng = disturbed(1, weave=weave)
    q, step = rng.standard_normal((len(mesh.X), 5)), 1e-5
    con = find_mesh_contacts(pose, mesh.linked, 0.1, 0.6, guard_points=False, wide=np.zeros(0, int))
    rows = con.wide.rows
    assert len(rows) > 3
    fore, aft = (track_gaps(con, pose.moved(t * q)) for t in (step, -step))
    jac = gradients(con)
    unit = np.broadcast_to(np.eye(7), (len(con.key), 7, 7))
    moved = (rows_of(con, np.arange(len(con.key)), unit) @ q.ravel()).reshape(-1, 7)[con.minima.pair[rows]]
    rate = (jac[rows] * moved).sum(axis=1)
    assert rate == pytest.approx(((fore - aft) / (2 * step))[rows], rel=1e-4, abs=1e-4 * np.abs(rate).max())
    K = blocks(con, jac, np.zeros(len(con.gap)), con.is_wide.astype(float))[con.minima.pair[rows]]
    second = ((fore + aft - 2 * con.gap) / step**2)[rows]
    assert np.einsum("ri,rij,rj->r", moved, -K, moved) == pytest.approx(
        second, rel=1e-3, abs=1e-3 * np.abs(second).max()
    )


@pytest.mark.slow
@pytest.mark.parametrize(("weave", "columns", "rows"), [("japanese-4-in-1", 3, 2), ("kings-4-in-1", 2, 2)])
def test_joining_rings_that_turn_until_their_contact_splits_come_to_rest(weave, columns, rows):
    """Hung by two corners in space: balanced by contacts that push, at points where wires touch."""
    mesh = FiniteMesh.rectangle(Cell(weave=weave), columns, rows)
    corners = top_of(mesh) & np.isin(mesh.X[:, 0], [mesh.X[top_of(mesh), 0].min(), mesh.X[top_of(mesh), 0].max()])
    force, held, at = hung(mesh, corners)
    at[corners, 0] = at[corners, 0].mean() + 0.9 * (at[corners, 0] - at[corners, 0].mean())
    rings = mesh.solve(force, held, at, options=FiniteOptions(max_iterations=200, starts=1))
    assert rings.status == "converged"
    assert rings.kkt_residual < 1e-8
    pairs, push = rings.contacts.pairs, rings.contacts.force[:, None] * rings.contacts.normal
    total = force + rings.reaction
    np.add.at(total, pairs[:, 0], -push)
    np.add.at(total, pairs[:, 1], push)
    assert np.abs(total).max() < 1e-7 * np.abs(force).sum()
    assert rings.contacts.force.min() >= 0.0
    assert rings.contacts.gap @ rings.contacts.force < 1e-6 * np.abs(force).sum() * 5.0
    assert rings.contacts.links_intact
    assert 0.0 < rings.contacts.min_gap_mm < 1e-6
    whole, size = rings.contacts.whole  # a contact that is spread over points counts once
    counts = np.unique(whole, axis=0, return_counts=True)[1]
    assert counts.max() <= 2 < np.unique(pairs, axis=0, return_counts=True)[1].max()
    assert size.sum() <= rings.contacts.force.sum() * (1.0 + 1e-12)
    for a, b in whole[size > 1e-6 * size.max()]:  # the sum of what its points push, whatever their number
        here = (pairs == [a, b]).all(axis=1)
        both = size[(whole == [a, b]).all(axis=1)]
        assert both.max() <= np.linalg.norm(push[here], axis=1).sum() * (1.0 + 1e-12)
        assert len(both) > 1 or both[0] == pytest.approx(np.linalg.norm(push[here].sum(axis=0)))


def some_iteration():
    """An iteration in which some coordinates are free and no contact has a force, and its matrix by sums over pairs."""
    mesh, pose, rng = disturbed(2)
    con = find_mesh_contacts(pose, mesh.linked, 0.1, 0.6)
    (n, m, p), none = (len(mesh.X), len(con.gap), len(con.key)), np.zeros((len(mesh.X), 3))
    free = rng.uniform(size=(n, 5)) > 0.2
    motions = sparse.identity(5 * n, format="csr")[:, np.flatnonzero(free)]
    problem, mu = (
        ScaledProblem(mesh.linked, 0.1, rng.standard_normal((n, 3)), none > 0.0, none, motions),
        np.full(n, 0.01),
    )
    zero = np.zeros(p), np.zeros(p), np.zeros(m), np.zeros(n), np.zeros(n), np.ones(n)
    now = NewtonSystem(Iterate(con, np.zeros(m), mu, 0.02, *zero), problem, gradients(con), Factorizer("superlu"))
    whole = np.zeros((p, 7, n, 5))
    for pair, (a, b) in enumerate(zip(con.a, con.b, strict=True)):
        whole[pair, [0, 1, 2], a, [0, 1, 2]] = -1.0
        whole[pair, [0, 1, 2], b, [0, 1, 2]] = 1.0
        whole[pair, [3, 4], a, [3, 4]] = whole[pair, [5, 6], b, [3, 4]] = 1.0
    whole = whole.reshape(p, 7, 5 * n)
    jac = np.einsum("mk,mkx->mx", gradients(con), whole[con.minima.pair])

    def matrix():
        iterate, linked = now.iterate, np.isin(con.key, problem.keys)
        damping = 1e-3 * linked * (iterate.damping + iterate.local)
        found = jac.T @ ((0.01 / con.reach / con.gap + iterate.extra)[:, None] * jac)
        found += np.einsum("p,k,pkx,pky->xy", damping, METRIC, whole, whole)
        found += (1e-10 + 1e-6 * iterate.damping) * np.eye(5 * n)
        return found[np.ix_(free.ravel(), free.ravel())]

    return now, matrix, jac, motions, rng


def test_matrix_and_products_are_sums_over_pairs():
    now, matrix, jac, motions, rng = some_iteration()
    force, x = rng.uniform(size=len(jac)), rng.standard_normal(motions.shape[1])
    step = now.step()
    assert np.allclose(matrix() @ step.solve(x), x)
    assert np.allclose(spread(now.con, gradients(now.con), force).ravel(), jac.T @ force)
    assert np.allclose(matrix() @ (motions.T @ now.answer(step, force).ravel()), motions.T @ (jac.T @ force))
    assert np.allclose(matrix() @ (motions.T @ step.q.ravel()), now.push)
    assert np.allclose(step.dgap, jac @ step.q.ravel())
    assert not step.q.ravel()[np.diff(motions.indptr) == 0].any()
    mesh = FiniteMesh.rectangle(Cell(), 24, 24)  # more pairs than are summed at once
    con = find_mesh_contacts(MeshPose(mesh.slack()[0] / 5.0, mesh.slack()[1]), mesh.linked, 0.1, 0.6)
    G, stiff, sums = gradients(con), rng.uniform(size=len(con.gap)), np.zeros((len(con.key), 7, 7))
    np.add.at(sums, con.minima.pair, stiff[:, None, None] * G[:, :, None] * G[:, None, :])
    assert np.allclose(blocks(con, G, stiff, 0.0 * stiff), sums)


def test_a_factor_serves_for_stiffer_contacts_and_pairs():
    now, matrix, jac, motions, rng = some_iteration()
    now.step()
    factors, x = now.factors, rng.standard_normal(motions.shape[1])
    tight = np.flatnonzero(np.isin(now.con.key, now.problem.keys))[:2]
    factor, solved = now._factor, []
    now._factor = lambda push: (push.ndim == 2 and solved.append(push.shape[1])) or factor(push)
    for count in (0, 4, 2):
        extra, local = now.iterate.extra.copy(), now.iterate.local.copy()
        extra[rng.choice(len(jac), count, replace=False)] += rng.uniform(1.0, 90.0, count)
        local[tight[: count // 2]] += 5.0
        now.iterate = replace(now.iterate, extra=extra, local=local)
        assert np.allclose(matrix() @ now.step().solve(x), x)
    assert now.factors == factors
    assert sum(solved) == len(now._solutions) > 0  # each row once


def test_forces_that_stop_are_those_of_a_complementarity_problem():
    rng = np.random.default_rng(5)
    for k in (1, 3, 9):
        R = rng.standard_normal((k, k)) * 10.0 ** rng.uniform(-4, 4, k)
        S, missing = R.T @ R, (R.T @ R) @ rng.standard_normal(k)
        force = forces_that_stop(S, missing)
        left = (S @ force - missing) / np.sqrt(np.diag(S))
        size = np.abs(missing / np.sqrt(np.diag(S))).max()
        assert (force >= 0.0).all()
        assert left.min() > -1e-6 * size
        assert np.abs(force * np.sqrt(np.diag(S)) * left).max() < 1e-6 * size**2
    same = forces_that_stop(2.0 + 2e-15 * np.eye(3), np.array([3.0, 3.0, -1.0]))  # contacts that are the same
    assert (same >= 0.0).all()
    assert same.sum() == pytest.approx(1.5, rel=1e-5)


def crossing_pairs(seed, size):
    """Two rings, 200 times, and steps (2, 5) on whose middle their circles cross."""
    rng = np.random.default_rng(seed)
    for _ in range(200):
        normal = rng.standard_normal((2, 3))
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        e1, e2 = tangent_frame(normal)
        t = rng.uniform(0.0, 2.0 * np.pi, (2, 1))
        middle = MeshPose(-(np.cos(t) * e1 + np.sin(t) * e2), normal)  # both circles pass through the origin
        q = size * rng.uniform(-1.0, 1.0, (2, 5))
        omega = q[:, 3:4] * e1 + q[:, 4:] * e2
        before = middle.moved(-0.5 * q)
        f1, f2 = tangent_frame(before.normal)
        yield before, np.column_stack([q[:, :3], (omega * f1).sum(axis=1), (omega * f2).sum(axis=1)])


@pytest.mark.slow
def test_circles_that_cross_on_the_way_have_ways_as_long_as_their_distances():
    pair = np.array([[0, 1]])
    ratio = []
    for size in (0.02, 0.3, 1.0):
        for before, q in crossing_pairs(6, size):
            old, new = (
                find_mesh_contacts(pose, pair, 0.0, 9.0, guard_points=False) for pose in (before, before.moved(q))
            )
            ratio.append((old.deepest[0] + new.deepest[0]) / travel_bounds(old, q)[0])
    assert max(ratio) <= 1.0
    assert max(ratio) > 0.5  # the bound is no mere multiple of the way


def test_what_blocks_lack_takes_their_negative_curvature_and_nothing_else():
    rng = np.random.default_rng(4)
    root = rng.standard_normal((3, 7, 4))
    pairs = np.matmul(root, root.transpose(0, 2, 1)) - np.array([0.0, 0.5, 2.0])[:, None, None] * np.eye(7)
    pairs = np.concatenate([pairs, np.zeros((1, 7, 7))])
    found = negative_part(pairs)
    assert not found[3].any()
    assert np.abs(found[0]).max() < 1e-12
    # in the ten unknowns of both rings it is the projection of the block on the negative semidefinite matrices
    T = np.zeros((7, 10))
    T[:3, :3], T[:3, 5:8], T[3:5, 3:5], T[5:, 8:] = -np.eye(3), np.eye(3), np.eye(2), np.eye(2)
    whole, least = T.T @ pairs @ T, T.T @ found @ T
    assert np.linalg.eigvalsh(whole + least).min() > -1e-12
    assert np.linalg.eigvalsh(least).min() > -1e-12
    assert np.abs(np.matmul(whole + least, least)).max() < 1e-12


def test_no_step_carries_a_ring_through_another():
    def passes(x0, normals, way):
        before = MeshPose(np.array(x0), np.array(normals))
        linked = np.zeros((0, 2), dtype=int)
        q = np.zeros((2, 5))
        q[1, :3] = way
        after = before.moved(q)
        old, new = (find_mesh_contacts(pose, linked, 0.1, 0.6) for pose in (before, after))
        return is_passage_safe(old, new, q)

    flat = [[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]
    # parallel rings pass through two wires at once, which no linking number tells
    assert not passes([[0, 0, 0], [1.0, 0, 0.3]], flat, [0, 0, -0.6])
    assert passes([[0, 0, 0], [1.0, 0, 0.3]], flat, [0, 0, 0.3])
    # far from each other before and after
    assert not passes([[0, 0, 0], [0, 0, 4.0]], flat, [0, 0, -8.0])
    assert passes([[0, 0, 0], [0, 6.0, 4.0]], flat, [0, 0, -8.0])


def test_a_straight_chain_has_its_known_length():
    b_x, b_y = FiniteMesh.rectangle(Cell(), 1, 1).sides
    along = np.array([2.0 * b_x, 2.0 * b_y])
    aside = np.array([-1.0, 1.0])
    mesh = FiniteMesh.inside(Cell(), [-aside, along - aside, along + aside, aside])
    n = len(mesh.X)
    assert n == 5
    assert len(mesh.linked) == 4
    force, held, at = np.zeros((n, 3)), np.zeros((n, 3), dtype=bool), np.column_stack([mesh.X, np.zeros(n)])
    held[0] = True
    force[-1] = [0.3, 0.4, 0.0]
    held[-1, 2] = True
    for space in (False, True):
        solution = mesh.solve(force, held, at, space=space)
        check(solution)
        way = solution.centre[-1] - solution.centre[0]
        assert np.linalg.norm(way) == pytest.approx(2 * (n - 1) * (5.0 - 0.5), abs=1e-5)
        assert way[:2] / np.linalg.norm(way) == pytest.approx([0.6, 0.8], abs=1e-5)
        assert solution.contacts.force[solution.contacts.force > 1e-6] == pytest.approx(0.5, rel=1e-5)
        assert solution.reaction[0] == pytest.approx([-0.3, -0.4, 0.0], abs=1e-7)


def test_supports_carry_the_load_and_the_virial_is_that_of_the_load():
    mesh = FiniteMesh.rectangle(Cell(), 3, 2)
    force, held, at = hung(mesh, top_of(mesh))
    solution = mesh.solve(force, held, at, space=False)
    check(solution)
    assert solution.reaction.sum(axis=0) + solution.load.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-9)
    assert solution.mean_height == pytest.approx(mesh.area @ solution.centre[:, 1] / mesh.area.sum())
    area = mesh.area.sum()
    P = solution.line_load(np.zeros(len(mesh.X), dtype=int), np.array([area]))[0]
    # the virial theorem: sum of external force times reference position over the area
    outer = (solution.load + solution.reaction)[:, :, None] * mesh.X[:, None, :]
    assert outer.sum(axis=0)[:2] / area == pytest.approx(P[:2], abs=1e-9)  # along z the plane holds the rings
    assert not solution.reaction[~held.any(axis=1)].any()


@pytest.mark.slow
def test_rings_of_two_layers_hang_in_space_only():
    """King's mail by two corners; its slack start has the gaps of its weave."""
    weave = WEAVES["kings-4-in-1"]
    mesh = FiniteMesh.rectangle(Cell(10.0 * weave.jamming_ratio / 6.0, 1.0, weave), 2, 2)
    centre, normal = mesh.slack()
    con = find_mesh_contacts(MeshPose(centre / mesh.cell.r1, normal), mesh.linked, mesh.cell.wire, 0.6)
    assert con.deepest.min() > 2.0 / weave.jamming_ratio - 2.0 * mesh.cell.wire - 1e-9
    top = np.flatnonzero(mesh.X[:, 1] > mesh.X[:, 1].max() - 1e-6)
    ends = top[[mesh.X[top, 0].argmin(), mesh.X[top, 0].argmax()]]
    force, held, at = hung(mesh, ends)
    at[ends[1], 0] *= 0.9
    with pytest.raises(InputError, match="kings-4-in-1 lie in no plane"):
        mesh.solve(force, held, at, space=False)
    solution = mesh.solve(force, held, at)
    check(solution)
    assert solution.reaction.sum(axis=0) + solution.load.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-8)


def slsqp(mesh, force, held, at):
    """The potential in N mm that scipy finds from the slack start under the two lowest gaps of each pair."""
    n, r1 = len(mesh.X), mesh.cell.r1
    centre, normal = mesh.slack()
    centre += np.where(held, at, centre)[held[:, 0]].mean(axis=0) - centre[held[:, 0]].mean(axis=0)
    start = MeshPose(centre / r1, normal)
    pairs = [(a, b) for a in range(n) for b in range(a + 1, n)]
    linked = np.array(pairs)
    free = np.ones((n, 5), dtype=bool)
    free[:, 2] = False
    free[:, :3] &= ~held
    base = np.zeros((n, 5))
    base[:, :3] = np.where(held, at / r1 - start.x, 0.0)

    def of(v):
        q = base.copy()
        q[free] = v
        pose = start.moved(q)
        return pose, find_mesh_contacts(pose, linked, mesh.cell.wire, 10.0)

    def gaps(v):
        _, con = of(v)
        rank = np.arange(len(con.gap)) - np.searchsorted(con.minima.pair, con.minima.pair)
        out = np.repeat(con.deepest[:, None], 2, axis=1)
        real = ~con.fixed & (rank < 2)
        out[con.minima.pair[real], rank[real]] = con.gap[real]
        return np.minimum(out, 5.0).ravel()

    how = {"constraints": {"type": "ineq", "fun": gaps}, "method": "SLSQP", "options": {"maxiter": 40, "ftol": 1e-12}}
    scale, v = np.abs(force).sum(), np.zeros(int(free.sum()))
    for _ in range(60):  # in boxes smaller than the wire, so that no ring passes through another
        box = list(zip(v - 0.08, v + 0.08, strict=True))
        found = minimize(lambda v: -(force * of(v)[0].x).sum() / scale, v, bounds=box, **how)
        moved, v = np.abs(found.x - v).max(), found.x
        if moved < 1e-6:
            break
    pose, con = of(found.x)
    X = np.column_stack([mesh.X, np.zeros(n)])
    assert con.deepest.min() > -1e-6
    return float(-(force * (r1 * pose.x - X)).sum())


@pytest.mark.release
def test_a_generic_solver_finds_the_same_potential():
    mesh = FiniteMesh.rectangle(Cell(), 1, 1)
    force, held, at = hung(mesh, top_of(mesh))
    solution = mesh.solve(force, held, at, space=False)
    check(solution)
    assert abs(solution.potential - slsqp(mesh, force, held, at)) < 1e-5 * np.abs(force).sum() * 5.0


@pytest.mark.slow
def test_supports_out_of_reach_have_no_forces_and_say_how_far_they_are():
    mesh = FiniteMesh.rectangle(Cell(), 1, 1)
    force, held, at = hung(mesh, top_of(mesh))
    at[:, 0] *= 3.0
    found = mesh.solve(force, held, at, space=False)
    assert found.status == "out-of-reach"
    assert "closer together" in found.message
    assert found.kkt_residual == np.inf
    assert np.isnan(found.contacts.force).all()
    assert np.isnan(found.reaction).all()
    # two rings with one between them are as far apart as a straight chain of three
    ends = held[:, 0]
    apart = np.linalg.norm(np.diff(found.centre[ends], axis=0))
    assert apart < 4 * (5.0 - 0.5)
    short = np.abs((at - found.centre)[ends]).max(axis=0)[0]
    assert found.way_left_mm == pytest.approx(np.linalg.norm((at - found.centre)[ends], axis=1).max(), abs=1e-9)
    assert 0.5 * (33.0 - 4 * 4.5) < short < 11.0


@pytest.mark.slow
def test_an_impossible_tolerance_stalls_in_bounded_work_at_an_answer_that_is_good():
    mesh = FiniteMesh.rectangle(Cell(), 1, 1)
    problem = hung(mesh, top_of(mesh))
    found = mesh.solve(*problem, space=False, options=FiniteOptions(tolerance=1e-300, patience=6, retries=2))
    assert found.status == "stalled"
    assert found.kkt_residual < 1e-8
    assert found.iterations < 250  # two lifts, each higher than the one before
    assert found.potential == pytest.approx(mesh.solve(*problem, space=False).potential, rel=1e-6)
    early = mesh.solve(*problem, options=FiniteOptions(max_iterations=3, starts=1))
    assert (early.status, early.iterations, "allow more" in early.message) == ("iterations", 3, True)
    same = FiniteOptions(max_iterations=3, disturbance=0.0)  # another start would be the same one
    assert mesh.solve(*problem, options=same).iterations == 3


def small_problem():
    """A mesh of five rings in the plane, as posed and without units, and its start."""
    mesh = FiniteMesh.rectangle(Cell(), 1, 1)
    force, held, at = hung(mesh, top_of(mesh))
    problem = Problem(mesh, force, held, at, is_space=False, guide=np.full((5, 3), np.nan))
    return problem, problem.scaled(), problem.start(FiniteOptions())


def test_the_residual_of_an_answer_counts_overlaps_and_no_open_gap():
    problem, scaled, start = small_problem()
    for stretch, is_open in ((1.0, True), (1.3, False)):
        con = scaled.find(replace(start, x=stretch * start.x), 0.5)
        found = as_solution(problem, scaled, SolverResult(con, np.zeros(len(con.gap)), "stalled", 1e-9, ()))
        assert (con.deepest.min() > 0.0) == is_open
        assert found.kkt_residual == pytest.approx(1e-9 if is_open else -con.deepest.min(), rel=1e-12)


@pytest.mark.slow
def test_without_convergence_the_answer_is_the_best_iterate_and_its_residual_the_share_of_the_load():
    """At the end of its path the solver lifts mu of rings that stall, which takes them far from balance."""
    _, scaled, start = small_problem()
    for count, least, most in ((20, 1e-3, 0.1), (69, 0.0, 1e-10), (70, 0.0, 1e-10)):
        end = solve_rings(scaled, start, FiniteOptions(tolerance=1e-300, patience=6, max_iterations=count))
        out = spread(end.contacts, gradients(end.contacts), end.force)
        out[:, :3] += scaled.force
        share = np.abs(scaled.motions.T @ out.ravel()).sum() / np.abs(scaled.force).sum()
        assert end.status == "iterations"
        assert least <= share < most
        assert end.residual == pytest.approx(share, abs=1e-8)  # forces times gaps count too, where they are larger


def random_pairs(seed, n=40):
    """Rings in random positions over planes through random points."""
    rng = np.random.default_rng(seed)
    normal, m = (v / np.linalg.norm(v, axis=1)[:, None] for v in rng.standard_normal((2, n, 3)))
    place = rng.standard_normal((n, 3))
    return place + rng.uniform(1.2, 2.0, (n, 1)) * m, normal, place, m


def test_the_gap_of_a_ring_over_a_plane_has_the_sign_of_its_lowest_point():
    x, normal, place, m = random_pairs(1)
    t = np.linspace(0.0, 2.0 * np.pi, 2001)[:, None]
    for shift in (0.0, -0.8, -1.5):
        at = x + shift * m
        gap = wall_gaps(at, normal, place, m, np.full(len(x), np.inf))
        for one in range(len(x)):
            e1, e2 = (e[one] for e in tangent_frame(normal))
            lowest = ((at[one] + np.cos(t) * e1 + np.sin(t) * e2 - place[one]) @ m[one]).min()
            assert np.sign(gap[one]) == np.sign(lowest)
            if lowest > 0.0:
                assert lowest - 1e-5 <= gap[one] <= 2.0 * lowest + 1e-5


@pytest.mark.parametrize("R", [0.7, 1.6, 5.0])
def test_the_gap_of_a_ring_beside_a_ball_has_the_sign_of_its_nearest_point(R):
    x, normal, place, m = random_pairs(1)
    t = np.linspace(0.0, 2.0 * np.pi, 2001)[:, None]
    e1, e2 = tangent_frame(normal)
    for away in (R - 0.9, R, R + 0.4):
        place = x - away * m
        gap = wall_gaps(x, normal, place, m, np.full(len(x), R))
        points = (x - place)[:, None] + np.cos(t) * e1[:, None] + np.sin(t) * e2[:, None]
        distance = np.linalg.norm(points, axis=2).min(axis=1) - R
        assert (np.sign(gap) == np.sign(distance))[np.abs(distance) > 1e-5].all()


def test_a_ball_of_infinite_radius_is_a_half_space():
    x, normal, place, m = random_pairs(5)
    off, R = place - 1e6 * m, np.full(len(x), 1e6)
    flat = wall_derivatives(x, normal, place, m, np.inf * R)
    for one, other in zip(wall_derivatives(x, normal, off, m, R), flat, strict=True):
        assert one[:, :3] == pytest.approx(other[:, :3], rel=1e-4, abs=1e-4)
    assert wall_gaps(x, normal, off, m, R) == pytest.approx(wall_gaps(x, normal, place, m, np.inf * R), abs=1e-4)


@pytest.mark.parametrize("R", [np.inf, 0.6, 1.5, 5.0])
def test_derivatives_over_a_plane_and_beside_a_ball_are_those_of_differences(R):
    x, normal, place, m = random_pairs(2)
    radius = np.full(len(x), R)
    place = place if np.isinf(R) else x - (R + 1.5) * m
    q = np.random.default_rng(3).standard_normal((len(x), 5))
    way = np.random.default_rng(4).standard_normal((len(x), 3))
    step = 1e-4

    def at(t):
        moved = MeshPose(x, normal).moved(t * q)
        return wall_gaps(moved.x, moved.normal, place + t * way, m, radius)

    jac, H = wall_derivatives(x, normal, place, m, radius)
    v = np.concatenate([way - q[:, :3], q[:, 3:], np.ones((len(x), 2))], axis=1)  # planes do not turn
    assert (jac * v).sum(axis=1) == pytest.approx((at(step) - at(-step)) / (2 * step), abs=1e-5, rel=1e-6)
    second = (at(step) - 2 * at(0.0) + at(-step)) / step**2
    assert np.einsum("ni,nij,nj->n", v, H, v) == pytest.approx(second, abs=1e-4, rel=1e-6)


def over(solution, wall):
    """Distances (n,) in mm of the rings, wires included, from a half-space."""
    cell, m = solution.mesh.cell, wall.unit
    return solution.centre @ m - cell.r1 * np.sqrt(1.0 - (solution.normal @ m) ** 2) - cell.r2 - wall.offset


@pytest.mark.slow
def test_a_floor_carries_what_rests_on_it_and_a_far_one_nothing():
    mesh = FiniteMesh.rectangle(Cell(), 2, 2)
    problem = hung(mesh, top_of(mesh))
    free = mesh.solve(*problem, space=False)
    floor, far = HalfSpace((0.0, 3.0, 0.0), 6.0, "floor"), HalfSpace((0.0, 1.0, 0.0), -40.0)
    for space in (False, True):
        found = mesh.solve(*problem, space=space, walls=(floor, far))
        check(found)
        low = over(found, floor)
        assert low.min() == pytest.approx(0.0, abs=1e-6)
        assert low.min() > -1e-9
        assert found.wall_force[0, 1] > 0.1 * np.abs(found.load).sum()
        assert found.wall_force[:, [0, 2]] == pytest.approx(0.0, abs=1e-12)
        assert found.wall_force[1] == pytest.approx(0.0, abs=1e-9)
        whole = found.reaction.sum(axis=0) + found.wall_force.sum(axis=0) + found.load.sum(axis=0)
        assert whole == pytest.approx(np.zeros(3), abs=1e-9)
        assert found.potential > free.potential
    assert mesh.solve(*problem, space=False, walls=(far,)).potential == pytest.approx(free.potential, rel=1e-8)


def test_a_mesh_comes_to_lie_flat_on_a_floor_that_carries_all_of_it():
    mesh = FiniteMesh.rectangle(Cell(), 1, 1)
    n = len(mesh.X)
    force, held = np.zeros((n, 3)), np.zeros((n, 3), dtype=bool)
    force[:, 2] = -G * mesh.mass
    held[0, :2] = True
    floor = HalfSpace((0.0, 0.0, 1.0), -20.0, "floor")
    found = mesh.solve(force, held, np.column_stack([mesh.X, np.zeros(n)]), walls=(floor,))
    check(found)
    assert found.wall_force[0] == pytest.approx(-force.sum(axis=0), abs=1e-9)
    assert np.abs(over(found, floor)).max() < 1e-6


@pytest.mark.slow
def test_rings_that_slide_over_a_floor_come_to_rest():
    """They are damped, so that a step gains little; mu fell, and their steps with its root, for 1000 iterations."""
    mesh = FiniteMesh.rectangle(Cell(), 4, 2)
    corner = top_of(mesh) & np.isclose(mesh.X[:, 0], mesh.X[:, 0].max())
    check(mesh.solve(*hung(mesh, corner), walls=(HalfSpace((0.0, 1.0, 0.0), 12.0),)))


def test_contacts_that_are_followed_are_those_of_a_whole_search():
    mesh, pose, rng = disturbed(3, 0.03)
    con = find_mesh_contacts(pose, mesh.linked, 0.1, 0.6)
    after = pose.moved(0.02 * rng.uniform(-1.0, 1.0, (len(mesh.X), 5)))
    new, gap = find_mesh_contacts(after, mesh.linked, 0.1, 3.0, guard_points=False), track_gaps(con, after)
    real = ~con.fixed
    assert np.isinf(gap[con.fixed]).all()
    least = np.full(len(con.key), np.inf)
    np.minimum.at(least, con.minima.pair[real], gap[real])
    deepest = new.deepest[np.searchsorted(new.key, con.key)]
    some = np.isfinite(least)
    assert (least[some] >= deepest[some] - 1e-9).all()
    assert (least[some] <= deepest[some] + 1e-9).mean() > 0.9


def from_random_starts(seeds):
    """Solutions of a small mesh in space from random starts, and its weight times r1."""
    mesh = FiniteMesh.rectangle(Cell(), 2, 1)
    corners = top_of(mesh) & (np.isclose(mesh.X[:, 0], 0.0) | np.isclose(mesh.X[:, 0], mesh.X[:, 0].max()))
    force, held, at = hung(mesh, corners)
    at[corners, 0] = 11.0 + 0.8 * (at[corners, 0] - 11.0)
    options = (FiniteOptions(seed=seed, disturbance=0.1) for seed in seeds)
    return [mesh.solve(force, held, at, options=one) for one in options], np.abs(force).sum() * 5.0


def test_fixed_points_of_a_soft_pair_are_as_near_as_its_minima_and_their_gaps_are_smooth():
    wire, none, normal = 0.1, np.zeros((0, 2), int), np.array([[0, 0, 1], [0, np.sin(2e-3), np.cos(2e-3)]])
    pose = MeshPose(np.array([[0, 0, 0], [0, 0, 2 * wire + 2e-3 + 1e-6]]), normal)
    con = find_mesh_contacts(pose, none, wire, 0.1)
    points = make_fixed_points(con, np.arange(1))
    fixed = find_mesh_contacts(pose, none, wire, 0.1, guard_points=False, fixed_points=points)
    assert con.minima.curvature.min() < 1e-2
    assert fixed.fixed.all()
    assert fixed.deepest == pytest.approx(con.deepest)
    assert con.deepest[0] <= fixed.gap.min() < 1.1 * con.deepest[0]
    turn = 1e-5 * np.eye(2, 5, 3)  # a tilt of each ring
    moved = find_mesh_contacts(pose.moved(turn), none, wire, 0.1, guard_points=False, fixed_points=points)
    forecast = fixed.gap + rows_of(fixed, fixed.minima.pair, gradients(fixed)[:, None]) @ turn.ravel()
    assert moved.gap == pytest.approx(forecast, abs=1e-9)  # twice the square of the turn over the distance


def test_soft_minima_across_a_ring_have_fixed_points_around_each_and_other_minima_stay():
    wire, none, shift = 0.1, np.zeros((0, 2), int), 0.02
    normal = np.array([[0, 0, 1], [0, np.sin(1e-3), np.cos(1e-3)]])
    pose = MeshPose(np.array([[0, 0, 0], [shift, 0, 2 * wire + 1e-3 + 1e-6]]), normal)
    con = find_mesh_contacts(pose, none, wire, 0.1, guard_points=False)
    assert len(con.gap) == 2
    points = make_fixed_points(con, np.arange(1))
    both = find_mesh_contacts(pose, none, wire, 0.1, guard_points=False, fixed_points=points)
    assert both.fixed.all()
    for rho, gap in zip(con.minima.rho_a, con.gap, strict=True):
        beside = np.linalg.norm(both.minima.rho_a - rho, axis=1) < points.spacing.max()
        assert gap <= both.gap[beside].min() < 1.1 * gap
    force = transfer_forces(con, np.array([1.0, 2.0]), both, np.array(1e-9))
    for rho, own in zip(con.minima.rho_a, (1.0, 2.0), strict=True):
        assert force[both.minima.rho_a @ rho > 0.0].sum() == pytest.approx(own)
    one = find_mesh_contacts(
        pose, none, wire, 0.1, guard_points=False, fixed_points=points.take(points.rho[:, 1] > 0.0)
    )
    assert (~one.fixed).sum() == 1
    assert one.gap[~one.fixed] == pytest.approx(con.gap[con.minima.rho_a[:, 1] < 0.0])


@pytest.mark.slow
def test_random_starts_end_at_one_potential():
    """From start 10 the supports cannot be moved at once."""
    found, scale = from_random_starts((0, 1, 10))
    for one in found:
        check(one)
    assert found[0].potential == pytest.approx(found[1].potential, abs=1e-5 * scale)
    assert found[2].potential == pytest.approx(found[1].potential, abs=0.05 * scale)


@pytest.mark.release
def test_no_ring_tunnels_from_a_hundred_random_starts():
    found, scale = from_random_starts(range(100))
    for one in found:
        assert one.contacts.links_intact
        assert one.contacts.min_gap_mm >= -1e-9
        assert one.status in ("converged", "stalled")
    settled = [one for one in found if one.status == "converged"]
    assert len(settled) >= 95
    assert max(one.kkt_residual for one in settled) < 1e-8
    assert np.ptp([one.potential for one in settled]) < 0.05 * scale


def test_a_vtu_file_has_the_places_of_the_answer_to_the_last_digit(tmp_path):
    import pyvista

    mesh = FiniteMesh.rectangle(Cell(), 1, 1)
    found = mesh.solve(*hung(mesh, top_of(mesh)), space=False)
    found.write_vtu(tmp_path / "rings.vtu")
    read = pyvista.read(tmp_path / "rings.vtu")
    assert np.array_equal(read.cell_data["centre_mm"][::ALONG], found.centre)
    assert np.array_equal(read.cell_data["normal"][::ALONG], found.normal)
    points = np.asarray(read.points).reshape(len(found.centre), -1, 3)
    assert np.linalg.norm(points - found.centre[:, None], axis=2) == pytest.approx(5.0, abs=1e-12)


SMALL = FiniteMesh.rectangle(Cell(), 1, 1)
HUNG = hung(SMALL, top_of(SMALL))
SENSELESS = (
    (lambda: HalfSpace((0.0, np.nan, 1.0), 0.0), "not a half-space"),
    (lambda: SMALL.solve(HUNG[0][:-1], *HUNG[1:]), "force: has shape"),
    (lambda: SMALL.solve(0.0 * HUNG[0], *HUNG[1:]), "carries no load"),
    (lambda: SMALL.solve(HUNG[0], HUNG[1] & False, HUNG[2]), "nothing carries the force"),
    (lambda: SMALL.solve(HUNG[0] + np.nan, *HUNG[1:]), "finite"),
    (lambda: SMALL.solve(*HUNG, guide=HUNG[2][:2]), "guide: has shape"),
    (lambda: FiniteMesh.rectangle(Cell(), 0, 1), "one cell or more"),
    (lambda: FiniteMesh.inside(Cell(), [(0, 0), (1, 1)]), "three or more points"),
    (lambda: FiniteMesh.inside(Cell(), [(0, 0), (4, 0), (0, 4)]), "rings"),
    (lambda: FiniteMesh.inside(Cell(), [(0, 0), (1e6, 0), (0, 1e6)]), "at most"),
    (lambda: cell_of_sides(5.0, 0.5, (11.0, 13.0)), "no known weave"),
)


@pytest.mark.parametrize(("call", "says"), SENSELESS, ids=[says for _, says in SENSELESS])
def test_what_makes_no_sense_is_refused_in_a_sentence(call, says):
    with pytest.raises(InputError, match=says) as error:
        call()
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_far_from_its_edges_a_mesh_has_the_strain_of_the_cell():
    found = edge_loaded(0.0, 45.0, (8, 8))
    assert found.numbers["status"] == "converged"
    assert found.arrays["error"][2:].max() < 1e-3


def test_the_right_hand_side_is_the_slope_of_the_barrier_function_where_each_ring_has_its_mu_and_with_a_guide_too():
    mesh, pose, rng = disturbed(3)
    n = len(mesh.X)
    guide = np.where(rng.uniform(size=(n, 3)) > 0.3, pose.x + rng.standard_normal((n, 3)), np.nan)
    none = np.zeros((n, 3), dtype=bool)
    motions = sparse.identity(5 * n, format="csr")
    problem = ScaledProblem(
        mesh.linked, 0.1, rng.standard_normal((n, 3)), none, pose.x, motions, guard_points=False, guide=guide
    )
    q, mu, step = rng.standard_normal((n, 5)), rng.uniform(0.001, 0.03, n), 1e-6

    def at(t):
        con = find_mesh_contacts(pose.moved(t * q), mesh.linked, 0.1, 0.6, guard_points=False)
        return con, problem.barrier(con, mu)

    con, _ = at(0.0)
    (fore, above), (aft, below) = at(step), at(-step)
    assert (fore.count == aft.count).all()
    zero = np.zeros(len(con.gap))
    none = np.zeros(len(con.key))
    iterate = Iterate(con, zero, mu, 0.0, none, none, zero, np.zeros(n), np.zeros(n), np.ones(n))
    assert (iterate.contact_mu == np.maximum(mu[con.a], mu[con.b])[con.minima.pair]).all()
    slope = -float(NewtonSystem(iterate, problem, gradients(con), Factorizer()).push @ q.ravel())
    assert (above - below) / (2 * step) == pytest.approx(slope, rel=1e-6)
    for small in np.outer((1e-9, 5e-4), np.ones(n)):
        assert problem.barrier(con, small) == replace(problem, guide=np.array(np.nan)).barrier(con, small)


def test_a_guide_has_no_part_in_the_answer_but_where_it_is_found():
    mesh = FiniteMesh.rectangle(Cell(), 2, 2)
    force, held, at = hung(mesh, top_of(mesh))
    guide = at + np.where(held, np.nan, [3.0, -9.0, 0.0])
    plain, guided = mesh.solve(force, held, at, space=False), mesh.solve(force, held, at, space=False, guide=guide)
    check(guided)
    assert guided.potential == pytest.approx(plain.potential, rel=1e-6)
    assert guided.reaction.sum(axis=0) == pytest.approx(-force.sum(axis=0), abs=1e-8)


JAMMING = [pytest.param(*case, marks=pytest.mark.slow) for case in (("4-in-1", 4.03), ("6-in-1", 6.0), ("6-in-1", 6.1))]


@pytest.mark.parametrize(("weave", "ratio"), [("4-in-1", 3.985), *JAMMING])
def test_near_jamming_the_disturbance_leaves_the_start_open(weave, ratio):
    """A disturbance of 0.01 r1 is more than the clearance there: wires overlapped, and held rings did not arrive."""
    mesh = FiniteMesh.rectangle(Cell(ratio, 1.0, WEAVES[weave]), 2, 2)
    found = mesh.solve(*hung(mesh, top_of(mesh)))
    check(found)
