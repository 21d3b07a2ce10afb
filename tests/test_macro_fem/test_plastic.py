"""Rings that flow: limits of curtains against closed forms, an independent cone program and the worst cell; their
shapes, files and refusals."""

import json
from dataclasses import replace

import clarabel
import meshio
import numpy as np
import pytest
from click.testing import CliRunner
from scipy import sparse

from benchmarks.cone_form import gradient_matrix
from homogenize import default_law, diagonal_net
from homogenize.laws import plastic_law
from macro_fem import read_scene, solve
from macro_fem.bounds import curtain_limit, limit_levels
from macro_fem.cli import main
from macro_fem.curtain import solve_problem
from rve import InputError
from rve.common import WEIGHT
from tests.test_macro_fem.sheets import posed, sheet
from tests.test_macro_fem.test_random_scenes import draw

ALONG = np.array([[0.0, 0.0, 1.0]])
ROUND_DOWN = 2e-5
"""Factors are lowered by 1e-5, beside which bounds are closed to some 1e-8."""


def capacity(S=ALONG):
    """The nominal line load in N/mm with which a strip of the default law collapses: stretch at locking times S."""
    law = default_law()
    return float(np.sqrt(1.0 + 2.0 * law.support(S)[0]) * law.strength.yield_stress() / law.strength.collapse_at(S)[0])


def pulled(force, kind="plastic", cells=4, **more):
    """Tables of a strip hung from its top, without weight, pulled at its lower edge by a force (2,) in N/mm."""
    load = {"gravity": 0.0, "edge": [{"edge": "bottom", "force": force}]}
    return sheet(200.0, 300.0, cells, {"kind": "top"}, load=load, solver={"kind": kind}, **more)


def weaker(factor):
    """The default law of rings that collapse at a smaller load: all loads times `factor` are to it what loads are."""
    law = default_law()
    return replace(law, strength=replace(law.strength, collapse=law.strength.collapse * factor))


@pytest.mark.parametrize(("angle", "S"), [(0.0, ALONG), (90.0, np.array([[1.0, 0.0, 0.0]]))])
def test_a_strip_pulled_along_the_grain_or_across_it_bears_what_its_row_does(angle, S):
    limit = curtain_limit(posed(pulled([0.0, -2.0], weave_angle=angle)))
    assert limit.status == "converged"
    assert limit.lower <= limit.factor <= limit.upper
    assert [limit.lower, limit.factor, limit.upper] == pytest.approx(3 * [capacity(S) / 2.0], rel=ROUND_DOWN)


@pytest.mark.slow
def test_what_is_certified_is_the_answer_and_one_per_cent_more_has_none():
    limit = capacity() / 1.0
    for share, status in ((0.5, "converged"), (1.0 - 1e-5, "converged"), (1.01, "collapsed")):
        answer = solve(read_scene(pulled([0.0, -limit * share])))
        assert answer.status == status, share
        assert answer.summary.limit_factor == pytest.approx(1.0 / share, rel=ROUND_DOWN)
        assert answer.summary.holds is (True if share == 0.5 else answer.summary.limit_interval[0] >= 1.0)


def three_strips(folder, force, slack=20.0):
    """Three strips of 60 mm hung 200 mm high over a straight bar, the outer ones lowered by `slack` mm."""
    xs, ys = np.arange(0.0, 240.0, 20.0), np.arange(0.0, 220.0, 20.0)
    node = np.arange(len(xs) * len(ys)).reshape(len(xs), len(ys))
    cells = [(i, j) for i in range(len(xs) - 1) for j in range(len(ys) - 1) if j == 0 or i not in (3, 7)]
    square = np.array([[node[i, j], node[i + 1, j], node[i + 1, j + 1], node[i, j + 1]] for i, j in cells])
    triangles = np.vstack([square[:, [0, 1, 2]], square[:, [0, 2, 3]]])
    lines = {"bar": [], "outer": [], "middle": []}
    for i in range(len(xs) - 1):
        lines["bar"].append(node[i : i + 2, 0])
        if i not in (3, 7):
            lines["middle" if 3 < i < 7 else "outer"].append(node[i : i + 2, -1])
    points = np.column_stack([*(one.ravel() for one in np.meshgrid(xs, ys, indexing="ij")), np.zeros(node.size)])
    used = np.unique(triangles)
    number = np.full(node.size, -1)
    number[used] = np.arange(len(used))
    blocks = [("triangle", number[triangles])] + [("line", number[np.array(one)]) for one in lines.values()]
    tags = [np.full(len(block), tag) for tag, (_, block) in enumerate(blocks, 1)]
    data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    names = {"sheet": np.array([1, 2])} | {name: np.array([tag, 1]) for tag, name in enumerate(lines, 2)}
    meshio.Mesh(points[used], blocks, cell_data=data, field_data=names).write(folder / "strips.msh", "gmsh22")
    tables = {
        "curtain": {"shape": "file", "file": "strips.msh"},
        "support": [
            {"kind": "edge", "edge": "outer", "move": [0.0, -slack]},
            {"kind": "edge", "edge": "middle"},
        ],
        "load": {"bar": [{"edge": "bar", "mass": force / 9.81}]},
        "solver": {"kind": "plastic", "stabilising_tension": 0.0},
    }
    return read_scene(tables, folder / "scene.toml")


@pytest.mark.slow
def test_the_short_strip_flows_until_the_others_share_its_load(tmp_path):
    one = 60.0 * capacity()
    answer = solve(three_strips(tmp_path, 1.8 * one))
    found, solution = answer.summary, answer.solution
    weight = found.mass_kg * 9.81 / one
    assert answer.status == "converged"
    assert found.limit_factor == pytest.approx(3.0 / 1.8, rel=weight)
    assert found.collapse_factor == pytest.approx(1.0 / 1.8, rel=0.2)  # that of the middle strip, averaged over a cell
    assert found.lowest_point_mm == pytest.approx(-20.0, abs=1e-4)
    work = float(solution.problem.disc.weight @ solution.tau)
    assert work == pytest.approx(20.0 * one, rel=2.0 * weight)
    assert 0.0 < found.plastic_area_share <= 60.0 * 200.0 / found.mass_kg * found.areal_mass_kg_per_m2 * 1e-6
    assert found.largest_plastic_strain >= 20.0 / 200.0 - 1e-6


HOLE = [[80.0, 130.0], [120.0, 130.0], [120.0, 170.0], [80.0, 170.0]]


def by_clarabel(problem, rounds=60):
    """Lower bound, by clarabel with cutting planes, and upper bound, by all half-spaces of the law, of the limit."""
    law, fem, w = problem.plastic_law.own, problem.fem, problem.disc.weight
    L, S = roots(law.S), law.S * WEIGHT
    B, load, nq, n = gradient_matrix(fem), fem.gather(problem.force), len(w), fem.n
    scale = float(np.abs(load).sum())
    chosen = [set(range(0, len(S), len(S) // 8)) for _ in range(nq)]
    for _ in range(rounds):
        rows, columns, values, at = [], [], [], 0
        for q, which in enumerate(chosen):
            for j in which:
                rows.append(at)
                columns.append(n + q)
                values.append(-law.N[j])
                for a in range(2):
                    part = B[4 * q + 2 * a : 4 * q + 2 * a + 2].T @ L[j]
                    for k in range(2):
                        some = np.flatnonzero(part[:, k])
                        rows += len(some) * [at + 1 + 2 * a + k]
                        columns += some.tolist()
                        values += (-part[some, k]).tolist()
                at += 5
        M = sparse.csc_matrix((values, (rows, columns)), shape=(at, n + nq))
        M = sparse.vstack([sparse.csr_matrix(np.append(load / scale, np.zeros(nq))), M]).tocsc()
        cones = [clarabel.ZeroConeT(1), *(at // 5) * [clarabel.SecondOrderConeT(5)]]
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        cost, right = np.append(np.zeros(n), w), np.append(1.0, np.zeros(at))
        empty = sparse.csc_matrix((n + nq, n + nq))
        answer = clarabel.DefaultSolver(empty, cost, M, right, cones, settings).solve()
        F = (B @ np.array(answer.x)[:n]).reshape(nq, 2, 2)
        C = np.stack([(F[:, :, 0] ** 2).sum(1), (F[:, :, 0] * F[:, :, 1]).sum(1), (F[:, :, 1] ** 2).sum(1)], axis=1)
        each = np.sqrt(np.maximum(C @ S.T, 0.0)) / law.N
        low, high = answer.obj_val_dual / scale, float(w @ each.max(axis=1)) / scale
        if high - low < 1e-6 * high:
            break
        for q, j in enumerate(each.argmax(axis=1)):
            chosen[q].add(int(j))
    return low, high


def roots(S):
    """Symmetric L with L L = S (n, 2, 2)."""
    values, vectors = np.linalg.eigh(S[:, [0, 1, 1, 2]].reshape(-1, 2, 2))
    return (vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]) @ vectors.swapaxes(1, 2)


@pytest.mark.slow
def test_a_strip_with_a_hole_has_the_limit_of_an_independent_cone_program():
    problem = posed(pulled([0.3, -1.0], cells=6, holes=[HOLE]))
    low, high = by_clarabel(problem)
    limit = curtain_limit(problem)
    assert high - low < 2e-6 * high
    assert [limit.factor / (1.0 - 1e-5), limit.upper] == pytest.approx([low, high], rel=2e-5)


@pytest.mark.slow
def test_bounds_close_as_meshes_adapt():
    scene = pulled([0.0, -1.0], cells=6)
    scene["curtain"]["holes"] = [HOLE]
    scene["load"]["edge"].append({"edge": "right", "force": [0.6, 0.0]})
    scene["solver"]["adapt"] = 2
    gaps = []
    for limit in limit_levels(admissible(scene)):
        assert limit.lower <= limit.factor <= limit.upper
        assert limit.error.min() > -1e-6 * limit.upper
        assert limit.error.sum() == pytest.approx(limit.upper - limit.lower, abs=3e-5 * limit.upper)
        gaps.append(1.0 - limit.lower / limit.upper)
    assert gaps[-1] < 0.5 * gaps[0]


def admissible(tables):
    """The problem of a scene, the law obeyed everywhere."""
    from macro_fem.bounds import admissible_problem
    from macro_fem.scene import build_mesh

    scene, law = read_scene(tables), default_law()
    return admissible_problem(scene, law, build_mesh(scene, law.cell))


@pytest.mark.slow
def test_the_gap_is_below_a_thousandth_with_adapt():
    scene = pulled([0.2, -1.0], cells=8)
    scene["solver"]["adapt"] = 7
    limit = list(limit_levels(admissible(scene)))[-1]
    assert 0.0 <= 1.0 - limit.lower / limit.upper < 1e-3


def plastic(seed):
    """Tables of random scene `seed` with rings that flow."""
    tables = draw(seed)
    load = {key: value for key, value in tables["load"].items() if key != "steps"}
    return tables | {"load": load, "solver": {"kind": "plastic"}, "mesh": tables["mesh"] | {"element": "P1"}}


def worst_cell(tables):
    """The factor at which the weakest point of the rigid curtain collapses; None where it has no answer."""
    problem = posed(tables | {"solver": {"kind": "rigid"}})
    found = solve_problem(problem)
    law = problem.law
    if found.status != "converged":
        return None
    used = law.own.strength.collapse_utilisation(law.in_weave(found.S)) / strength_of_points(problem)
    return 1.0 / float(used.max())


def strength_of_points(problem):
    from macro_fem.curtain import strength_at_points

    return strength_at_points(problem, problem.disc)


def check_random(seed):
    tables = plastic(seed)
    try:
        problem = posed(tables)
        limit = curtain_limit(problem)
    except InputError:
        return False
    if not np.isfinite(limit.factor):
        return False
    assert 0.0 <= limit.lower <= limit.factor <= limit.upper * (1.0 + 1e-9)
    assert limit.upper - limit.factor < 1e-4 * limit.upper
    worst = worst_cell(tables)
    if worst is not None:
        assert limit.upper >= worst / problem.plastic_law.own.difference * (1.0 - 1e-6)
    again = curtain_limit(posed(tables, weaker(limit.factor)))
    assert limit.status == again.status == "converged"
    assert not again.is_passed
    found = solve_problem(posed(tables, weaker(0.999 * limit.factor)))  # next to the limit rounding may stall the shape
    assert found.status == "converged", found.message
    assert found.tau.min() >= 0.0
    assert curtain_limit(posed(tables, weaker(1.01 * limit.factor))).is_passed
    return True


@pytest.mark.slow
def test_a_random_scene_has_an_answer_up_to_its_limit():
    assert check_random(3)


@pytest.mark.parametrize(
    "seed", [pytest.param(k, marks=pytest.mark.slow if k < 14 else pytest.mark.release) for k in range(4, 60)]
)
def test_random_scenes_have_an_answer_up_to_their_limit_and_none_beyond(seed):
    check_random(seed)


@pytest.mark.parametrize("strings", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_supports_draw_a_strip_out_at_its_collapse_load_without_any_other(strings):
    sides = [
        {"kind": "edge", "edge": edge, "held": "x", "move": [way, 0.0]} for edge, way in (("left", 0), ("right", 80))
    ]
    tables = sheet(100.0, 100.0, 4, sides, load={"gravity": 0.0}, solver={"kind": "plastic", "strings": strings})
    found, across = solve_problem(posed(tables)), np.eye(3)[:1]
    longest = 100.0 * float(np.sqrt(1.0 + 2.0 * default_law().support(across)[0]))
    assert found.status == "converged"
    assert found.plastic_work == pytest.approx(100.0 * capacity(across) * (180.0 - longest), rel=1e-9)


@pytest.mark.parametrize(
    "gravity", [pytest.param(9.81, marks=pytest.mark.slow), pytest.param(1e-4, marks=pytest.mark.slow), 0.0]
)
@pytest.mark.parametrize(
    "support",
    [
        {"kind": "corners", "gather": 1.6},
        {"kind": "corners", "gather": 2.0},
        {"kind": "top", "gather": 1.7},
        [{"kind": "edge", "edge": "left"}, {"kind": "edge", "edge": "right", "move": [60.0, 0.0]}],
    ],
)
def test_supports_draw_rings_as_far_as_they_flow_under_next_to_no_load(support, gravity):
    """Line loads are up to 1e8 times those of the weight: steps that closed the gap before forces balanced stalled."""
    tables = sheet(100.0, 100.0, 4, support, load={"gravity": gravity}, solver={"kind": "plastic"})
    found, doubled = (solve_problem(posed(tables, law)) for law in (default_law(), weaker(0.5)))
    assert found.status == doubled.status == "converged", found.message
    assert found.drawn > 100.0
    if gravity < 1e-3:  # work of rings twice as strong is twice as much
        assert doubled.plastic_work == pytest.approx(2.0 * found.plastic_work, rel=1e-5)


def test_rings_that_never_flow_give_the_rigid_curtain():
    strong = weaker(1e-9)
    tables = sheet(
        300.0, 200.0, 6, {"kind": "top", "gather": 0.9}, load={"edge": [{"edge": "right", "force": [0.1, 0]}]}
    )
    rigid, flowing = (
        solve_problem(posed(tables | {"solver": {"kind": kind, "stabilising_tension": 0.0}}, strong))
        for kind in ("rigid", "plastic")
    )
    total = float(np.abs(rigid.problem.force).sum()) * rigid.problem.mesh.size
    assert flowing.status == rigid.status == "converged"
    assert abs(flowing.primal - rigid.primal) < 1e-8 * total
    assert abs(flowing.dual - rigid.dual) < 1e-8 * total
    assert 0.0 <= flowing.tau.min() <= flowing.tau.max() < 1e-4


def test_line_loads_stay_within_the_safe_set_while_work_is_done():
    problem = posed(pulled([0.5, -2.0], cells=6))
    found = solve_problem(problem)
    law = problem.plastic_law.own
    assert found.status == "converged"
    assert found.tau.max() > 0.0
    # no gradient G that the law limits to |G L| <= N makes P do more than unit work: P:F at the answer is such a one
    C = 2.0 * found.E + np.array([1.0, 0.0, 1.0])
    reach = (np.sqrt(np.maximum((C * WEIGHT) @ law.S.T, 0.0)) / law.N).max(axis=1)
    work = (found.P * found.F).sum(axis=(1, 2))
    assert (work <= reach * (1.0 + 1e-6)).all()
    # where rings flow, work is all that their limit allows: tau = |F L| / N - c / N for the half-space that they fill
    assert float(found.problem.disc.weight @ found.tau) > 0.0


BARE = {"width": 200, "height": 300, "areal_mass": 1.0}
WRONG = {
    "no strength": ({}, lambda law: replace(law, strength=None), "holds no strength"),
    "no half-spaces": (
        {"curtain": {"width": 200, "height": 300, "areal_mass": 1.0}},
        lambda law: diagonal_net(),
        "no half-spaces",
    ),
    "no yield stress": ({}, lambda law: replace(law, strength=bare(law.strength)), "has no yield stress"),
    "yield above ultimate": ({"material": {"yield": 500.0, "ultimate": 400.0}}, None, "ultimate"),
    "yield is no number": ({"material": {"yield": float("nan")}}, None, "yield"),
    "bodies": ({"obstacle": {"kind": "sphere", "centre": [0, 0, -300], "radius": 50}}, None, "does not go with"),
    "motion": ({"motion": {"duration": 1.0}}, None, "at rest"),
    "quadratic": ({"mesh": {"cells": 4, "element": "P2"}}, None, "element = 'P1'"),
}


def bare(strength):
    return replace(strength, material=replace(strength.material, yield_N_per_mm2=None, ultimate_N_per_mm2=None))


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_flow_is_refused_in_a_sentence(name):
    more, changed, told = WRONG[name]
    with pytest.raises(InputError) as raised:
        solve(read_scene(pulled([0.0, -1.0]) | more), changed(default_law()) if changed else default_law())
    assert told in str(raised.value)
    assert "\n" not in str(raised.value)


def test_butted_rings_flow_at_their_smaller_load():
    weak = weaker(3.0)
    limit = curtain_limit(posed(pulled([0.0, -1.0]), replace(weak, strength=replace(weak.strength, joint="butted:90"))))
    assert limit.factor == pytest.approx(capacity() / 3.0, rel=ROUND_DOWN)
    assert plastic_law(weak).difference == pytest.approx(plastic_law(default_law()).difference)


@pytest.mark.slow
def test_run_judges_by_the_limit(tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text(
        '[curtain]\nwidth = 200\nheight = 200\n[support]\nkind = "top"\n[load.bar]\nmass = 20\n[mesh]\ncells = 4\n'
        '[[combination]]\nname = "twice"\nbar = 2.0\n'
    )
    run = CliRunner().invoke(main, ["run", str(scene), "--limit", "--out", str(tmp_path / "a")])
    found = json.loads((tmp_path / "a" / "summary.json").read_text())
    assert run.exit_code == 0
    assert (tmp_path / "a" / "curtain_flow.png").exists()
    first, collapse = found["safety_factor"], found["collapse_factor"]
    assert first < collapse <= 1.01 * found["limit_factor"]  # averaged over a cell
    told = [
        run.output.index(text)
        for text in ("first yield at", "collapse of the worst cell at", "limit of the curtain at")
    ]
    assert told == sorted(told)
    assert found["governing_combination"] == "twice"
    assert found["combinations"][0]["limit_factor"] == pytest.approx(0.5 * found["limit_factor"], rel=2e-2)
    assert found["holds"] is (found["governing_factor"] >= 1.0)


@pytest.mark.slow
def test_size_searches_for_the_limit(tmp_path):
    scene = tmp_path / "scene.toml"
    sheet_and_mesh = "[curtain]\nwidth = 200\nheight = 200\n[mesh]\ncells = 3\n"
    scene.write_text(sheet_and_mesh + '[support]\nkind = "top"\n[load.bar]\nmass = 20\n')
    asked = {"--vary": "mass", "--from": "1", "--to": "200", "--factor": "2", "--jobs": "1"}
    words = ["size", str(scene), "--json", *(one for pair in asked.items() for one in pair)]
    ends = (["--out", str(tmp_path / "first")], ["--out", str(tmp_path / "limit"), "--limit"])
    first, limit = (json.loads(CliRunner().invoke(main, [*words, *end]).stdout) for end in ends)
    assert limit["value"] * 9.81 * 2.0 == pytest.approx(200.0 * capacity(), rel=0.02)
    assert first["value"] < limit["value"]
