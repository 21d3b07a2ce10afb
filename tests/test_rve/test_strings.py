"""Rings drawn to strings: closed forms, an independent sequential cone program, invariance, bounds, commands."""

import json
from dataclasses import replace

import clarabel
import numpy as np
import pytest
from click.testing import CliRunner
from scipy import sparse
from scipy.spatial import ConvexHull

from rve import WEAVES, Cell, DirectOptions, Weave, read_table, reference_cell, support
from rve.cli import main
from rve.common import double_dot, from_disc, mirror
from rve.geometry import supercell
from rve.locking import string_states

ALONG, ACROSS = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
WIRES = {
    "4-in-1": 0.5,
    "kings-4-in-1": 0.5,
    "6-in-1": 0.3,
    "8-in-1": 0.3,
    "japanese-4-in-1": 0.5,
    "japanese-6-in-1": 0.3,
}
REST = ["kings-4-in-1", "japanese-4-in-1", "japanese-6-in-1", "own"]
OWN = Weave.from_rings(  # 4-in-1 of two sizes: rows of thick and of thin wire
    [(12.0, 0.0), (0.0, 6.5)],
    [
        {"centre": (0.0, 0.0, 0.0), "normal": (0.0, 0.56, 0.83), "r1": 5.0, "r2": 0.5},
        {"centre": (6.0, 3.2, 0.0), "normal": (0.0, -0.56, 0.83), "r1": 5.5, "r2": 0.3},
    ],
)


def loads_of(count, seed):
    rng = np.random.default_rng(seed)
    radius, angle = np.sqrt(rng.uniform(size=count)), rng.uniform(0.0, 2.0 * np.pi, count)
    return from_disc(radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def cell_of(name):
    return Cell(5.0, 0.4, OWN) if name == "own" else Cell(5.0, WIRES[name], weave=name)


def order_along(weave, ring, links):
    """Links (link, side) of a ring in the order in which its wire pierces the neighbours' disks, by 20,000 points."""
    x2, y3, t = weave.start_lattice
    a1, a2 = np.array([x2, t * x2, 0.0]), np.array([t * y3, y3, 0.0])
    own = weave.start_normals[ring]
    e1 = np.cross(own, [0.3, 0.5, 0.7])
    e1 /= np.linalg.norm(e1)
    angle = np.linspace(0.0, 2.0 * np.pi, 20_001)
    wire = weave.radii[ring] * (np.outer(np.cos(angle), e1) + np.outer(np.sin(angle), np.cross(own, e1)))
    places = []
    for link, (a, b, i, j) in enumerate(links):
        for side, (mine, other, sign) in enumerate(((a, b, 1), (b, a, -1))):
            if mine != ring:
                continue
            to = np.append(weave.start_centres[other] - weave.start_centres[mine], 0.0)[:3] + sign * (i * a1 + j * a2)
            height = (wire - to) @ weave.start_normals[other]
            inside = np.linalg.norm(wire - to, axis=1) < weave.radii[other]
            (where,) = np.flatnonzero((height[1:] * height[:-1] <= 0.0) & inside[1:])[:1]
            places.append((angle[where], link, side))
    return [(link, side) for _, link, side in sorted(places)]


def sequential(cell, sides_mm, S, starts, seed):
    """The largest work by cone programs (clarabel) of the work's slope, from random F; places p and p' are unknowns."""
    weave, (bx, by) = cell.weave, sides_mm
    links = weave.pairs[weave.linked].tolist()
    loops = [order_along(weave, k, links) for k in range(weave.classes)]
    count, edges = len(links), sum(map(len, loops))
    m = 4 + 4 * count + edges
    rows, cones, right, edge = [], [], [], 0

    def corner(link, side):
        at = np.zeros((2, m))
        at[:, 4 + 4 * link + 2 * side : 6 + 4 * link + 2 * side] = np.eye(2)
        if side:  # seen with the second ring in the first cell: less i a1 + j a2, F row by row
            i, j = links[link][2:]
            at[0, :2], at[1, 2:4] = (-i * bx, -j * by), (-i * bx, -j * by)
        return at

    for k, loop in enumerate(loops):
        s = min(cell.r2 * (weave.wires[links[n][0]] + weave.wires[links[n][1]]) for n, _ in loop)
        whole = np.zeros((1, m))
        whole[0, 4 + 4 * count + edge : 4 + 4 * count + edge + len(loop)] = 1.0
        rows.append(whole)
        right.append([2.0 * np.pi * (cell.r1 * weave.radii[k] - s)])
        cones.append(clarabel.NonnegativeConeT(1))
        for here, there in zip(loop, loop[1:] + loop[:1], strict=True):
            head = np.zeros((1, m))
            head[0, 4 + 4 * count + edge] = -1.0
            rows.append(np.vstack([head, corner(*here) - corner(*there)]))
            right.append(np.zeros(3))
            cones.append(clarabel.SecondOrderConeT(3))
            edge += 1
    for n, (a, b, *_) in enumerate(links):
        both = np.zeros((2, m))
        both[:, 4 + 4 * n : 8 + 4 * n] = np.hstack([np.eye(2), -np.eye(2)])
        rows.append(np.vstack([np.zeros((1, m)), both]))
        right.append([cell.r2 * (weave.wires[a] + weave.wires[b]), 0.0, 0.0])
        cones.append(clarabel.SecondOrderConeT(3))
    pinned = np.zeros((2, m))
    pinned[:, 4:6] = np.eye(2)
    rows.append(pinned)
    right.append(np.zeros(2))
    cones.append(clarabel.ZeroConeT(2))
    A, b = sparse.csc_matrix(np.vstack(rows)), np.concatenate(right)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
    T, best, rng = np.array([[S[0], S[1]], [S[1], S[2]]]), -np.inf, np.random.default_rng(seed)
    for _ in range(starts):
        F, before = rng.standard_normal((2, 2)), -np.inf
        for _ in range(300):
            slope = np.append(-(F @ T).ravel() / np.linalg.norm(F @ T), np.zeros(m - 4))
            solution = clarabel.DefaultSolver(sparse.csc_matrix((m, m)), slope, A, b, cones, settings).solve()
            F = np.array(solution.x[:4]).reshape(2, 2)
            work = 0.5 * (np.trace(F @ T @ F.T) - np.trace(T))
            if work - before < 1e-10:
                break
            before = work
        best = max(best, work)
    return best


def test_4_in_1_without_thickness_has_its_closed_forms():
    cell, (b_x, b_y) = Cell(5.0, 1e-6), (11.0, 12.646)
    found = string_states(cell, np.array([ALONG, ACROSS]), (b_x, b_y))
    exact = [0.5 * ((2.0 * np.pi * 5.0 / side) ** 2 - 1.0) for side in (b_y, b_x)]
    assert found.h == pytest.approx(exact, rel=1e-6)
    assert all(loop["is_tight"] for loop in found.row(0)["strings"]["loops"])


@pytest.mark.parametrize("r2", [0.2, 0.5, 1.0])
def test_a_4_in_1_ring_takes_this_length_with_its_thickness(r2):
    cell = Cell(5.0, r2)
    info = reference_cell(cell)
    found = string_states(cell, np.array([ALONG, ACROSS]), info.sides_mm)
    pitch = np.pi * 5.0 - 2.0 * (np.pi - 1.0) * r2
    assert np.linalg.norm(found.lattice(0)[1]) == pytest.approx(2.0 * pitch, rel=1e-8)
    assert np.linalg.norm(found.lattice(1)[0]) == pytest.approx(2.0 * pitch, rel=1e-8)
    assert found.h[0] == pytest.approx(0.5 * ((2.0 * pitch / info.b_y_mm) ** 2 - 1.0), rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*WEAVES, "own"])
def test_sequential_cone_programs_from_random_starts_find_no_more_and_no_less(name):
    cell = cell_of(name)
    sides, S = reference_cell(cell).sides_mm, np.vstack([ALONG, loads_of(3, 7)])
    found = string_states(cell, S, sides)
    for load, h in zip(S, found.h, strict=True):
        assert h == pytest.approx(sequential(cell, sides, load, 8, 3), abs=1e-6)


@pytest.mark.parametrize(
    "name",
    [
        "4-in-1",
        *(pytest.param(n, marks=pytest.mark.release if n in REST else pytest.mark.slow) for n in list(WEAVES)[1:]),
    ],
)
def test_rigid_rings_are_strings_too_and_h_is_convex(name):
    cell, S = cell_of(name), loads_of(9, 11)
    rigid = support(cell, S, DirectOptions(branches="first"))
    solved = rigid.status == "converged"
    assert solved.sum() >= 7  # thin Japanese weaves leave some loads unsolved
    found = string_states(cell, S, rigid.sides_mm)
    # h is the support function of one set, which holds every strain of either kind.
    for E in (rigid.E[solved], found.E):
        assert (found.h[:, None] - double_dot(S[:, None], E[None]) > -1e-8).all()
    assert (found.h > rigid.h + 0.05)[solved].all()


@pytest.mark.parametrize("name", ["4-in-1", "6-in-1", "8-in-1"])
def test_loops_are_as_long_as_rings_and_no_corner_points_inwards(name):
    cell, S = cell_of(name), loads_of(6, 5)
    found = string_states(cell, S, reference_cell(cell).sides_mm)
    for row in range(len(S)):
        for loop in found.row(row)["strings"]["loops"]:
            p = np.array(loop["corners_mm"])
            length = np.linalg.norm(np.roll(p, -1, axis=0) - p, axis=1).sum()
            assert length <= 2.0 * np.pi * (cell.r1 - 2.0 * cell.r2) * (1.0 + 1e-9)
            assert loop["is_tight"] == (length > 2.0 * np.pi * (cell.r1 - 2.0 * cell.r2) * (1.0 - 1e-6))
            assert ConvexHull(p, qhull_options="QJ").area == pytest.approx(length, abs=1e-6)


@pytest.mark.slow
def test_larger_cells_mirrors_and_the_other_grain_change_nothing():
    cell, S = Cell(5.0, 0.4), loads_of(4, 2)
    sides = reference_cell(cell).sides_mm
    h = string_states(cell, S, sides).h
    larger = replace(cell, weave=supercell(cell.weave, 2, 1))
    assert string_states(larger, S, sides).h == pytest.approx(h, abs=1e-7)
    assert string_states(cell, mirror(S), sides).h == pytest.approx(h, abs=1e-8)
    turned = replace(cell, grain="x")
    assert string_states(turned, S[:, ::-1], sides[::-1]).h == pytest.approx(h, abs=1e-12)
    assert string_states(cell, 3.0 * S, sides).h == pytest.approx(3.0 * h, rel=1e-12)
    assert string_states(cell, S, sides, starts=96).h == pytest.approx(h, abs=1e-10)


def test_tension_is_in_balance_with_the_load_and_grows_with_it():
    cell = Cell(5.0, 0.5)
    info = reference_cell(cell)
    found = string_states(cell, 3.0 * np.array([ALONG, ACROSS]), info.sides_mm)
    pitch = 2.0 * (np.pi * 5.0 - 2.0 * (np.pi - 1.0) * 0.5)
    # One ring bears b_x S22 a2 / b_y along the grain, and b_y S11 a1 / b_x across, by two strands.
    sides = info.b_x_mm / info.b_y_mm, info.b_y_mm / info.b_x_mm
    for row, ratio in enumerate(sides):
        assert found.tension[row] == pytest.approx(0.5 * 3.0 * ratio * pitch, rel=1e-4)
        assert found.stress[row] == pytest.approx(0.5 * 3.0 * ratio * pitch / (np.pi * 0.25), rel=1e-4)


@pytest.mark.parametrize("name", ["4-in-1", "6-in-1"])
def test_wire_that_stretches_gains_work_by_the_square_of_its_give(name):
    """Rings share these loads alike, so that wire under tension is that of larger rings."""
    cell, young = cell_of(name), 1e8
    S, sides = np.vstack([ALONG, loads_of(3, 7)]), reference_cell(cell).sides_mm
    found = string_states(cell, S, sides)
    for row, strain in enumerate(found.stress / young):
        longer = replace(cell, r1=cell.r1 * (1.0 + strain))
        gain = string_states(longer, S[row : row + 1], sides).h[0] - found.h[row]
        assert gain == pytest.approx(found.give[row] ** 2 / young, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*WEAVES, "own"])
def test_rings_share_all_loads_alike_but_in_japanese_weaves(name):
    """Cosines between the tensions of loads, each ring's by the root of what it stores."""
    cell = cell_of(name)
    found = string_states(cell, np.vstack([ALONG, ACROSS, loads_of(3, 7)]), reference_cell(cell).sides_mm, 6)
    stored = found.tension * np.sqrt(cell.weave.radii) / cell.weave.wires
    stored /= np.linalg.norm(stored, axis=1)[:, None]
    least = (stored @ stored.T).min()
    assert 0.6 < least < 0.8 if name.startswith("japanese") else least > 1.0 - 1e-6


@pytest.mark.parametrize("name", ["4-in-1", "own"])
def test_wires_touch_between_the_places_of_both(name):
    cell = cell_of(name)
    found = string_states(cell, ALONG[None], reference_cell(cell).sides_mm)
    at, corners = found.contacts(0), found.corners(0)
    first = found.mesh.ring == 0  # all links of both weaves begin at the first ring
    gap = np.linalg.norm(at[found.mesh.link[first]] - corners[first], axis=1)
    assert gap == pytest.approx(cell.r2 * cell.weave.wires[1], rel=1e-6)


@pytest.mark.slow
def test_commands_print_keep_and_draw_strings(tmp_path):
    picture, table = tmp_path / "strings.png", tmp_path / "table.csv"
    asked = ["support", "--S", "0,0,1", "--strings", "--plot", str(picture)]
    done = CliRunner().invoke(main, asked)
    assert done.exit_code == 0, done.output
    told = json.loads(done.output)
    assert told["h_strings"] == pytest.approx(1.80168672573428, rel=1e-8)
    assert picture.stat().st_size > 10_000
    assert "--strings" in CliRunner().invoke(main, [*asked[:3], "--plot", str(picture)]).stderr
    done = CliRunner().invoke(main, ["table", "--strings", "--alpha", "0,90", "--beta", "0", "--out", str(table)])
    assert done.exit_code == 0, done.output
    found = read_table(table)
    assert found.h_strings[1] == pytest.approx(told["h_strings"], rel=1e-8)
    assert found.columns()["h_strings"].shape == (2,)
