"""The law on demand: table and mesh are refined where it matters, tables are kept, the interval holds the answer."""

import json
from dataclasses import replace

import numpy as np
import pytest

from homogenize import default_law, read_law_interval
from homogenize.fitting import law_interval
from macro_fem import OnDemand, demand, read_scene, solve
from macro_fem.bounds import admissible_problem, bound, loads_of
from macro_fem.curtain import make_problem, solve_problem
from macro_fem.demand import Rings, distance, solve_on_demand
from macro_fem.judged import MEANING, critical_load, judge_strength
from macro_fem.scene import build_mesh
from macro_fem.solvers.cones import least_slack
from rve import WEAVES, Cell, solve_table
from rve.common import InputError, trace

KNOWN = read_law_interval()


def some(step):
    """What every `step`-th row of the shipped law proves."""
    return law_interval(KNOWN.rows.take(np.arange(0, len(KNOWN.rows), step)), cell=KNOWN.law.cell)


@pytest.fixture(scope="session")
def tables(tmp_path_factory):
    """A folder of tables for all tests."""
    return tmp_path_factory.mktemp("tables")


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


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_interval_of_the_rings_holds_their_answer(tables):
    scene = square(cells=4)
    found = solve_on_demand(scene, OnDemand(Cell(), 0.03, cache=tables))
    low, high = interval(found)
    scale = np.abs(found.level.solution.problem.force).sum() * 100.0
    assert found.status == "converged"
    assert high - low <= 0.03 * scale
    best = solve(square(cells=8, solver={"adapt": 1}), KNOWN).levels[-1]
    assert low < best.upper
    assert best.lower < high
    assert low < best.lower + 1e-3 * scale
    used = critical_load(found.level.solution)[None]
    assert distance(used / trace(used), found.rings.law.rows)[0] < 0.02  # where the strength is exact


@pytest.mark.slow
def test_rows_are_added_where_the_curtain_needs_them(tables):
    few, scene = some(12), square(cells=4)
    found = solve_on_demand(scene, OnDemand(Cell(), 0.03, few, tables))
    assert found.status == "converged"
    first, last = found.turns[0], found.turns[-1]
    assert first.law_part_N_mm > 4.0 * last.law_part_N_mm
    assert len(few.rows) < last.rows < 30
    whole = solve_on_demand(scene, OnDemand(Cell(), 0.03, cache=tables))
    low, high = np.transpose([interval(found), interval(whole)])
    assert low.max() < high.min()
    assert last.law_part_N_mm < 3.0 * whole.turns[-1].law_part_N_mm  # of 181 rows


@pytest.mark.slow
def test_nothing_is_asked_where_the_law_is_exact(tables):
    """Hung along y every load is a pull along y, which is a row."""
    scene = square("top", cells=3, curtain={"width": 100.0, "height": 100.0, "weave_angle": "y"})
    found = solve_on_demand(scene, OnDemand(Cell(), 1e-3, some(12), tables))
    assert found.status == "converged"
    assert found.turns[-1].rows == len(some(12).rows)


@pytest.mark.slow
def test_a_law_that_is_known_is_where_the_run_begins(tables):
    found = solve_on_demand(square(cells=4), OnDemand(Cell(), 0.05, KNOWN, tables))
    assert found.status == "converged"
    assert {turn.rows for turn in found.turns} == {len(KNOWN.rows)}
    with pytest.raises(InputError, match="r2, b_x and b_y"):
        solve_on_demand(square(), OnDemand(Cell(5.0, 0.4), 0.05, KNOWN))
    with pytest.raises(InputError, match="carries no load"):
        solve_on_demand(square(load={"gravity": 0.0}), OnDemand(Cell(), 0.05, KNOWN, tables))


@pytest.mark.slow
def test_two_runs_with_one_folder_give_the_same_answer(tmp_path):
    who = OnDemand(Cell(), 0.05, some(12), tmp_path / "new" / "rings")
    first, second = (solve_on_demand(square(), who) for _ in range(2))
    assert (first.rings.hits, second.rings.solves) == (0, 0)
    assert second.rings.hits == first.rings.solves >= len(some(12).rows)
    assert interval(first) == interval(second)
    assert np.array_equal(first.level.solution.x, second.level.solution.x)


def worse(table, rows):
    """A table whose rows have strains that do less work."""
    return replace(table, E=table.E - 0.02 * np.array([1.0, 0.0, 1.0]) * rows[:, None])


@pytest.mark.slow
def test_rows_that_contradict_each_other_are_solved_together(monkeypatch):
    """Rings that find the state of largest work only beside other loads."""

    def solved(cell, loads):
        found = solve_table(cell, loads)
        return worse(found, np.full(len(found), len(found) < 10))

    monkeypatch.setattr(demand, "solve_table", solved)
    rings = Rings(OnDemand(Cell(), known=some(12)))
    rings.ask(np.array([[20.0, 30.0]]))
    assert rings.law.raised < 1e-8
    assert rings.solves == 2 * len(rings.loads)
    assert KNOWN.law.support(rings.law.rows.S) == pytest.approx(rings.law.rows.h, abs=1e-3)


@pytest.mark.slow
def test_rows_that_keep_contradicting_each_other_are_no_converged_answer(monkeypatch):
    def solved(cell, loads):
        found = solve_table(cell, loads)
        return worse(found, (np.asarray(loads[1]) == 45.0))

    monkeypatch.setattr(demand, "solve_table", solved)
    found = solve_on_demand(square(), OnDemand(Cell(), 0.2))
    assert found.status == "contradiction"
    assert "largest work" in found.message


def test_known_rows_that_contradict_each_other_are_solved_again(tables):
    rows, less = some(12).rows, 0.1 * (np.arange(len(some(12).rows)) == 5)
    wrong = law_interval(replace(rows, E=rows.E - less[:, None] * [1.0, 0.0, 1.0], h=rows.h - less))
    assert wrong.raised > 1e-8
    assert Rings(OnDemand(Cell(), known=wrong, cache=tables)).law.raised < 1e-8


@pytest.mark.slow
def test_limits_are_named(tables):
    mesh = solve_on_demand(square(), OnDemand(Cell(), 1e-3, cache=tables, most_cells=100))
    assert mesh.status == "mesh_limit"
    assert "100 triangles" in mesh.message
    law = solve_on_demand(square(), OnDemand(Cell(), 1e-3, some(12), tables, most_loads=len(some(12).rows)))
    assert law.status == "law_limit"
    assert len(law.turns) == 1
    steps = square(solver={"max_iterations": 4})
    with pytest.raises(InputError, match="iterations"):
        solve_on_demand(steps, OnDemand(Cell(), 1e-3, cache=tables))


@pytest.mark.slow
def test_supports_that_no_state_reaches_are_refused_after_the_rings_were_asked_more_widely(tables):
    far = square(
        {"kind": "edge", "edge": "top", "gather": 1.9}, curtain={"width": 100.0, "height": 100.0, "weave_angle": "x"}
    )
    with pytest.raises(InputError, match="support"):
        solve_on_demand(far, OnDemand(Cell(), 0.1, cache=tables))


@pytest.mark.slow
def test_rings_without_an_answer_are_counted_and_named(monkeypatch):
    def solved(cell, loads):
        found = solve_table(cell, loads)
        return replace(found, status=np.full(len(found), "stalled"))

    monkeypatch.setattr(demand, "solve_table", solved)
    with pytest.raises(InputError, match="190 of 190 load directions"):
        Rings(OnDemand(Cell()))


@pytest.mark.slow
def test_tables_that_were_kept_are_read_bit_for_bit(tmp_path):
    """Of the same cell and loads only, and while they are whole."""
    known = some(20)

    def asked(cell=None):
        return Rings(
            OnDemand(
                cell or Cell(),
                known=known if cell is None else replace(known, law=replace(known.law, cell=None)),
                cache=tmp_path,
            )
        )

    first, again = asked(), asked()
    assert (first.hits, again.solves) == (0, 0)
    for name in ("S", "first_yield", "compliance"):
        assert np.array_equal(getattr(first.strength, name), getattr(again.strength, name))
    for other in (Cell(5.0, 0.49), Cell(grain="x"), Cell(centres="space"), Cell(material="titanium grade 2")):
        assert asked(other).hits == 0
    kept = {path: path.read_bytes() for path in tmp_path.iterdir()}
    question = json.loads(next(path for path in kept if path.suffix == ".json").read_text())["question"]
    assert set(question) >= {"weave", "loads_deg", "versions"}


@pytest.mark.slow
@pytest.mark.parametrize(
    "spoil",
    [
        ("csv", lambda text: text[:-20]),
        ("csv", lambda text: text.replace("converged", "stalled", 1)),
        ("json", lambda text: ""),
        ("json", lambda text: "[]"),
        ("json", lambda text: text.replace('"4-in-1"', '"6-in-1"')),
    ],
    ids=["cut", "changed", "empty", "foreign", "of another question"],
)
def test_damaged_and_foreign_tables_are_made_anew(tmp_path, spoil):
    who = OnDemand(Cell(), known=some(20), cache=tmp_path)
    ending, change = spoil
    Rings(who)
    (file,) = tmp_path.glob(f"*.{ending}")
    file.write_text(change(file.read_text("utf-8")), encoding="utf-8")
    assert Rings(who).hits == 0
    assert Rings(who).solves == 0


@pytest.mark.slow
def test_the_strength_is_that_of_a_table(tables):
    found, law = Rings(OnDemand(Cell(), cache=tables)).strength, default_law().strength
    S = KNOWN.rows.S
    for name in ("utilisation", "collapse_utilisation"):
        one, other = (getattr(x, name)(S, 235.0) for x in (found, law))
        np.testing.assert_allclose(one, other, rtol=1e-5)


@pytest.mark.slow
def test_the_summary_tells_interval_parts_and_questions(tables):
    result = solve(square(), OnDemand(Cell(), 0.05, cache=tables))
    summary = result.summary
    low, high = summary.mean_height_interval_mm
    assert summary.status == result.status == "converged"
    assert high == pytest.approx(summary.mean_height_mm)
    assert high - low <= 5.0
    assert summary.law_part_mm + summary.mesh_part_mm == pytest.approx(high - low)
    assert summary.ring_solves + summary.cache_hits >= 190
    assert summary.turns[-1].lower_N_mm == result.levels[-1].lower
    assert summary.turns[-1].wall_s == summary.wall_s
    assert {row.feature: "rings on demand" in row.why for row in summary.features}["bounds"]


@pytest.mark.slow
def test_other_loads_than_the_weight_give_an_interval_of_the_potential(tables):
    load = {"point": [{"at": [50.0, 0.0], "force": [0.01, -0.01]}], "steps": 2}
    result = solve(square("top", load=load), OnDemand(Cell(), 0.1, cache=tables))
    summary = result.summary
    low, high = summary.potential_interval_N_mm
    assert low < high
    assert "mean_height_interval_mm" not in summary
    assert len(result.steps) == 2
    assert result.steps[0].status == "converged"


@pytest.mark.slow
def test_bounds_by_a_law_alone_say_so():
    scene = square(cells=3, solver={"bounds": True})
    alone, rings = solve(scene, default_law()).summary, solve(scene).summary
    assert alone.law_part_mm is None
    assert rings.law_part_mm > 0.0
    (low, high), (inside, outside) = rings.mean_height_interval_mm, alone.mean_height_interval_mm
    assert low < inside + 1e-3
    assert high > outside - 1e-3


def test_elements_without_bounds_are_refused():
    for tables in ({"mesh": {"cells": 3, "element": "P2"}}, {"solver": {"kind": "elastic"}}):
        with pytest.raises(InputError, match="bounds"):
            solve(square(**tables), OnDemand(Cell()))


SCENES = {
    "corners": square("corners", 4),
    "gathered": square({"kind": "top", "gather": 0.7}, 4),
    "rail along x": square("rail", 4, curtain={"width": 100.0, "height": 100.0, "weave_angle": "x"}),
    "turned": square("corners", 4, curtain={"width": 100.0, "height": 100.0, "weave_angle": 30.0}),
    "pulled": square("top", 4, load={"point": [{"at": [50.0, 0.0], "force": [0.02, -0.02]}]}),
    "round": square("top", 6, curtain={"shape": "disk", "radius": 60.0}),
}


@pytest.mark.parametrize(
    "name", [pytest.param(k, marks=pytest.mark.release if i % 2 else pytest.mark.slow) for i, k in enumerate(SCENES)]
)
def test_the_interval_of_real_rings_holds_the_answer_of_the_finest_law_and_mesh(name, tables):
    scene = SCENES[name]
    found = solve_on_demand(scene, OnDemand(Cell(), 0.03, cache=tables))
    assert found.status == "converged"
    assert found.rings.law.raised < 1e-8
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
    assert told.safety_factor > 0.0
    problem, strength = solution.problem, default_law().strength
    own = replace(problem.law.own, strength=strength)
    same = judge_strength(replace(solution, problem=replace(problem, law=replace(problem.law, own=own))))
    used = "safety_factor", "utilisation_of_averages_max", "utilisation_of_point_forces_max"
    for key in used:
        assert told[key] == pytest.approx(vars(same)[key], rel=strength.error.first_yield_max)
    assert told.collapse_factor == pytest.approx(same.collapse_factor, rel=strength.error.collapse_max)
    law = solve(scene, default_law()).summary
    assert told.safety_factor == pytest.approx(law.safety_factor, rel=0.02)
    assert told.weakest.split()[0] == law.weakest.split()[0]


@pytest.mark.release
@pytest.mark.parametrize(
    "cell",
    [Cell(5.0, 0.5, WEAVES["6-in-1"]), Cell(5.0, 0.2, grain="x"), Cell(cells=(2, 2), centres="space")],
    ids=["6-in-1", "thin", "larger"],
)
def test_other_weaves_and_radii_go_from_rings_to_curtain(cell):
    found = solve_on_demand(square(cells=3), OnDemand(cell, 0.06))
    assert found.status == "converged"
    assert found.rings.law.raised < 1e-8
    low, high = interval(found)
    assert low < high
    assert found.rings.law.rows.is_mirrored == cell.weave.is_mirrored
    told = judge_strength(found.level.solution)
    assert told.strength_note == MEANING
    assert told.safety_factor > 0.0
