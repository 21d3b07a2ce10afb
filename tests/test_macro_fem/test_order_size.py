"""What an engineer does next: order sheet, load combinations with partial factors, the largest value that holds."""

import json
import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import trimesh
from click.testing import CliRunner

import macro_fem
from homogenize import fit
from macro_fem import Bar, Combination, Corners, EdgeLoad, Hooks, Load, Mesh, Outline, Rectangle, Scene, Wind, solve
from macro_fem.cli import main
from macro_fem.judged import combination_rows
from macro_fem.judged import envelope as envelope_of
from macro_fem.output import governing_line, lean_note, loads_in_words
from macro_fem.size import Range, find_size, search
from macro_fem.summary import HeldPoint
from macro_fem.trials import Sought, answer_of
from rve import Cell, InputError, grid, solve_table, with_rings
from tests.commands import run

HOOKS = """
curtain = {width = 330.0, height = 252.9}
mesh = {cells = 6}
support = {kind = "hooks", pitch = 110.0}
load = {bar = {mass = 2.0}}
"""


def hung(*items, **more):
    return Scene(Rectangle(330.0, 252.9), [Hooks(pitch=110.0), Bar(mass=2.0), *items], mesh=Mesh(cells=6), **more)


@pytest.mark.slow
def test_the_order_sheet_weighs_what_its_rings_weigh():
    """A ring of steel is a torus of 2 pi^2 r1 r2^2; those of the sheet weigh what the curtain weighs."""
    answer = solve(hung())
    order = answer.summary["order"]
    ring = 7.85e-6 * 2.0 * math.pi**2 * 5.0 * 0.5**2
    assert order["mass_kg"] == pytest.approx(order["rings"] * ring, rel=2e-3)  # rounded to whole rings
    assert order["rings"] == 2 * order["cells"] == pytest.approx(2 * 330.0 * 252.9 / (11.0 * 12.64607), abs=1)
    assert (order["mesh_width_mm"], order["mesh_height_mm"]) == (330.0, 252.9)
    assert (order["hooks"], order["hook_pitch_mm"]) == (4, pytest.approx(110.0))
    assert [order[key] for key in ("weave", "r1_mm", "r2_mm", "material")] == ["4-in-1", 5.0, 0.5, "steel"]
    assert order["lowest_point_mm"] == answer.summary["lowest_point_mm"]
    assert order["held_width_mm"] == pytest.approx(330.0, rel=1e-12)
    assert solve(hung(Corners(rings_per_hook=3))).summary["order"]["hooks"] == 4  # two are held twice
    disk = solve(Scene(macro_fem.Disk(60.0), [macro_fem.Top()], mesh=Mesh(cells=6))).summary["order"]
    assert disk["mesh_width_mm"] == disk["mesh_height_mm"] == 120.0  # not those of its polygon
    assert 0.0 in macro_fem.Disk(60.0).corners(6)  # sentences told a place at x = 4e-15


@pytest.mark.slow
def test_factors_scale_forces_of_a_shape_that_stays():
    """All loads of a rigid curtain by one factor: the same shape, forces and use in proportion."""
    factors = (Combination("all", weight=1.5, bar=1.5), Combination("light", bar=0.5))
    scene = Scene(Rectangle(330.0, 252.9), [Corners(), Bar(mass=2.0)], mesh=Mesh(cells=6), combination=factors)
    answer = solve(scene)
    summary = answer.summary
    own, light = summary.combinations
    envelope, supports = summary.envelope, summary.support_forces
    assert own.largest_force_N == pytest.approx(1.5 * supports[0].largest_nodal_force_N, rel=1e-5)
    assert own.weakest_factor == pytest.approx(summary.weakest_factor / 1.5, rel=1e-5)
    assert governing_line(summary).startswith("governing combination: all, does not hold, factor 0.8")
    failed = replace(summary, combinations=(replace(own, status="infeasible"),))
    assert governing_line(failed).endswith("no answer for all")
    assert envelope.weakest_factor == own.weakest_factor < light.weakest_factor
    weight = 9.81 * (summary.mass_kg + 0.5 * 2.0)
    forces = answer.combinations[1][1].summary.support_forces
    assert sum(one.force_N[1] for one in forces) == pytest.approx(weight, rel=1e-6)
    assert [row.combination for row in envelope.support_forces] == ["all"] * 2
    apart = HeldPoint(point="corner 1", at_mm=[9.0, 9.0], force_N=[0.0, 4.0], place_mm=[9.0, 9.0])  # of a finer mesh
    other = replace(summary, support_forces=(replace(supports[0], points=(apart,)),))
    answers = [(factors[0], replace(summary, weakest_factor=None)), (factors[1], other)]
    both = envelope_of(answers, combination_rows(answers))
    assert both.governing == "light"  # the other is as without load
    assert [row.combination for row in both.support_forces] == ["all", "all", "light"]


@pytest.mark.slow
def test_tables_of_results_hold_what_governs_and_not_the_loads_as_they_are(tmp_path):
    """sweep.csv says of a curtain that holds without factors what `run` says with them; one without has its own."""
    scene = "curtain = {width = 330.0, height = 252.9}\nmesh = {cells = 3}\nsupport = {kind = 'corners'}\n"
    scene += "load = {bar = {mass = 1.5}}\n"
    (tmp_path / "plain.toml").write_text(scene)
    (tmp_path / "both.toml").write_text(scene + "combination = [{name = 'a', bar = 0.5}, {name = 'b', bar = 1.5}]\n")
    names = "both", "plain"
    run("macro_fem", "sweep", *(tmp_path / f"{name}.toml" for name in names), "--out", tmp_path, "--", "--no-picture")
    both, plain = (json.loads((tmp_path / name / "summary.json").read_text()) for name in names)
    rows = pd.read_csv(tmp_path / "sweep.csv").set_index("name")
    under = {row["name"]: row["weakest_factor"] for row in both["combinations"]}
    assert both["weakest_factor"] == pytest.approx(plain["weakest_factor"], rel=1e-9)
    assert under["b"] < both["weakest_factor"] < under["a"]
    assert rows["governing_factor"].to_dict() == pytest.approx({"both": under["b"], "plain": plain["weakest_factor"]})
    assert rows["governing_combination"].fillna("").to_dict() == {"both": "b", "plain": ""}
    assert rows["holds"].to_dict() == {"both": under["b"] >= 1.0, "plain": plain["weakest_factor"] >= 1.0}


@pytest.mark.slow
def test_forces_of_single_hooks_that_change_with_the_mesh_are_told_with_both():
    """The hook whose force changes most, of those that bear, between this mesh and cells twice as large."""
    sheet = Rectangle(60.0, 60.0, weave_angle=45.0)
    items = Hooks(pitch=15.0, gather=0.95), Bar(mass=1.0, straight=False)
    fine, coarse = (solve(Scene(sheet, items, Mesh(cells=cells))).summary for cells in (8, 4))
    points = [one["support_forces"][0]["points"] for one in (fine, coarse)]
    force = [{point["point"]: np.linalg.norm(point["force_N"]) for point in one} for one in points]
    most = [max(one.values()) for one in force]
    ratio = {hook: max(a, force[1][hook]) / min(a, force[1][hook]) for hook, a in force[0].items()}
    name = max((hook for hook in ratio if max(one[hook] for one in force) > 0.02 * most[0]), key=ratio.__getitem__)
    assert ratio[name] > 1.2
    told, both = fine["single_forces_note"], [one[name] for one in force]
    assert f"{name} bears {both[0]:.3g} N, on cells twice as large {both[1]:.3g} N, {ratio[name]:.2g} times; " in told
    assert f"the largest force is {most[0]:.3g} N, there {most[1]:.3g} N" in told


@pytest.mark.slow
@pytest.mark.parametrize("angle", [30.0, -30.0])
def test_a_curtain_that_leans_says_how_far_and_to_which_side(angle):
    """The mean place of its lower end, beside that of its upper one."""
    scene = Scene(Rectangle(60.0, 120.0, weave_angle=angle), [macro_fem.Top(), Bar(mass=1.0, straight=False)], Mesh(4))
    answer = solve(scene)
    nodes, x = answer.solution.problem.disc.nodes, answer.solution.x[:, 0]

    def mean(y):
        row = np.flatnonzero(nodes[:, 1] == y)
        row = row[np.argsort(nodes[row, 0])]
        return np.trapezoid(x[row], nodes[row, 0]) / 60.0

    lean = mean(0.0) - mean(120.0)
    assert (abs(lean) > 5.0, lean < 0.0) == (True, angle > 0.0)
    assert answer.summary["lean_mm"] == pytest.approx(lean, rel=1e-9)
    words = f"lower end hangs {abs(lean):.3g} mm to the {'left' if lean < 0.0 else 'right'} of its upper one"
    assert words in lean_note(answer.summary)
    upright = solve(replace(scene, curtain=Rectangle(60.0, 120.0)))
    assert lean_note(upright.summary) is None


@pytest.mark.slow
def test_a_combination_scales_every_kind_of_load():
    items = [Corners(), EdgeLoad("bottom", (0.0, -0.1)), Wind((0.0, 0.0, 1.0), speed=10.0)]
    own = Combination("wind", edge=2.0, wind=1.5)
    scene = Scene(Rectangle(100.0, 80.0), items, mesh=Mesh(cells=4), combination=(own,))
    found = macro_fem.job.combined(scene, own)
    assert found.of(EdgeLoad)[0].force == (0.0, -0.2)
    assert found.of(Wind)[0].speed == pytest.approx(10.0 * math.sqrt(1.5))
    answer = solve(scene)
    drag = [found.summary["wind"] for found in (answer, answer.combinations[0][1])]
    assert drag[1][0]["drag_N"] / drag[0][0]["drag_N"] == pytest.approx(1.5, rel=0.05)  # on another shape
    assert [row["status"] for row in answer.summary["combinations"]] == ["converged"]
    with pytest.raises(InputError, match="every ring"):
        solve(hung(combination=(Combination("a"),)), macro_fem.EveryRing())


CURVES = {
    "power": (lambda v: (3.36 / v) ** 0.9, 3.36),
    "ends-off": (lambda v: 5.0 / (1.0 + v / 3.0), 12.0),
    "step": (lambda v: 1.3 if v < 37.7 else 0.7, 37.7),
    "no-answer": (lambda v: 1.3 if v < 0.21 else 0.0, 0.21),
    "window": (lambda v: min(v / 20.0, 50.0 / v), 50.0),
    "narrow": (
        lambda v: 1.05 * math.exp(-0.2 * math.log(v / 4.0) ** 2),
        4.0 * math.exp(math.sqrt(5.0 * math.log(1.05))),
    ),
}


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("name", CURVES)
def test_a_search_ends_at_the_value_wherever_it_lies_in_its_range(name, sign):
    """Factors over five powers of ten: the last that holds and the next enclose the crossing to 0.5 %."""
    factor, crossing = CURVES[name]
    tried = {}

    def use(values):
        tried.update({v: -math.log(factor(v**sign)) if factor(v**sign) else math.inf for v in values})
        return tried

    low, high = sorted((0.1**sign, 1e4**sign))
    span = Range(low, high, sign=sign)
    good, bad = search(use, span, span.first_round())
    assert min(good, bad) <= crossing**sign * (1 + 1e-12)
    assert max(good, bad) >= crossing**sign * (1 - 1e-12)
    assert (tried[good] <= 0.0 < tried[bad], max(good, bad) / min(good, bad) <= 1.005) == (True, True)
    assert len(tried) <= (15 if name in ("power", "ends-off", "window") else 30)


def test_a_search_among_pitches_ends_at_neighbours_and_one_without_a_crossing_at_an_end():
    grid = tuple(sorted(9800.0 / count for count in range(10, 200)))
    span = Range(50.0, 980.0, grid)
    asked = []

    def use_of(factor):
        def use(values):
            asked.extend(values)
            return {v: math.log(v / factor) for v in asked}

        return use

    good, bad = search(use_of(300.0), span, span.first_round())
    assert grid.index(bad) == grid.index(good) + 1
    assert good <= 300.0 < bad
    assert len(asked) < 12
    assert search(use_of(1e4), span, span.first_round()) == (980.0, None)
    assert search(use_of(1.0), span, span.first_round()) == (None, grid[0])


def test_a_search_follows_the_curve_of_a_coarser_mesh():
    """Whose factors are 8 % less, and fall less with the value: six answers instead of eight."""
    tried = {}

    def use(values):
        tried.update({v: 0.25 * math.log(v / 9.0) + 0.05 * math.log(v / 9.0) ** 2 - 0.08 for v in values})
        return tried

    guide = {v: 0.2 * math.log(v / 9.0) + 0.05 * math.log(v / 9.0) ** 2 for v in (1.0, 3.0, 9.0, 12.0, 30.0, 100.0)}
    good, bad = search(use, Range(1.0, 100.0), [9.0], guide=guide)
    assert (tried[good] <= 0.0 < tried[bad], bad <= 1.005 * good, len(tried) <= 6) == (True, True, True)


COMBINED = (
    HOOKS
    + """
combination = [{name = "light", bar = 0.5}, {name = "heavy", bar = 1.5}, {name = "mesh", weight = 1.35}]
"""
)


@pytest.mark.release
def test_a_size_is_what_runs_say_on_both_sides_and_goes_on_where_it_was(tmp_path, monkeypatch):
    """From 0.02 to 2000 kg; combinations that cannot govern are left out but at the value that holds."""
    (tmp_path / "scene.toml").write_text(COMBINED)
    words = [
        "size",
        tmp_path / "scene.toml",
        "--vary",
        "mass",
        "--from",
        "0.02",
        "--to",
        "2000",
        "--out",
        tmp_path / "o",
    ]
    done = run("macro_fem", *words, "--factor", "3")
    found = json.loads((tmp_path / "o" / "size.json").read_text())
    low, high = found["value"], found["next_value"]
    assert done.stdout.startswith(f"mass = {low:.6g} kg is the last that holds with a factor 3: ")
    assert (low < high <= 1.005 * low, found["governing_combination"]) == (True, "heavy")
    scene = macro_fem.load_scene(tmp_path / "scene.toml")
    runs = [solve(replace(scene, items=(scene.support[0], Bar(mass=mass)))).summary for mass in (low, high)]
    factors = [one["governing_factor"] for one in runs]
    assert factors == pytest.approx([found["factor"], found["next_factor"]], rel=1e-4)
    assert factors[0] >= 3.0 > factors[1]
    answers = [json.loads(one.read_text())["answer"] for one in (tmp_path / "o" / ".size").iterdir()]
    asked = [{one["governing_combination"] for one in answers if one["value"] == value} for value in (low, high)]
    assert asked == [{"light", "heavy", "mesh"}, {"heavy"}]
    assert len(pd.read_csv(tmp_path / "o" / "size.csv")) == len(found["curve"])

    solved = []
    monkeypatch.setattr("macro_fem.trials.answer_of", lambda *task: solved.append(task) or answer_of(*task))
    before = (tmp_path / "o" / "size.csv").read_bytes()
    run("macro_fem", *words, "--factor", "3")
    assert (solved, (tmp_path / "o" / "size.csv").read_bytes()) == ([], before)
    none = run("macro_fem", *words, "--factor", "1e6", codes=(2,))
    assert "no mass from 0.02 to 2000 holds with a factor 1e+06: the largest factor is" in none.output
    assert json.loads((tmp_path / "o" / "size.json").read_text())["value"] is None
    assert len(pd.read_csv(tmp_path / "o" / "size.csv")) >= 11
    assert (tmp_path / "o" / "size.png").exists()
    every = run("macro_fem", *words, "--factor", "1e-5").stdout
    assert every.startswith("mass = 2000 kg, the end of the range: all values up to 2000 hold with a factor 1e-05: 0.0")
    assert solved == []
    (tmp_path / "scene.toml").write_text(COMBINED.replace("252.9", "252.8"))
    run("macro_fem", *words, "--factor", "1e6", codes=(2,))
    assert len(solved) >= 11  # of another scene


@pytest.mark.release
def test_a_coarser_mesh_guides_and_processes_do_not_change_the_answer(tmp_path, monkeypatch):
    monkeypatch.setattr("macro_fem.size.LARGE", 12)
    monkeypatch.setattr("macro_fem.size.LEAST_COARSE", 3)
    scene = replace(hung(), mesh=Mesh(cells=12), combination=(Combination("a", bar=1.5), Combination("b", weight=1.5)))
    alone, both = (find_size(Sought(scene, None, "mass", 3.0), (0.1, 100.0), jobs=jobs) for jobs in (1, 2))
    assert alone == both
    assert {row.cells for row in alone.estimates} == {4}
    assert {row.cells for row in alone.curve} == {12}
    assert len(alone.curve) <= 6
    assert alone.value < alone.next_value <= 1.005 * alone.value
    plain = macro_fem.largest_that_holds(replace(scene, mesh=Mesh(cells=12)), None, "mass", (0.1, 100.0), 3.0)
    assert alone.value == pytest.approx(plain.value, rel=0.011)


@pytest.mark.slow
def test_a_pitch_finer_than_the_mesh_takes_more_cells():
    scene = Scene(Rectangle(330.0, 252.9), [Hooks(pitch=110.0)], mesh=Mesh(cells=3))
    found = macro_fem.largest_that_holds(scene, None, "pitch", (50.0, 110.0), 0.1)
    assert [row.status for row in found.curve] == ["converged"] * len(found.curve)
    assert (found.value, found.note) == (pytest.approx(110.0), None)
    law = fit(solve_table(Cell(), grid(15.0))).law
    with pytest.raises(InputError, match="factor 1: the strength of the rings is not known: the law was made without"):
        macro_fem.largest_that_holds(scene, law, "pitch", (100.0, 120.0), 1.0)  # said: converged
    scene = replace(scene, items=(Hooks(pitch=110.0, capacity=9.0),))
    assert "rve.with_rings" in macro_fem.largest_that_holds(scene, law, "pitch", (100.0, 120.0), 0.1).note
    notched = Outline([(0, 0), (200, 0), (200, 150), (150, 150), (150, 120), (50, 120), (50, 150), (0, 150)])
    two_lines = Scene(notched, [Hooks(pitch=50.0, capacity=1.0)], mesh=Mesh(cells=8))
    assert macro_fem.largest_that_holds(two_lines, None, "pitch", (20.0, 50.0), 3.4).value == 25.0


@pytest.mark.release
def test_a_wire_is_sized_with_the_law_of_its_table():
    cell = Cell(r2=0.5)
    found = macro_fem.largest_that_holds(hung(), macro_fem.OnDemand(cell), "r2", (0.5, 0.8), 0.1)
    told = solve(hung(), fit(with_rings(solve_table(cell), cell)).law).summary
    assert (found.value, found.factor) == (0.5, pytest.approx(told["weakest_factor"], rel=1e-9))


@pytest.mark.slow
def test_the_largest_pitch_divides_the_edge_and_the_next_one_does_not_hold(tmp_path):
    (tmp_path / "scene.toml").write_text(HOOKS)
    asked = ["--vary", "pitch", "--from", "60", "--to", "330", "--factor", "0.9", "--out", str(tmp_path / "o")]
    done = CliRunner().invoke(main, ["size", str(tmp_path / "scene.toml"), *asked])
    assert done.exit_code == 0, done.output
    assert done.stdout.startswith("pitch = ")
    found = json.loads((tmp_path / "o" / "size.json").read_text())
    assert 330.0 / found["value"] == pytest.approx(round(330.0 / found["value"]))
    assert found["factor"] >= 0.9
    curve = {row["value"]: row["factor"] for row in found["curve"]}
    assert all(factor < 0.9 for value, factor in curve.items() if value > found["value"])
    assert (tmp_path / "o" / "size.png").exists()
    assert pd.read_csv(tmp_path / "o" / "size.csv")["pitch_mm"].tolist() == pytest.approx(list(curve), rel=1e-15)
    pitch = replace(hung(), items=(Hooks(pitch=found["value"]), Bar(mass=2.0)))
    assert solve(pitch).safety_factor == pytest.approx(found["safety_factor"], rel=1e-9)


@pytest.mark.slow
def test_rings_as_stl_are_closed_and_have_the_volume_of_their_wire(tmp_path):
    import meshio

    rings = solve(Scene(Rectangle(60.0, 50.0), [Corners()], mesh=Mesh(cells=3))).rings()
    rings.save(tmp_path, picture=False, solids="stl")
    read = meshio.read(tmp_path / "rings.stl")
    a, b, c = np.moveaxis(read.points[read.cells_dict["triangle"]].astype(float), 1, 0)
    volume = np.einsum("ij,ij->", a - a.mean(axis=0), np.cross(b - a.mean(axis=0), c - a.mean(axis=0))) / 6.0
    # The centre line is a polygon of 48 sides and the section one of 16: 2.9 % less than a torus.
    parts = (48 / math.pi * math.sin(math.pi / 48) * math.cos(math.pi / 48)) * (8 / math.pi * math.sin(math.pi / 8))
    rings.save(tmp_path, picture=False, solids="glb")
    again = trimesh.load_scene(tmp_path / "rings.glb")
    assert len(again.graph.nodes_geometry) == len(rings)
    assert 1e9 * again.to_mesh().volume == pytest.approx(volume, rel=1e-4)
    assert not (tmp_path / "rings.stl").exists()
    assert volume == pytest.approx(len(rings) * 2.0 * math.pi**2 * 5.0 * 0.5**2 * parts, rel=5e-3)


def test_loads_are_told_in_words():
    wind = "wind of 8 m/s along (0, 0, 1) that follows the surface"
    loads = f"bar of 2 kg on bottom, {wind}, (0, -9) N at (50, 40) (radius 8 mm), (0.5, 0) N/mm on left"
    thrust = macro_fem.PatchLoad((50.0, 40.0), 8.0, (0.0, -9.0))
    blown = hung(EdgeLoad("left", (0.5, 0.0)), Wind((0.0, 0.0, 1.0), speed=8.0, follows=True), thrust)
    told = [loads_in_words(one) for one in (blown, replace(blown, load=Load(gravity=0.0)))]
    assert told == [f"weight, {loads}", loads]
