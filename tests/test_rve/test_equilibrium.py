"""The direct solver against independent values, invariances, normality, and its own equations."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.problems import normality
from rve import Cell, DirectOptions, solve_table
from rve.common import double_dot
from rve.geometry import (
    FOUR_IN_ONE,
    Pose,
    cauchy_line_load,
    find_contacts,
    moved,
    parallel_clearance,
    start_pose,
    tangent_frame,
)
from rve.locking import Equations, solve_equilibrium
from rve.locking.limits import contact_forces, polish
from rve.locking.steps import accept_step, newton_direction
from rve.solve import locked_block, reference_sides

OPTIONS = DirectOptions()
FIRST = DirectOptions(branches="first")


def solve(alpha, beta, ratio=10.0, options=OPTIONS):
    return locked_block(np.atleast_1d(float(alpha)), np.atleast_1d(float(beta)), Cell(5.0, 5.0 / ratio), options).found


@pytest.mark.slow
def test_all_190_cases_converge(paper_table):
    assert len(paper_table) == 190
    assert (paper_table.status == "converged").all()
    assert paper_table.quality.R.max() < 1e-9
    assert paper_table.quality.min_gap_mm.min() >= -1e-9
    assert (paper_table.quality.contacts >= 2).all()
    assert paper_table.quality.iterations.mean() < 25  # 31 where steps towards the walls are halved


def test_values_of_independent_solvers(paper_table, row):
    """Two other solvers agree on these numbers in mm (design notes, section 4)."""
    expected = {
        (0.0, 90.0): ((11.0, 0.0), (0.0, 12.646069623526), 1e-9),
        (45.0, 0.0): ((9.7740790, 3.9782954), (3.3594133, 8.2535779), 1e-6),
        (0.0, 0.0): ((17.42005, 0.0), (0.0, 4.25798), 2e-4),
    } | {(a, 45.0): ((13.1163049, 0.0), (0.0, 11.2301635), 1e-6) for a in (0.0, 15.0, 45.0)}
    for (alpha, beta), (x2, x3, tolerance) in expected.items():
        i = row(alpha, beta)
        np.testing.assert_allclose(paper_table.x2_mm[i], x2, atol=tolerance)
        np.testing.assert_allclose(paper_table.x3_mm[i], x3, atol=tolerance)


def test_table_is_normal(paper_table):
    """S is the outward normal of a convex set at E: S_i : (E_i - E_j) >= 0 for all pairs (ideal locking)."""
    assert normality(paper_table).min() > -1e-9


@pytest.mark.slow
def test_free_strains_are_flagged_and_are_limits(paper_table):
    free = np.flatnonzero(~paper_table.unique)
    found = set(zip(paper_table.alpha_deg[free], paper_table.beta_deg[free], strict=True))
    assert found == {(a, 0.0) for a in (15.0, 20.0, 25.0, 30.0, 35.0, 40.0)}
    # The chain along the diagonal is straight: |x2 + x3| = 4 (r1 - r2).
    chain = np.linalg.norm(paper_table.x2_mm[free] + paper_table.x3_mm[free], axis=1)
    np.testing.assert_allclose(chain, 18.0, atol=1e-9)
    # Linear extrapolation from two small angles lands on the reported limit.
    far, near = (solve_table(Cell(), (paper_table.alpha_deg[free], np.full(len(free), beta))).E for beta in (0.1, 0.05))
    error = np.abs(2 * near - far - paper_table.E[free]).max()
    assert error < 4e-4
    assert error < 0.1 * np.abs(near - paper_table.E[free]).max()


def test_equilibrium_by_its_own_equations():
    """Contact forces recovered by nonnegative least squares from the bare pose balance the load."""
    alpha, beta = np.array([3.0, 27.0, 41.0, 66.0]), np.array([12.0, 33.0, 70.0, 50.0])
    cell = Cell()
    block = locked_block(alpha, beta, cell, OPTIONS)
    found, s = block.found, block.s
    equations = Equations.of(FOUR_IN_ONE, cell.wire)
    contacts = find_contacts(found.pose, FOUR_IN_ONE, cell.wire, 0.6)
    lam, balanced = contact_forces(found.pose, contacts, equations, s, 1e-8)
    assert balanced.weighted_residual.max() < 1e-9
    assert lam.min() >= 0.0
    assert contacts.links_intact.all()
    assert contacts.min_gap.min() >= -1e-10


def test_newton_converges_quadratically():
    """From 1e-3 off a smooth equilibrium the residual goes e, ~e^2, ~e^4 with the full unsymmetric Jacobian."""
    cell = Cell()
    block = locked_block(np.array([10.0]), np.array([30.0]), cell, OPTIONS)
    found, s = block.found, block.s
    equations = Equations.of(FOUR_IN_ONE, cell.wire)
    rng = np.random.default_rng(0)
    pose = moved(found.pose, 3e-4 * rng.uniform(-1, 1, (1, 9)))
    errors = []
    for steps in range(4):
        after = polish(pose, equations, s, reach=0.02, steps=steps).pose
        errors.append(np.abs(after.lattice - found.pose.lattice).max())
    assert errors[0] > 1e-5
    assert errors[1] < 50 * errors[0] ** 2 + 1e-12
    assert errors[2] < 50 * errors[1] ** 2 + 1e-12
    assert errors[3] < 1e-11


def same_strain(first, second, tolerance):
    np.testing.assert_allclose(first.pose.lattice, second.pose.lattice, atol=tolerance)


@pytest.mark.slow
def test_mirror_and_axis_symmetry():
    """E12 changes sign with alpha, and (alpha, beta) is the load (alpha + 90, 90 - beta)."""
    alpha, beta = np.array([12.0, 33.0, 45.0, 71.0]), np.array([20.0, 55.0, 0.0, 35.0])
    plain, mirrored = solve_table(Cell(), (alpha, beta)), solve_table(Cell(), (-alpha, beta))
    np.testing.assert_allclose(mirrored.E, plain.E * [1, -1, 1], atol=1e-9)
    turned = solve_table(Cell(), (alpha + 90.0, 90.0 - beta))
    np.testing.assert_allclose(turned.E, plain.E, atol=1e-9)
    half_turn = solve_table(Cell(), (alpha + 180.0, beta))
    np.testing.assert_allclose(half_turn.E, plain.E, atol=1e-9)


def test_grain_along_x_is_the_mesh_turned_over():
    alpha, beta = np.array([12.0, 33.0, 50.0]), np.array([20.0, 55.0, 70.0])
    y = solve_table(Cell(), (90.0 - alpha, beta))
    x = solve_table(Cell(grain="x"), (alpha, beta))
    np.testing.assert_allclose(x.E, y.E[:, ::-1], atol=1e-9)
    np.testing.assert_allclose(x.S, y.S[:, ::-1], atol=1e-9)
    assert x.cell.b_x_mm == pytest.approx(y.cell.b_y_mm, abs=1e-9)


@pytest.mark.slow
@settings(deadline=None, max_examples=2)
@given(st.floats(1e-4, 1e4), st.floats(-85, 85), st.floats(2, 88))
def test_units_do_not_matter(scale, alpha, beta):
    plain = solve_table(Cell(5.0, 0.5), ([alpha], [beta]))
    scaled = solve_table(Cell(5.0 * scale, 0.5 * scale, density=1.0), ([alpha], [beta]))
    assert plain.status[0] == scaled.status[0] == "converged"
    np.testing.assert_allclose(scaled.E, plain.E, atol=1e-9)
    equations = Equations.of(FOUR_IN_ONE, 0.1)
    s = cauchy_line_load([alpha], [beta])
    same_strain(solve_equilibrium(s, equations), solve_equilibrium(scale * s, equations), 1e-12)


def test_renumbered_rings_and_shifted_cell():
    """Class A and class B exchanged, and ring B taken from the next cell: the same strain."""
    weave = FOUR_IN_ONE
    swapped_pairs = weave.pairs.copy()
    swapped_pairs[:, 0], swapped_pairs[:, 1] = 1 - weave.pairs[:, 0], 1 - weave.pairs[:, 1]
    cross = weave.pairs[:, 0] != weave.pairs[:, 1]
    # Ring B becomes the first ring: pairs (B, A) at shift (i, j) with A at -c, written as (0, 1).
    i, j = -weave.pairs[cross, 2:].T - 1
    swapped_pairs[cross] = np.column_stack([0 * i, 0 * i + 1, i, j])
    renumbered = replace(weave, pairs=swapped_pairs, start_normals=weave.start_normals[::-1])
    shifted_pairs = weave.pairs.copy()
    shifted_pairs[cross, 2] -= 1
    next_cell = np.array([[0.0, 0.0], [weave.start_lattice[0], 0.0]])
    shifted = replace(weave, pairs=shifted_pairs, start_centres=weave.start_centres + next_cell)
    s = cauchy_line_load([10.0, 35.0, -20.0], [30.0, 60.0, 15.0])
    plain = solve_equilibrium(s, Equations.of(weave, 0.1))
    for other in (renumbered, shifted):
        found = solve_equilibrium(s, Equations.of(other, 0.1))
        assert (found.status == "converged").all()
        same_strain(found, plain, 1e-9)


def test_batch_size_and_order_do_not_matter(paper_table):
    order = np.random.default_rng(3).permutation(190)[:40]
    again = solve_table(Cell(), (paper_table.alpha_deg[order], paper_table.beta_deg[order]))
    np.testing.assert_allclose(again.E, paper_table.E[order], atol=1e-9)
    alone = solve_table(Cell(), (paper_table.alpha_deg[order[:1]], paper_table.beta_deg[order[:1]]))
    np.testing.assert_allclose(alone.E, paper_table.E[order[:1]], atol=1e-10)


@pytest.mark.parametrize(
    "ratio", [4.0, 10.0, 100.0, *(pytest.param(ratio, marks=pytest.mark.slow) for ratio in (5.0, 20.0, 50.0))]
)
def test_radius_ratios(ratio):
    alpha, beta = np.meshgrid([0.0, 20.0, 45.0, 70.0], [5.0, 30.0, 60.0, 90.0 if ratio < 50.0 else 75.0])
    table = solve_table(Cell(5.0, 5.0 / ratio), (alpha.ravel(), beta.ravel()), FIRST)
    assert (table.status == "converged").all()
    assert normality(table).min() > -1e-8 or ratio >= 50.0  # thin wire has several states


@pytest.mark.parametrize("ratio", [4.0, 10.0, 50.0, 100.0])
def test_reference_is_side_by_side(ratio):
    """In the reference state rings touch along x, b_x = 2 (r1 + r2), at every radius ratio."""
    b_x, b_y = reference_sides(Cell(5.0, 5.0 / ratio), OPTIONS)
    assert b_x == pytest.approx(2 * (5.0 + 5.0 / ratio), abs=1e-9)
    assert 0 < b_y < 4 * (5.0 - 5.0 / ratio)


def test_rings_do_not_pass_through_each_other():
    """Two rings of one class, side by side and then shifted onto each other: the way between is closed."""
    pose = start_pose(FOUR_IN_ONE, 2)
    after = moved(pose, np.array([[-0.8] + [0.0] * 8, [-0.1] + [0.0] * 8]))
    clearance = parallel_clearance(pose, after, FOUR_IN_ONE, 0.02)
    assert clearance[0] < -0.02
    assert clearance[1] > 0.0


def shingled(lean):
    """Rings of a row that overlap like shingles and lean along x by `lean`: open gaps and whole links for thin wire."""
    pose = start_pose(FOUR_IN_ONE, 1)
    normals = pose.normals.copy()
    normals[:, :, 0] = lean
    lattice, centres = pose.lattice.copy(), pose.centres.copy()
    lattice[:, 0], centres[:, 1, 0] = 1.95, 0.975
    return Pose(lattice, centres, normals / np.linalg.norm(normals, axis=2, keepdims=True))


def test_a_step_of_the_solver_stops_before_rings_pass_through_each_other():
    """Shingles that lean the other way have open gaps and whole links again, but have passed their neighbours' wire."""
    equations = Equations.of(FOUR_IN_ONE, 0.01)
    before, after = shingled(0.03), shingled(-0.03)
    contacts, beyond = (equations.contacts(pose) for pose in (before, after))
    for ends in (contacts, beyond):
        assert ends.links_intact.all()
        assert ends.min_gap[0] > 0.03
    e1, e2 = tangent_frame(before.normals)
    axis = np.cross(before.normals, after.normals)  # as long as the sine of the turn
    tilts = np.stack([(axis * e1).sum(axis=2), (axis * e2).sum(axis=2)], axis=2)
    dq = np.concatenate([np.zeros((1, 5)), tilts.reshape(1, 4)], axis=1)
    whole = moved(before, dq)
    np.testing.assert_allclose(whole.normals, after.normals, atol=1e-3)
    contacts = equations.contacts(before)
    pose, found = accept_step(before, contacts, dq, np.zeros(1), equations, None)
    # Half of the way has the rings in each other, a quarter of it keeps the wires apart.
    np.testing.assert_allclose(pose.normals, moved(before, 0.25 * dq).normals, atol=1e-15)
    assert found.min_gap[0] > 0.0
    assert pose.normals[0, 0, 0] > 0.0
    short, _ = accept_step(before, contacts, 0.1 * dq, np.zeros(1), equations, None)
    np.testing.assert_allclose(short.normals, moved(before, 0.1 * dq).normals, atol=1e-15)


def test_a_gap_that_rounds_to_zero_gives_no_step_and_no_warning():
    """Of two equal cases the one with such a gap stays where it is; the other one's step is as if it were alone."""
    equations, pose = Equations.of(FOUR_IN_ONE, 0.1), start_pose(FOUR_IN_ONE, 2)
    contacts = equations.contacts(pose)
    present = contacts.present.reshape(2, -1)
    gap = np.where(present, contacts.gap.reshape(2, -1), 1.0)
    lam = np.where(present, 1e-3 / gap, 0.0)
    s = np.repeat(cauchy_line_load(10.0, 30.0)[None], 2, axis=0)
    system = equations.assemble(pose, contacts, lam.reshape(contacts.gap.shape), s)
    state = system, lam, np.full(2, 1e-3), present, np.ones(2)
    expected, _ = newton_direction(state[0], gap, *state[1:])
    assert np.abs(expected).max() > 1e-6
    gap[1, np.flatnonzero(present[1])[0]] = 0.0
    dq, _ = newton_direction(state[0], gap, *state[1:])
    np.testing.assert_allclose(dq[0], expected[0], rtol=1e-12)
    assert not dq[1].any()


def test_random_starts_reach_the_same_strain():
    s = np.repeat(cauchy_line_load([10.0, 35.0], [30.0, 60.0]), 20, axis=0)
    rng = np.random.default_rng(8)
    start = moved(start_pose(FOUR_IN_ONE, 40), rng.uniform(-0.12, 0.12, (40, 9)))
    contacts = find_contacts(start, FOUR_IN_ONE, 0.1, 0.6)
    good = contacts.links_intact & (contacts.min_gap > 0)
    assert good.sum() >= 20
    found = solve_equilibrium(s[good], Equations.of(FOUR_IN_ONE, 0.1), OPTIONS, start.take(good))
    assert (found.status == "converged").all()
    expected = solve_equilibrium(s[good], Equations.of(FOUR_IN_ONE, 0.1), OPTIONS)
    same_strain(found, expected, 1e-9)


@pytest.mark.slow
def test_merging_contacts_need_both_twins(monkeypatch):
    """Near beta = 8 degrees two contacts of a pair merge. With the coarse sampling alone the iteration cycles there.

    At most 44 iterations are taken with twins; more of them do not help without.
    """
    rng = np.random.default_rng(2)
    s = cauchy_line_load(rng.uniform(15.0, 50.0, 60), rng.uniform(3.0, 16.0, 60))
    equations = Equations.of(FOUR_IN_ONE, 0.1)
    once = DirectOptions(attempts=1, max_iterations=75)
    assert (solve_equilibrium(s, equations, once).status == "converged").all()
    monkeypatch.setattr("rve.geometry.ring_pair._with_twins", lambda found, *rest: found)
    assert (solve_equilibrium(s, equations, once).status == "stalled").sum() > 10


def test_the_tolerance_bounds_the_residual_and_decides_when_to_stop():
    """With a coarse end of the path the residual is what the tolerance leaves: just below it, far above a finer one."""
    rng = np.random.default_rng(4)
    s = cauchy_line_load(rng.uniform(-90.0, 90.0, 40), rng.uniform(5.0, 85.0, 40))
    equations = Equations.of(FOUR_IN_ONE, 0.1)
    loose, fine = (
        solve_equilibrium(s, equations, DirectOptions(mu_start=1e-2, mu_end=1e-2, tolerance=tolerance, attempts=1))
        for tolerance in (1e-2, 1e-5)
    )
    for found, tolerance in ((loose, 1e-2), (fine, 1e-5)):
        assert (found.status == "converged").all()
        assert found.R.max() <= tolerance
    assert loose.R.max() > 1e-4
    assert fine.iterations.sum() > loose.iterations.sum()


@pytest.mark.slow
def test_a_limit_that_newton_does_not_confirm_is_no_answer(monkeypatch):
    """A load along the chain has a limit; where its equilibrium is not confirmed the row has a status and no strain. A
    table of largest work takes a state that the load leaves free from other rows: on one convex set with the limit."""
    loads = [25.0, 25.0], [0.0, 30.0]
    limit = solve_table(Cell(), loads)

    def unconfirmed(*args, **rest):
        return replace(polish(*args, **rest), status=np.full(len(args[2]), "stalled"))

    monkeypatch.setattr("rve.locking.limits.polish", unconfirmed)
    first, table = solve_table(Cell(), loads, FIRST), solve_table(Cell(), loads)
    assert [one.status.tolist() for one in (first, table)] == [["no-limit", "converged"], ["converged"] * 2]
    assert [one.unique.tolist() for one in (limit, first, table)] == [[False, True]] * 3
    assert np.isnan(first.E[0]).all()
    assert np.isfinite(first.E[1]).all()
    for one, other in ((limit, table), (table, limit)):
        assert (double_dot(one.S, one.E - other.E) > -1e-9).all()


def test_locked_strains_have_a_dent_that_no_other_start_removes():
    """Between the 5 degree rows (40, 90) and (45, 90) the locked strains lie up to 1e-3 inside their convex hull."""
    alpha = np.arange(40.0, 45.1, 0.5)
    beta = np.full(len(alpha), 90.0)
    block = locked_block(alpha, beta, Cell(), DirectOptions())
    found, s = block.found, block.s
    table = solve_table(Cell(), (alpha, beta), FIRST)
    slack = np.einsum("ik,ijk->ij", table.S * [1, 2, 1], table.E[:, None] - table.E[None])
    assert table.converged.all()
    assert -1e-3 < slack.min() < -1e-5
    dented = np.flatnonzero(slack.min(axis=1) < -1e-8)
    assert 0 < len(dented) < 8
    start = found.pose.take(slack[dented].argmin(axis=1))  # the pose that would do more work
    again = solve_equilibrium(s[dented], Equations.of(FOUR_IN_ONE, 0.1), start=start)
    np.testing.assert_allclose(again.pose.lattice, found.pose.lattice[dented], atol=1e-8)
