"""The support function of the rings: derivatives, agreement with Cauchy loads, invariance, convexity, brute force."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.every_ring import brute
from rve import WEAVES, Cell, DirectOptions, InputError, grid, solve_table, support
from rve.cli import main
from rve.common import WEIGHT, double_dot, from_disc, mirror
from rve.geometry import FOUR_IN_ONE, SIX_IN_ONE, find_contacts, moved, reduction, start_pose, strain_of
from rve.locking import DeadLoad, Equations, solve_dead
from rve.locking.dead_load import open_gaps, random_poses
from rve.solve import reference_sides

FIRST = DirectOptions(branches="first")


def random_loads(count, seed):
    """Loads of unit trace over the whole disc, every fourth of rank one."""
    rng = np.random.default_rng(seed)
    radius, angle = np.sqrt(rng.uniform(size=count)), rng.uniform(0.0, 2.0 * np.pi, count)
    radius[::4] = 1.0
    return from_disc(radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1))


@pytest.mark.parametrize("name", WEAVES)
def test_the_dead_load_is_the_gradient_of_its_work_and_its_jacobian_is_symmetric(name):
    rng = np.random.default_rng(3)
    weave, sides = WEAVES[name], (2.2, 1.7)
    pose = moved(start_pose(weave, 1), 0.1 * rng.uniform(-1.0, 1.0, (1, weave.coordinates)))
    S = np.array([[0.7, 0.2, 0.4]])

    def at(v):
        there = moved(pose, v[None])
        f, J = DeadLoad(sides)(there, reduction(there), S)
        return sides[0] * sides[1] * double_dot(S, strain_of(there, sides))[0], f[0], J[0]

    step = 1e-5
    _, f, J = at(np.zeros(weave.coordinates))
    ways = step * np.eye(weave.coordinates)
    slope = [(at(way)[0] - at(-way)[0]) / (2.0 * step) for way in ways]
    np.testing.assert_allclose(f, slope, atol=1e-9)
    np.testing.assert_allclose(J[:3], [(at(way)[1] - at(-way)[1]) / (2.0 * step) for way in ways[:3]], atol=1e-9)
    np.testing.assert_allclose(J, J.T, atol=1e-14)
    assert np.abs(J[:3, :3] - np.diag(np.diag(J[:3, :3]))).max() > 0.1  # the bilinear lattice takes part


@pytest.mark.parametrize("ratio", [5.0, pytest.param(10.0, marks=pytest.mark.slow)])
def test_dead_and_cauchy_loads_lock_in_one_state_where_it_is_unique(ratio):
    cell = Cell(5.0, 5.0 / ratio)
    table = solve_table(cell, grid(15.0))
    S = table.S / (table.S[:, :1] + table.S[:, 2:])
    found = support(cell, S, FIRST if ratio == 5.0 else None)
    assert (found.status == "converged").all()
    np.testing.assert_allclose(found.h, double_dot(S, table.E), atol=1e-9)
    unique = table.unique & found.unique
    assert unique.sum() >= len(S) - 2
    np.testing.assert_allclose(found.E[unique], table.E[unique], atol=1e-9)
    np.testing.assert_allclose(found.x2_mm[unique], table.x2_mm[unique], atol=1e-7)
    np.testing.assert_array_equal(found.unique, table.unique)


@pytest.mark.slow
def test_size_unit_grain_and_mirror_change_nothing():
    S = np.array([[0.5, 0.2, 0.5], [1.0, 0.0, 0.0], [0.05, -0.1, 0.95]])
    plain = support(Cell(), S, FIRST)
    scaled = support(Cell(), 1e6 * S, FIRST)
    np.testing.assert_allclose(scaled.h, 1e6 * plain.h, rtol=1e-12)
    np.testing.assert_allclose(scaled.E, plain.E, atol=1e-10)
    inches = support(Cell(5.0 / 25.4, 0.5 / 25.4), S, FIRST)
    np.testing.assert_allclose(inches.h, plain.h, atol=1e-12)
    np.testing.assert_allclose(inches.x3_mm * 25.4, plain.x3_mm, atol=1e-9)
    turned = support(Cell(grain="x"), S[:, ::-1], FIRST)
    np.testing.assert_allclose(turned.h, plain.h, atol=1e-12)
    np.testing.assert_allclose(turned.E, plain.E[:, ::-1], atol=1e-10)
    np.testing.assert_allclose(turned.x2_mm, plain.x3_mm[:, ::-1], atol=1e-9)
    image = support(Cell(), mirror(S), FIRST)
    np.testing.assert_allclose(image.h, plain.h, atol=1e-12)
    np.testing.assert_allclose(image.E, mirror(plain.E), atol=1e-9)


def loads_near_the_straight_chain(cell, count, seed):
    """Loads of unit trace just inside rank one, with normals near that of the face of the straight chain of rings."""
    rng = np.random.default_rng(seed)
    face = solve_table(cell, ([30.0], [0.0]), FIRST).S[0]
    size = 10.0 ** rng.uniform(-5.0, -2.0, count)
    angle = np.arctan2(np.sqrt(face[2]), np.sqrt(face[0])) + size * rng.uniform(-2.0, 2.0, count)
    along = np.stack([np.cos(angle) ** 2, np.cos(angle) * np.sin(angle), np.sin(angle) ** 2], axis=1)
    S = along + size[:, None] * (np.array([1.0, 0.0, 1.0]) - along)
    return S / (S[:, :1] + S[:, 2:])


@pytest.mark.release
@pytest.mark.parametrize("ratio", [5.0, 7.0, 10.0, 20.0, 50.0])
def test_loads_just_inside_rank_one_lock_in_the_state_of_largest_work(ratio):
    """The weak second load decides where on a curved face of the locking surface the cell rests."""
    cell = Cell(5.0, 5.0 / ratio)
    S = loads_near_the_straight_chain(cell, 8 if ratio == 10.0 else 24, 1)
    if ratio == 10.0:
        S = np.concatenate([S, [[0.26846867, 0.30864901, 0.35490794]]])
    found = support(cell, S, FIRST if ratio == 10.0 else None)
    assert (found.status == "converged").all()
    assert (found.h[:, None] - (S * WEIGHT) @ found.E.T).min() > -1e-9
    table = solve_table(cell, (np.arange(16.0, 40.0, 4.0), np.zeros(6)), FIRST)
    assert (found.h[:, None] - (S * WEIGHT) @ table.E[table.converged].T).min() > -1e-9


THIN = pytest.mark.slow


@pytest.mark.parametrize(
    ("ratio", "weave"),
    [(5.0, FOUR_IN_ONE), pytest.param(30.0, FOUR_IN_ONE, marks=THIN), pytest.param(20.0, SIX_IN_ONE, marks=THIN)],
)
def test_the_support_function_is_convex(ratio, weave):
    """Sublinear on pairs, and the strains are its gradients: no state does more work than the one of the load."""
    one, other = random_loads(12, 4), random_loads(12, 5)
    S = np.concatenate([one, other, one + other])
    found = support(Cell(5.0, 5.0 / ratio, weave), S)
    assert (found.status == "converged").all()
    h = found.h.reshape(3, 12)
    assert (h[2] <= h[0] + h[1] + 1e-12).all()
    assert (h[0] + h[1] - h[2]).max() > 0.01
    assert (found.h[:, None] - (S * WEIGHT) @ found.E.T).min() > -1e-9


@pytest.mark.parametrize(
    ("ratio", "weave"),
    [(10.0, FOUR_IN_ONE), pytest.param(50.0, FOUR_IN_ONE, marks=THIN), pytest.param(10.0, SIX_IN_ONE, marks=THIN)],
)
def test_no_admissible_pose_does_more_work(ratio, weave):
    cell = Cell(5.0, 5.0 / ratio, weave)
    rng = np.random.default_rng(7)
    S = random_loads(8, 8)
    found = support(cell, S, FIRST if ratio == 10.0 else None)
    pose = moved(start_pose(weave, 3000), rng.uniform(0.02, 0.6, (3000, 1)) * rng.uniform(-1.0, 1.0, (3000, 9)))
    contacts = find_contacts(pose, weave, cell.wire, 0.6)
    good = np.flatnonzero(contacts.links_intact & (contacts.min_gap > 0.0))
    assert len(good) > 100
    E = strain_of(pose.take(good), (found.b_x_mm / 5.0, found.b_y_mm / 5.0))
    assert (found.h[:, None] - (S * WEIGHT) @ E.T).min() >= -1e-12


@pytest.mark.slow
def test_thin_wire_takes_the_longest_of_its_states():
    """Independent value: pulled along the grain at r1/r2 = 50 the longest of three states has h = 0.0586, b_y = 16.307.

    Rings slide over each other there; side by side, h is 0.
    """
    found = support(Cell(5.0, 0.1), [0.0, 0.0, 1.0])
    assert found.b_y_mm == pytest.approx(16.307, abs=1e-3)
    assert found.h[0] == pytest.approx(0.0586, abs=5e-5)
    assert np.hypot(*found.x3_mm[0]) == pytest.approx(found.b_y_mm * np.sqrt(1.0 + 2.0 * found.h[0]), rel=1e-9)
    assert found.x2_mm[0, 0] < 0.8 * found.b_x_mm


SKEW = [([0.8, 0.0, 0.2], 0.74291), ([0.6, 0.2, 0.4], 0.45863)]


@pytest.mark.parametrize(("S", "work"), SKEW)
def test_a_state_without_the_symmetry_of_the_slack_pose_is_found(S, work):
    """Independent values: sequential quadratic programming from disturbed slack cells (benchmarks/every_ring).

    Paths from the slack pose keep its symmetry and end in states of less work, whatever the load near S.
    """
    cell = Cell(5.0, 0.25, SIX_IN_ONE)
    found, first = support(cell, S), support(cell, S, FIRST)
    assert found.status[0] == "converged"
    assert work <= found.h[0] < work + 1e-4
    assert first.h[0] < found.h[0] - 5e-3
    assert asymmetry(first.states.pose, 0)[0] < 1e-6
    pose = found.states.pose.take(np.array([len(found.states.S) - 1]))
    assert asymmetry(pose, 0)[0] > 1e-2
    E = strain_of(pose, (found.b_x_mm / 5.0, found.b_y_mm / 5.0))
    assert double_dot(np.array([S]), E)[0] == pytest.approx(found.h[0], abs=1e-12)
    assert_admissible(pose, cell)


def asymmetry(pose, i):
    """How far poses (n,) are from a ring in the middle of i a1 + a2 that is the first one inverted and reflected."""
    off = pose.centres[:, 1] - 0.5 * (i * pose.a1 + pose.a2)
    turn = pose.normals[:, 1] - pose.normals[:, 0] * [-1.0, -1.0, 1.0]
    return np.maximum(np.abs(off).max(axis=1), np.abs(turn).max(axis=1))


def assert_admissible(pose, cell):
    """No ring overlaps another among 9 x 9 cells, and those of the weave are linked, by brute force."""
    around = [(i, j) for i in range(-4, 5) for j in range(-4, 5)]
    at = np.array([pose.centres[0, k] + i * pose.a1[0] + j * pose.a2[0] for i, j in around for k in range(2)])
    centre, normal = np.column_stack([at, np.zeros(len(at))]), np.tile(pose.normals[0], (len(around), 1))
    name = [(k, i, j) for i, j in around for k in range(2)]
    home = [name.index((k, 0, 0)) for k in range(2)]
    far = np.linalg.norm(centre[home][:, None] - centre[None], axis=2)
    pairs = np.array([(home[k], b) for k, b in np.argwhere((far > 0.0) & (far < 2.0 + 2.0 * cell.wire))])
    pair, _, distance = brute.minima_of(centre, normal, pairs)
    assert len(np.unique(pair)) > 12
    assert distance.min() > 2.0 * cell.wire - 1e-9
    woven = {(0, 1, i, j) for a, b, i, j in cell.weave.pairs[cell.weave.linked].tolist()}
    near = np.unique(pairs)
    linked = brute.linked_pairs(centre[near], normal[near], 1.0, 100)
    first = [(name[near[a]], name[near[b]]) for a, b in linked]
    seen = {(a[0], b[0], b[1] - a[1], b[2] - a[2]) for a, b in (sorted(pair) for pair in first)}
    assert seen == woven


@pytest.mark.parametrize(("ratio", "weave"), [(4.5, FOUR_IN_ONE), (50.0, FOUR_IN_ONE), (20.0, SIX_IN_ONE)])
def test_random_starts_are_admissible_and_far_apart(ratio, weave):
    equations = Equations.of(weave, 1.0 / ratio, load=DeadLoad((2.2, 2.53)))
    pose = random_poses(equations, 18)
    contacts = find_contacts(pose, weave, equations.wire, 0.6)
    assert contacts.links_intact.all()
    assert (contacts.min_gap > 0.0).all()
    np.testing.assert_array_equal(random_poses(equations, 18).normals, pose.normals)
    assert asymmetry(pose, 1 if weave is FOUR_IN_ONE else 0).min() > 1e-3
    assert np.ptp(pose.lattice[:, :2], axis=0).min() > (0.2 if ratio > 10.0 else 0.01)


def test_free_strains_are_flagged():
    """The load of rank one along the straight chain |x2 + x3| = 4 (r1 - r2): h is known, the strain is not."""
    b_x, b_y = reference_sides(Cell(), DirectOptions())
    # Along a1 + a2 = F (b_x, b_y), the work is (|a1 + a2|^2 - b_x^2 - b_y^2) / 2 for S = v v^T, v = (b_x, b_y).
    v = np.array([b_x, b_y])
    found = support(Cell(), [v[0] ** 2, v[0] * v[1], v[1] ** 2], FIRST)
    assert found.status[0] == "converged"
    assert not found.unique[0]
    assert found.h[0] == pytest.approx(0.5 * ((4.0 * (5.0 - 0.5)) ** 2 - v @ v), abs=1e-7)
    for other in (Cell(cells=(2, 1)), Cell(r2=0.6)):
        with pytest.raises(InputError, match="other rings or another size"):
            support(other, [1.0, 0.0, 0.0], known=found)


def test_a_locked_pose_is_opened_a_little():
    equations = Equations.of(FOUR_IN_ONE, 0.1, load=DeadLoad((2.2, 2.53)))
    found = solve_dead(random_loads(8, 2), equations, DirectOptions())
    pose = open_gaps(found.pose, equations, 1e-4)
    contacts = equations.contacts(pose)
    assert contacts.links_intact.all()
    assert (contacts.min_gap > 5e-5).all()
    assert np.abs(pose.lattice - found.pose.lattice).max() < 5e-3


@pytest.mark.slow
def test_states_known_before_are_starts():
    """From the slack pose a load of thin wire keeps a smaller state; from the states of others it climbs."""
    cell, S = Cell(5.0, 0.1), [0.2427026, -0.21719236, 0.7572974]
    first = support(cell, S, FIRST)
    best = support(cell, S)
    assert best.branch[0] == "restart"
    assert best.h[0] > first.h[0] + 1e-5
    again = support(cell, S, known=best)
    assert again.h[0] == pytest.approx(best.h[0], abs=1e-9)
    assert first.branch[0] == "slack"


@pytest.mark.parametrize(
    ("S", "words"),
    [([0.3, 0.4, 0.3], "has the eigenvalue -0.1"), ([0.0, 0.0, 0.0], "give a load"), ([1.0, 2.0], "shape")],
)
def test_loads_that_are_none(S, words):
    with pytest.raises(InputError, match=words):
        support(Cell(), S)


def test_the_command_prints_one_json_object():
    done = CliRunner().invoke(main, ["support", "--r1", "5", "--r2", "0.5", "--S", "2,0,0"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["h"] == pytest.approx(2.0 * 0.5 * ((17.42005 / 11.0) ** 2 - 1.0), abs=5e-4)
    assert found["x2_x_mm"] == pytest.approx(17.42005, abs=2e-4)
    assert {"E11", "E12", "E22", "x2_y_mm", "x3_x_mm", "x3_y_mm", "unique", "branch", "b_x_mm"} < found.keys()
    assert (found["status"], found["states"]) == ("converged", len(found["works"]))


def test_shear_to_round_off_does_not_stall_thin_wire():
    """The load of a row of a table along the grain, whose shear is 5e-11, of a Japanese weave of r1/r2 = 9."""
    cell = Cell(5.0, 5.0 / 9.0, "japanese-4-in-1")
    found = support(cell, [-1.2e-17, -4.9e-11, 1.0], DirectOptions(branches="first"))
    assert found.status == ["converged"]
    assert abs(found.h[0]) < 1e-9  # the reference cell is locked by this pull
