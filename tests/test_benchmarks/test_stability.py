"""The stability report: what its helpers say, and that its claims about tests are true."""

import ast
from pathlib import Path

import numpy as np
import pytest

from benchmarks.report.measure import at_most, outcomes, refusal
from benchmarks.report.records import Report, differences
from benchmarks.stability import cells, curtains, features, laws, loads, pairs, stepping
from homogenize.io import default_law
from rve.geometry.cell import Cell
from rve.geometry.contacts import find_contacts
from rve.geometry.weave import FOUR_IN_ONE

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(("x", "said"), [(1e-12, "<= 1e-12"), (1.1e-12, "<= 1e-11"), (-3.0, "<= 1e1"), (np.nan, "-")])
def test_decades_bound_from_above(x, said):
    assert at_most(x) == said


def test_outcomes_begin_with_what_converged():
    assert outcomes(np.array(["stalled", "converged", "compressive"])) == "1 converged, 1 compressive, 1 stalled"
    assert refusal(lambda: float("x")).startswith("could not convert")
    assert refusal(lambda: 1) == "accepted"


@pytest.mark.parametrize("row", features.FEATURES, ids=lambda row: row[features.TEST])
def test_every_feature_has_its_module_and_its_test(row):
    file, name = row[features.TEST].split("::")
    assert (ROOT / row["in"]).is_file()
    tree = ast.parse((ROOT / file).read_text())
    assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize("sense", [-1.0, 1.0])
def test_squeezed_cells_are_as_close_as_asked(sense):
    pose = cells.squeezed(sense, 1e-6, 0.1)
    gap = find_contacts(pose, FOUR_IN_ONE, 0.1, 0.6).min_gap[0]
    assert 1e-6 <= gap < 1.1e-6
    assert cells.admissible(pose, 0.1)[0]


def test_random_starts_are_admissible_and_seeded():
    one, two = cells.random_starts(20, 1, 0.1), cells.random_starts(20, 1, 0.1)
    assert cells.admissible(one, 0.1).all()
    np.testing.assert_array_equal(one.lattice, two.lattice)


def test_condition_numbers_are_those_of_the_last_matrix():
    scene = curtains.scene(cells=2)
    found, fem = curtains.solved(scene, default_law())
    assert found.status == "converged"
    raw, scaled = curtains.condition_numbers(fem)
    A = fem.pattern.full(curtains.stiffness(fem.disc, fem.pattern, fem.seen[0])).toarray()
    assert np.log10(raw) == pytest.approx(np.log10(np.linalg.cond(A, 1)), abs=0.5)
    assert 1.0 < scaled < raw


def test_a_refused_scene_is_a_row_with_its_sentence():
    scene = curtains.scene(cells=2, support={"kind": "hooks", "pitch": 0.1})
    assert "finer than the mesh" in curtains.row("hooks", scene, default_law())[curtains.STATUS]


def test_a_status_without_a_name_stops_the_report():
    with pytest.raises(ValueError, match="without a name"):
        loads.conclusion(np.array(["converged", "odd"]), [], [])


def test_short_sections_come_out_the_same_twice():
    once, twice = (Report("stability", "", "", "", (laws.measure(False), features.measure(False))) for _ in range(2))
    assert differences(once, twice) == []


def test_named_pairs_have_their_distances():
    for pair in pairs.PAIRS:
        row = pairs.pair_row(*pair)
        # Where circles cross, the distance has a kink: it is as exact as the angle, which is polished to 1e-9.
        is_crossing = pair[4] == "two crossings"
        assert row[pairs.ERROR] <= (1e-8 if is_crossing or pair[2] is pairs.TILT else 1e-12), row
        assert row["derivatives finite"], row


def test_ladders_span_the_decades_asked_for():
    spans = {}
    for name, value, _ in stepping.ladders():
        spans.setdefault(name.split(",")[0], []).append(value)
    assert max(spans["contact stiffness k"]) / min(spans["contact stiffness k"]) == pytest.approx(1e10)
    assert max(spans["h_max"]) / min(spans["h_max"]) == pytest.approx(1e7)
    assert max(spans["line load s_hat"]) / min(spans["line load s_hat"]) == pytest.approx(1e8)


@pytest.mark.slow
def test_loads_come_out_the_same_twice():
    rows = [loads.row("x", [t for _, t in loads.random_tables(500, 250)]) | {"s": 0.0} for _ in range(2)]
    assert rows[0] == rows[1]
    rim = loads.solve_table(Cell(), (loads.CIRCLE, loads.RIMS["uniaxial, beta = 0"]))
    assert loads.row("y", [rim])["outcome"] == "48 converged"
