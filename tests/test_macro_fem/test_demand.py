"""The law on demand: rings are asked where it matters, answers are kept, and the interval holds the answer.

Most tests ask rings that are known exactly: locked states of a shipped law, whose support function is the largest work
over them. What the real rings answer is tested in tests/test_rve; scenes of real rings are the slow tests.
"""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from homogenize import default_law, read_law_interval
from homogenize.fitting import law_interval
from homogenize.laws import with_mirror
from macro_fem import OnDemand, read_scene, solve
from macro_fem.bounds.interval import admissible_problem, bound, loads_of
from macro_fem.curtain import make_problem, solve_problem
from macro_fem.demand import rings as rings_module
from macro_fem.demand.directions import first_directions, widest
from macro_fem.demand.loop import solve_on_demand, strength_of_rows, with_strength
from macro_fem.demand.rings import Rings, contradictions, question
from macro_fem.judged import MEANING, judge_strength
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.solvers.cones import least_slack
from rve import WEAVES, Cell
from rve.common import NO_CACHE, Cache, InputError, NotConverged
from rve.common.tensor import WEIGHT, disc, from_disc

KNOWN = read_law_interval()
STATES = with_mirror(KNOWN.rows).E


def asked(x, cache=NO_CACHE, cell=None):
    """Rings that were asked for the directions x."""
    rings = Rings(cell or Cell(), cache)
    rings.ask(x)
    return rings


@pytest.fixture
def known_rings(monkeypatch):
    """Rings whose locked states are those of the shipped law; the list of loads that they were asked for."""
    loads = []

    def support(cell, S):
        loads.append(S[0])
        work = (S * WEIGHT) @ STATES.T
        best = work.argmax(axis=1)
        return SimpleNamespace(
            h=work.max(axis=1), E=STATES[best], status=np.array(["converged"]), unique=np.array([True])
        )

    monkeypatch.setattr(rings_module, "support", support)
    return loads


def square(support="corners", cells=4, **tables):
    kind = {"kind": support} if isinstance(support, str) else support
    return read_scene({"curtain": {"width": 100, "height": 100}, "mesh": {"cells": cells}, "support": kind} | tables)


def interval(found):
    """Lower and upper bound of the potential of the last turn."""
    return found.level.lower, found.level.upper


def test_a_quadratic_curtain_with_the_law_at_corners_is_admissible_everywhere_and_not_above_a_linear_one():
    scene, law = square(cells=4), default_law()
    mesh = build_mesh(scene, law.cell)
    quadratic = solve_problem(admissible_problem(scene, law, mesh))
    linear = solve_problem(make_problem(scene, law, mesh))
    assert quadratic.status == linear.status == "converged"
    scale = np.abs(linear.problem.force).sum() * 100.0
    assert linear.primal - quadratic.primal > 2e-3 * scale
    F = quadratic.F.reshape(3, -1, 2, 2)
    shares = np.random.default_rng(2).dirichlet(np.ones(3), 50)
    inside = np.einsum("kv,vcij->kcij", shares, F).reshape(-1, 2, 2)
    E = 0.5 * (np.einsum("nki,nkj->nij", inside, inside) - np.eye(2))
    assert least_slack(law, np.stack([E[:, 0, 0], E[:, 0, 1], E[:, 1, 1]], axis=1)) > -1e-8
    # At quadrature points alone the law is violated elsewhere, so that corners are what makes the bound.
    usual = replace(scene, mesh=replace(scene.mesh, element="P2"))
    loose = solve_problem(make_problem(usual, law, mesh))
    assert loose.primal < quadratic.primal - 1e-3 * scale


def test_the_distance_of_two_potentials_is_within_the_part_of_the_law():
    scene = square(cells=4)
    few = law_interval(KNOWN.rows.take(np.arange(0, len(KNOWN.rows), 9)), cell=KNOWN.law.cell)
    mesh = build_mesh(scene, KNOWN.law.cell)
    inner, outer = (solve_problem(admissible_problem(scene, law, mesh)) for law in (few.inner, few.outer))
    part = loads_of(inner.problem.disc.weight, inner.S, few.inner, few.outer).law_part
    scale = np.abs(inner.problem.force).sum() * 100.0
    assert 1e-3 * scale < inner.primal - outer.primal <= part + 1e-6 * scale
    assert part < 5.0 * (inner.primal - outer.primal)


def test_more_rows_narrow_the_interval_from_both_sides():
    scene = square(cells=4)
    mesh = build_mesh(scene, KNOWN.law.cell)
    lowers, uppers, parts = [], [], []
    for step in (12, 4, 1):
        rows = KNOWN.rows.take(np.arange(0, len(KNOWN.rows), step))
        law = law_interval(rows, cell=KNOWN.law.cell)
        solution = solve_problem(admissible_problem(scene, law.inner, mesh))
        bounds = bound(solution, outer=law.outer)
        lowers.append(bounds.lower)
        uppers.append(bounds.upper)
        parts.append(bounds.law_part)
    scale = np.abs(solution.problem.force).sum() * 100.0
    assert lowers[0] < lowers[1] - 1e-3 * scale
    assert lowers[1] < lowers[2] + 1e-5 * scale
    assert uppers[0] > uppers[1] + 1e-4 * scale
    assert uppers[1] > uppers[2] - 1e-6 * scale
    assert parts[0] > 2.0 * parts[1] > 4.0 * parts[2]


def test_the_interval_of_exactly_known_rings_holds_their_answer(known_rings):
    scene = square(cells=4)
    found = solve_on_demand(scene, Rings(Cell()), 0.05)
    low, high = interval(found)
    scale = np.abs(found.level.solution.problem.force).sum() * 100.0
    assert found.status == "converged"
    assert high - low <= 0.05 * scale
    finer = square(cells=8, solver={"adapt": 1})
    law = law_interval(KNOWN.rows, cell=KNOWN.law.cell)
    best = solve(finer, law).levels[-1]
    assert low < best.upper
    assert best.lower < high
    assert low < best.lower + 1e-3 * scale
    assert found.rings.solves == len(known_rings) < 60
    assert [turn["ring_solves"] for turn in found.turns] == sorted(turn["ring_solves"] for turn in found.turns)


def test_what_is_asked_is_where_the_curtain_is_stressed(known_rings):
    scene = square("top", cells=3, curtain={"width": 100.0, "height": 100.0, "weave_angle": "y"})
    found = solve_on_demand(scene, Rings(Cell()), 1e-3)
    first = len(first_directions(True))
    x = disc(np.array(known_rings))
    assert found.status == "converged"
    # hung along y every load is a pull along y, which the first directions hold: nothing else is worth asking
    assert len(x) == first


def test_a_law_that_is_known_is_where_the_run_begins(known_rings):
    found = solve_on_demand(square(cells=4), Rings(Cell(), known=KNOWN), 0.05)
    assert found.status == "converged"
    assert found.rings.solves == 0
    assert len(found.rings.rows) == len(KNOWN.rows)
    with pytest.raises(InputError, match="r2, b_x and b_y"):
        solve_on_demand(square(), Rings(Cell(5.0, 0.4), known=KNOWN), 0.05)
    with pytest.raises(InputError, match="carries no load"):
        solve_on_demand(square(load={"gravity": 0.0}), Rings(Cell(), known=KNOWN), 0.05)


def test_two_runs_with_one_cache_give_the_same_answer(known_rings, tmp_path):
    cache = Cache(tmp_path / "rings")
    first = solve_on_demand(square(), Rings(Cell(), cache), 0.05)
    count = len(known_rings)
    second = solve_on_demand(square(), Rings(Cell(), cache), 0.05)
    assert count == len(known_rings) == first.rings.solves
    assert first.rings.hits == 0
    assert second.rings.solves == 0
    assert second.rings.hits == count
    assert interval(first) == interval(second)
    assert np.array_equal(first.level.solution.x, second.level.solution.x)


def test_answers_that_others_contradict_are_asked_again_beside_them(known_rings, monkeypatch):
    """Rings that find the state of largest work under one load only together with another load."""
    whole, x = rings_module.support, first_directions(True)
    hidden = from_disc(x)[[8]]

    def support(cell, S):
        if len(S) > 1 or not np.allclose(S[0], hidden):
            return whole(cell, S)
        E = whole(cell, S).E - 0.02 * np.array([1.0, 0.0, 1.0])
        return SimpleNamespace(h=(S * WEIGHT * E).sum(1), E=E, status=np.array(["converged"]), unique=np.array([True]))

    right = asked(x)
    monkeypatch.setattr(rings_module, "support", support)
    wrong = asked(x)
    assert [i for i, *_ in contradictions(wrong.rows)] == [8]
    assert wrong.rows.h[8] < right.rows.h[8] - 1e-3
    assert not contradictions(right.rows)
    wrong.settle()
    assert np.array_equal(wrong.rows.h, right.rows.h)
    assert wrong.solves == len(x) + 2
    assert len(wrong.beside[8]) == 1


def test_rows_that_keep_contradicting_each_other_are_no_converged_answer(known_rings, monkeypatch):
    whole = rings_module.support

    def support(cell, S):
        found = whole(cell, S)
        low = found.E - 0.02 * np.array([1.0, 0.0, 1.0]) * (np.abs(S[:1, 1]) > 0.45)
        found.h, found.E = (S * WEIGHT * low).sum(axis=1), low
        return found

    monkeypatch.setattr(rings_module, "support", support)
    found = solve_on_demand(square(), Rings(Cell()), 0.2)
    assert found.status == "contradiction"
    assert "largest work" in found.message


@pytest.mark.slow
def test_limits_are_named(known_rings, monkeypatch):
    with monkeypatch.context() as few:
        few.setattr("macro_fem.demand.loop.MOST_TURNS", 2)
        turns = solve_on_demand(square(), Rings(Cell()), 1e-3)
    assert (turns.status, len(turns.turns)) == ("turn_limit", 2)
    monkeypatch.setattr("macro_fem.demand.loop.MOST_CELLS", 100)
    mesh = solve_on_demand(square(), Rings(Cell()), 1e-3)
    assert mesh.status == "mesh_limit"
    assert "100 triangles" in mesh.message
    monkeypatch.setattr("macro_fem.demand.loop.MOST_SOLVES", 12)
    law = solve_on_demand(square(), Rings(Cell()), 1e-3)
    assert law.status in ("law_limit", "mesh_limit")
    assert law.rings.solves == 12


def test_supports_that_no_state_reaches_are_refused_after_the_rings_were_asked_more_widely(known_rings):
    far = square(
        {"kind": "edge", "edge": "top", "gather": 1.9}, curtain={"width": 100.0, "height": 100.0, "weave_angle": "x"}
    )
    with pytest.raises(InputError, match="support"):
        solve_on_demand(far, Rings(Cell()), 0.1)
    assert len(known_rings) > len(first_directions(True)) + 16


def test_rings_without_an_answer_are_counted_and_named(monkeypatch):
    def support(cell, S):
        nan = np.full(3, np.nan)
        return SimpleNamespace(h=nan[:1], E=nan[None], status=np.array(["stalled"]), unique=np.array([False]))

    monkeypatch.setattr(rings_module, "support", support)
    with pytest.raises(InputError, match="12 of 12 load directions"):
        solve_on_demand(square(), Rings(Cell()))


def test_answers_of_the_cache_are_bit_for_bit_those_of_the_rings(known_rings, tmp_path):
    cache, x = Cache(tmp_path / "new" / "rings"), np.array([[0.1, 1.0 / 3.0]])
    first, again = asked(x, cache), asked(x, cache)
    assert (first.solves, again.solves, again.hits) == (1, 0, 1)
    for name in ("S", "E", "h", "unique"):
        assert np.array_equal(getattr(first.rows, name), getattr(again.rows, name))
    assert asked(x, cache, Cell(10.0, 1.0)).hits == 1  # only r1/r2 counts
    for other in (Cell(5.0, 0.49), Cell(grain="x")):
        assert asked(x, cache, other).solves == 1


def test_rings_without_an_answer_are_not_asked_twice(monkeypatch, tmp_path):
    def support(cell, S):
        raise NotConverged("stalled")

    monkeypatch.setattr(rings_module, "support", support)
    x, cache = np.array([[0.5, 0.0]]), Cache(tmp_path)
    assert (asked(x, cache).failed, asked(x, cache).failed) == (1, 1)
    assert asked(x, cache).hits == 1


@pytest.mark.parametrize("text", ["", "[]", '{"question": 1}', '{"h": 1e400}'])
def test_damaged_and_foreign_files_of_a_cache_are_answered_anew(known_rings, tmp_path, text):
    cache, x = Cache(tmp_path), np.array([[0.5, 0.0]])
    asked(x, cache)
    (file,) = tmp_path.glob("*.json")
    good = file.read_bytes()
    file.write_text(text)
    found = asked(x, cache)
    assert (found.solves, found.hits) == (1, 0)
    assert file.read_bytes() == good
    record = json.loads(good)
    file.write_text(json.dumps(record | {"answer": record["answer"] | {"unique": False}}))
    assert asked(x, cache).solves == 1


def test_an_answer_that_is_not_the_work_of_its_strain_is_not_taken(known_rings, tmp_path):
    """Halved values gave a converged interval of [41.5, 43.1] mm around 40; their checksum may be right."""
    S, cache = np.array([0.5, 0.0, 0.5]), Cache(tmp_path)
    record = {"E": [0.2, 0.0, 0.2], "status": "converged", "unique": True}
    cache.put(question(Cell(), S), record | {"h": 0.1})
    assert asked(disc(S[None]), cache).solves == 1
    cache.put(question(Cell(), S), record | {"h": 0.2})
    assert asked(disc(S[None]), cache).rows.h[0] == 0.2


def test_directions_are_asked_where_they_widen_most_and_apart():
    rng = np.random.default_rng(3)
    heavy, light = np.array([0.5, -0.4]), np.array([-0.6, 0.2])
    x = np.vstack([heavy + 0.005 * rng.normal(size=(50, 2)), light + 0.005 * rng.normal(size=(50, 2))])
    part = np.repeat([2.0, 1.0], 50)
    known = first_directions(True)
    both = widest(x, part, known, 8, True)
    assert np.abs(both[0] - heavy * [1.0, -1.0]).max() < 0.02
    assert np.abs(both[1] - light).max() < 0.02
    assert len(both) == 2  # the spread around each is less than half-way to what is known
    assert len(widest(x, part, np.vstack([known, x * [1.0, -1.0], x]), 8, True)) > 0
    assert len(widest(x, 0.0 * part, known, 8, True)) == 0
    assert widest(x, part, known, 1, False)[0, 1] == pytest.approx(heavy[1], abs=0.02)


def test_the_summary_tells_interval_parts_and_questions(known_rings, tmp_path):
    result = solve(square(), OnDemand(Cell(), 0.05, cache=tmp_path / "rings"))
    summary = result.summary
    low, high = summary["mean_height_interval_mm"]
    assert summary["status"] == result.status == "converged"
    assert high == pytest.approx(summary["mean_height_mm"])
    assert high - low <= 5.0
    assert summary["law_part_mm"] + summary["mesh_part_mm"] == pytest.approx(high - low)
    assert (summary["ring_solves"], summary["cache_hits"]) == (len(known_rings), 0)
    assert summary["turns"][-1]["lower_N_mm"] == result.levels[-1].lower
    assert summary["turns"][-1]["wall_s"] == summary["wall_s"]
    assert {row["feature"]: "rings on demand" in row["why"] for row in summary["features"]}["bounds"]


@pytest.mark.slow
def test_other_loads_than_the_weight_give_an_interval_of_the_potential(known_rings):
    load = {"point": [{"at": [50.0, 0.0], "force": [0.01, -0.01]}], "steps": 2}
    result = solve(square("top", load=load), OnDemand(Cell(), 0.1))
    summary = result.summary
    low, high = summary["potential_interval_N_mm"]
    assert low < high
    assert "mean_height_interval_mm" not in summary
    assert len(result.steps) == 2
    assert result.steps[0].status == "converged"


def test_bounds_by_a_law_alone_say_so():
    scene = square(cells=3, solver={"bounds": True})
    alone, rings = solve(scene, default_law()).summary, solve(scene).summary
    assert alone["law_part_mm"] is None
    assert rings["law_part_mm"] > 0.0
    (low, high), (inside, outside) = rings["mean_height_interval_mm"], alone["mean_height_interval_mm"]
    assert low < inside + 1e-3
    assert high > outside - 1e-3


def test_elements_without_bounds_are_refused():
    for tables in ({"mesh": {"cells": 3, "element": "P2"}}, {"solver": {"kind": "elastic"}}):
        with pytest.raises(InputError, match="bounds"):
            solve(square(**tables), OnDemand(Cell()))


def test_rings_tell_their_strength_at_the_loads_they_were_asked_for():
    """Dead loads and the Cauchy loads of the law's table lock the rings in the same states."""
    some = KNOWN.rows.take(np.arange(0, len(KNOWN.rows), 12))
    found, law = strength_of_rows(some, Cell()), KNOWN.law.strength
    inside = np.hypot(*disc(some.S).T) < 0.99  # states of loads of rank one may be others
    assert inside.sum() >= 10
    for name in ("utilisation", "collapse_utilisation"):
        one, other = (getattr(x, name)(some.S[inside], 235.0) for x in (found, law))
        np.testing.assert_allclose(one, other, rtol=1e-5)


SCENES = {
    "corners": square("corners", 4),
    "gathered": square({"kind": "top", "gather": 0.7}, 4),
    "rail along x": square("rail", 4, curtain={"width": 100.0, "height": 100.0, "weave_angle": "x"}),
    "turned": square("corners", 4, curtain={"width": 100.0, "height": 100.0, "weave_angle": 30.0}),
    "pulled": square("top", 4, load={"point": [{"at": [50.0, 0.0], "force": [0.02, -0.02]}]}),
    "round": square("top", 6, curtain={"shape": "disk", "radius": 60.0}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_the_interval_of_real_rings_holds_the_answer_of_the_finest_law_and_mesh(name, tmp_path_factory):
    scene = SCENES[name]
    found = solve_on_demand(scene, Rings(Cell(), Cache(tmp_path_factory.getbasetemp() / "c")), 0.03)
    assert found.status == "converged"
    assert found.law.raised < 1e-8
    low, high = interval(found)
    fine = replace(scene, mesh=replace(scene.mesh, cells=3 * scene.mesh.cells))
    law = default_law()
    best = solve_problem(admissible_problem(fine, law, build_mesh(fine, law.cell)))
    scale = np.abs(best.problem.force).sum() * best.problem.mesh.height
    assert best.status == "converged"
    assert low < best.primal < high + 2e-4 * scale


@pytest.mark.slow
def test_the_factor_on_demand_is_that_of_the_finest_law():
    """Of what the curtain asks for, within the error of the law between its rows; the weakest link is the same."""
    scene = square({"kind": "hooks", "pitch": 50.0, "gather": 0.9}, 6)
    found = solve(scene, OnDemand(Cell(), accuracy=0.05))
    told, solution = found.summary, found.solution
    assert told["safety_factor"] > 0.0
    problem, strength = solution.problem, default_law().strength
    own = replace(problem.law.own, strength=strength)
    same = judge_strength(replace(solution, problem=replace(problem, law=replace(problem.law, own=own))))
    used = "safety_factor", "utilisation_of_averages_max", "utilisation_of_point_forces_max"
    for key in used:
        assert told[key] == pytest.approx(same[key], rel=strength.error.first_yield_max)
    assert told["collapse_factor"] == pytest.approx(same["collapse_factor"], rel=strength.error.collapse_max)
    law = solve(scene, default_law()).summary
    assert told["safety_factor"] == pytest.approx(law["safety_factor"], rel=0.02)
    assert told["weakest"].split()[0] == law["weakest"].split()[0]


@pytest.mark.slow
@pytest.mark.parametrize("cell", [Cell(5.0, 0.5, WEAVES["6-in-1"]), Cell(5.0, 0.2, grain="x")], ids=["6-in-1", "thin"])
def test_other_weaves_and_radii_go_from_rings_to_curtain(cell):
    found = solve_on_demand(square(cells=3), Rings(cell), 0.06)
    assert found.status == "converged"
    assert found.law.raised < 1e-8
    low, high = interval(found)
    assert low < high
    assert found.law.rows.is_mirrored == cell.weave.is_mirrored
    told = judge_strength(with_strength(found).level.solution)
    assert told["strength_note"] == MEANING
    assert told["safety_factor"] > 0.0
