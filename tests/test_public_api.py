"""What a user meets in a notebook: the public roots from rings to a curtain, and what they return and refuse."""

import copy
import dataclasses
import json
import re
import subprocess
import sys
import tomllib
from multiprocessing.reduction import ForkingPickler
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import sparse

import homogenize
import macro_fem
import macro_fem.ring_summary
import macro_fem.summary
import rve
from rve.finite import FiniteOptions, HalfSpace, RoundBody, cell_of_sides, ring_places, slack_rings, step_rings
from rve.placed import cell_forces, fit_rings, locked_arrangements, nearest_poses

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def table():
    return rve.solve_table(rve.Cell(r1=5, r2=0.5), rve.grid(15.0))


@pytest.fixture(scope="module")
def answer(table):
    scene = macro_fem.Scene(macro_fem.Rectangle(200, 150), [macro_fem.Corners(gather=0.9)], macro_fem.Mesh(cells=8))
    return macro_fem.solve(scene, homogenize.fit(table).law)


@pytest.mark.slow
def test_the_table_is_that_of_the_command_line(table, tmp_path):
    frame = table.to_pandas()
    table.save(tmp_path / "table.csv")
    # Before version 3 pandas reads some numbers one unit of the last digit off.
    read = pd.read_csv(tmp_path / "table.csv")
    pd.testing.assert_frame_equal(frame, read, check_dtype=False, rtol=1e-15, atol=0.0)
    assert len(frame) == 28
    assert frame.attrs["r2_mm"] == 0.5
    equibiaxial = frame[(frame.alpha_deg == 15) & (frame.beta_deg == 45)].iloc[0]
    assert equibiaxial.x2_x_mm == pytest.approx(13.1163049, abs=2e-7)
    assert equibiaxial.x3_y_mm == pytest.approx(11.2301635, abs=2e-7)


def test_the_answer_balances_its_weight(answer, tmp_path):
    """Two corners carry the weight of the mesh, half each; the files say what the summary says."""
    assert answer.status == "converged"
    summary = answer.summary
    weight = summary.mass_kg * 9.81
    assert summary.mass_kg == pytest.approx(summary.areal_mass_kg_per_m2 * 0.2 * 0.15, rel=1e-9)
    points = [point for support in summary.support_forces for point in support.points]
    assert [point.at_mm for point in points] == [[0.0, 150.0], [200.0, 150.0]]
    assert [point.force_N[1] for point in points] == pytest.approx([0.5 * weight] * 2, rel=1e-6)
    answer.save(tmp_path / "out", picture=False)
    saved = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert saved.pop("files").keys() == {"curtain.vtu", "support_forces.csv", "order.csv"}
    assert saved == summary.to_dict() == dict(summary)
    assert saved["support_forces"][0]["points"][0]["force_N"] == points[0].force_N


def test_attributes_of_a_summary_are_the_keys_of_the_page():
    """And a key is left out only where nothing is behind it, not where what is behind it is not known."""
    text = (ROOT / "docs" / "reference" / "files.md").read_text()
    page = set(re.findall(r"`([A-Za-z_][A-Za-z_0-9]*)`", text))
    records = [one for one in vars(macro_fem.summary).values() if isinstance(one, type)]
    records += [one for one in vars(macro_fem.ring_summary).values() if isinstance(one, type)]
    names = {field.name for one in records if dataclasses.is_dataclass(one) for field in dataclasses.fields(one)}
    assert len(names) > 120
    assert names <= page
    interval = macro_fem.summary.Bounds(mean_height_interval_mm=[1.0, 2.0], mesh_part_mm=1.0)
    assert interval.to_dict() == {"mean_height_interval_mm": [1.0, 2.0], "law_part_mm": None, "mesh_part_mm": 1.0}


def records_in(value):
    """Every record in a value, with those in its fields."""
    if isinstance(value, list | tuple):
        return [one for part in value for one in records_in(part)]
    if not dataclasses.is_dataclass(value):
        return []
    return [value, *records_in([getattr(value, item.name) for item in dataclasses.fields(value)])]


def assert_same(a, b):
    """Fields of records and arrays are equal to the bit."""
    assert type(a) is type(b)
    if dataclasses.is_dataclass(a):
        for item in dataclasses.fields(a):
            assert_same(getattr(a, item.name), getattr(b, item.name))
    elif isinstance(a, list | tuple):
        for one, other in zip(a, b, strict=True):
            assert_same(one, other)
    elif sparse.issparse(a):
        assert (a != b).nnz == 0
    elif not callable(a):
        np.testing.assert_equal(a, b)


def sent(noun):
    """A record as a worker process gets it, pickled."""
    return ForkingPickler.loads(ForkingPickler.dumps(noun))


@pytest.fixture(scope="module")
def nouns(table, answer, tmp_path_factory):
    """Every public record, after it was used."""
    out = tmp_path_factory.mktemp("nouns")
    answer.save(out, picture=False)
    cell, law, E = rve.Cell(), homogenize.default_law().elastic(), np.array([[0.1, 0.0, 0.1]])
    vars(law)["strength"].utilisation(E)
    scene = macro_fem.Scene(macro_fem.Rectangle(66, 63), [macro_fem.Hooks(pitch=66)], macro_fem.Mesh(4))
    every = macro_fem.solve(scene, macro_fem.EveryRing(cell))
    still, n = slack_rings(every.found.mesh), len(every.found.centre)
    at_rest = ring_places(still), np.zeros((n, 3)), np.zeros((n, 3), bool), still.centre
    drawn = [still.drawn, step_rings(still, np.ones(2 * n), *at_rest)]
    of_rings = [rve.SimulationOptions(), rve.LoadHistory([0.0], [0.0], [45.0], [1.0])]
    of_rings += [rve.DirectOptions(), FiniteOptions(), RoundBody((0.0, 0.0, -50.0), 5.0, 1.0, "ball")]
    of_rings += [rve.support(cell, [0.5, 0.0, 0.5]), rve.pulled_ring(5.0, 0.5), cell_forces(E[0] + 1.0, cell)]
    of_rings += [
        rve.Piece.cut(cell, (40, 40)),
        HalfSpace((0.0, 1.0, 0.0), -99.0),
        locked_arrangements(cell),
        nearest_poses(E, cell),
    ]
    laws = [law, law.half_spaces(), law.cut(E), law.response(E), homogenize.ClothLaw(), homogenize.diagonal_net()]
    laws += [homogenize.FitOptions(), homogenize.read_law_interval(), homogenize.locked_strain(law, [20.0], [30.0])]
    at, kinds = [0.0, 0.0, 0.0], macro_fem
    scenes = [kinds.Disk(5), kinds.Outline([[0, 0], [1, 0], [1, 1]]), kinds.MeshFile("a.msh"), kinds.Rail()]
    scenes += [kinds.Edge("left", along=[[0, 0], [0, 9]]), kinds.Point([0, 0]), kinds.Top(), kinds.Track(fullness=1.2)]
    scenes += [kinds.EdgeLoad("top", [0, 1]), kinds.PointLoad([0, 0], [0, 1]), kinds.PatchLoad([0, 0], 9, [0, 1])]
    scenes += [
        kinds.Wind([0, 1], speed=5),
        kinds.Bar(2),
        kinds.Combination("a", bar=1.5),
        kinds.Floor(),
        kinds.Start(at),
    ]
    scenes += [kinds.Wall([1, 0]), kinds.Sphere(at, 9), kinds.Cylinder([0, 0, 1], 9), kinds.Box(at, [9, 9, 9])]
    scenes += [kinds.Motion(1.0), kinds.Ball(9, 1, at), kinds.OnDemand(cell), kinds.EveryRing(cell)]
    size = macro_fem.largest_that_holds(scene, None, "pitch", (33.0, 66.0), 0.1)
    ways = [homogenize.fit(table), fit_rings(np.zeros((1, 3), int), np.zeros((1, 3)), np.eye(3)[2:], cell)]
    answers = [table, answer, answer.rings(), every, size, macro_fem.read_curtain(out)]
    return records_in([of_rings, laws, scenes, drawn, ways, answers])


@pytest.mark.slow
def test_every_public_record_is_copied_pickled_and_replaced_as_it_is(nouns):
    """Equal to the record where records of its kind are equal by their fields, and to be used as it is."""
    by_kind = {type(noun): noun for noun in nouns}
    names = [getattr(package, name) for package in (rve, homogenize, macro_fem) for name in package.__all__]
    public = {kind for kind in names if isinstance(kind, type) and dataclasses.is_dataclass(kind)}
    public -= {homogenize.Law, macro_fem.Load, macro_fem.Support}  # bases, of which there are no records
    assert public <= by_kind.keys()
    for kind in public:
        noun = by_kind[kind]
        ways = (copy.copy, copy.deepcopy, dataclasses.replace, sent)
        for again in (way(noun) for way in ways):
            assert_same(noun, again)
            assert_same(noun, dataclasses.replace(again))
            assert str(again) == str(noun)
            if kind.__eq__ is not object.__eq__:
                assert again == noun


SCENE = macro_fem.Scene(macro_fem.Rectangle(100, 100), [macro_fem.Top()])
PIECE = rve.FiniteMesh.rectangle(rve.Cell(), 1, 1)
REFUSED = [
    (lambda: rve.solve_table({"r1": 5}), "expected Cell, got a dict"),
    (lambda: rve.solve_table(rve.Cell), "got the class Cell; Cell(r1, r2) makes one"),
    (lambda: rve.solve_table(rve.Cell(), 5), "loads = 5: expected a list of 2"),
    (lambda: rve.solve_table(rve.Cell(), ([0.0], ["a"])), "alpha and beta must be numbers"),
    (lambda: rve.solve_table(rve.Cell(), ([0.0], [90.0]), {"branches": "first"}), "expected DirectOptions, got a dict"),
    (lambda: rve.support(None, [1, 0, 1]), "cell = None: expected Cell"),
    (lambda: rve.support(rve.Cell(), None), "S = None: expected a list"),
    (lambda: rve.with_rings("table.csv", rve.Cell()), "expected StrainTable, got a text; read_table reads a file"),
    (lambda: rve.grid("5"), "step = '5': expected a number"),
    (lambda: rve.read_table({}), "a file is read by its path, not from {}"),
    (lambda: rve.write_table(None, "x.csv"), "table = None: expected StrainTable"),
    (lambda: rve.Cell(r1="5 mm"), "r1 = '5 mm': expected a number, got a text; write the number alone, in mm: 5"),
    (lambda: rve.Cell(material={"density": 5.0}), "is no Material, nor the name of one"),
    (lambda: rve.Cell(weave="4in1"), "kings-4-in-1, FILE.toml; did you mean 4-in-1?"),
    (lambda: rve.Piece.cut(rve.Cell(), 40), "size = 40: expected a list of 2, got a whole number"),
    (lambda: rve.Piece.cut(rve.Cell(), (40, 40)).save("a.obj"), "give a name that ends in .3mf or .glb or .stl"),
    (lambda: rve.named_material("titanium"), "did you mean titanium grade"),
    (lambda: rve.pulled_ring(5, 0.5, "steel"), "material = 'steel': expected Material"),
    (lambda: FiniteOptions(tolerance=float("nan")), "FiniteOptions: tolerance = nan: expected a number > 0.0"),
    (lambda: FiniteOptions(tolerance=0), "tolerance = 0: expected a number > 0.0"),
    (lambda: FiniteOptions(tolerance=-1e-8), "expected a number > 0.0"),
    (lambda: FiniteOptions(reach=float("inf")), "reach = inf: expected a number <= 1.0"),
    (lambda: FiniteOptions(max_iterations=2.5), "max_iterations = 2.5: expected a whole number, got a number"),
    (lambda: FiniteOptions(patience=0), "patience = 0: expected a whole number >= 1"),
    (lambda: FiniteOptions(starts=0), "starts = 0: expected a whole number >= 1"),
    (lambda: FiniteOptions(seed=-1), "seed = -1: expected a whole number >= 0"),
    (lambda: FiniteOptions(first=1e-9, last=1e-3), "last = 0.001: is more than first = 1e-09"),
    (lambda: rve.DirectOptions(tolerance="small"), "tolerance = 'small': expected a number, got a text"),
    (
        lambda: homogenize.fit("table.csv"),
        "table = 'table.csv': expected StrainTable or DataFrame, got a text; read_table reads a file",
    ),
    (lambda: rve.FiniteMesh.rectangle(None, 1, 1), "rectangle: cell = None: expected Cell"),
    (lambda: rve.FiniteMesh.inside(rve.Cell(), "square"), "outline = 'square': expected a list"),
    (lambda: PIECE.solve(PIECE.X, PIECE.X > 9, PIECE.X, options={"starts": 3}), "options = {'starts': 3}: expected"),
    (lambda: cell_of_sides(5.0, 0.5, 11.0), "sides = 11.0: expected a list of 2"),
    (lambda: rve.solve_table(rve.Cell(), [1, 2, 3]), "loads = [1, 2, 3]: expected a list of 2, got a list of 3"),
    (lambda: rve.Cell(0.5, 5), "r1/r2 = 0.1000; r1 is the radius of the ring, r2 that of the wire"),
    (lambda: homogenize.default_law().support(np.ones(3)), "line loads are of the shape (3,), not (n, 3)"),
    (lambda: homogenize.fit([1]), "expected StrainTable or DataFrame, got a list"),
    (lambda: homogenize.fit_table(None), "path = None: expected a text or a path"),
    (lambda: homogenize.FitOptions(kind="Net"), "did you mean net?"),
    (lambda: homogenize.load_law(5), "a file is read by its path, not from 5"),
    (lambda: homogenize.default_law().save(None), "path = None: expected a text or a path"),
    (lambda: homogenize.elastic_law("law.json"), "law = 'law.json': expected MembraneLaw"),
    (lambda: homogenize.with_material(homogenize.default_law(), "steel"), "given = 'steel': expected a dict"),
    (lambda: homogenize.locked_strain(homogenize.default_law(), [20.0], None), "beta_deg = None: expected a list"),
    (
        lambda: macro_fem.solve({"curtain": {}}),
        "expected Scene, got a dict; load_scene reads a file, read_scene a dict",
    ),
    (lambda: macro_fem.solve(None), "scene = None: expected Scene"),
    (lambda: macro_fem.solve(SCENE, "law.json"), "who = 'law.json': expected MembraneLaw or LawInterval"),
    (lambda: macro_fem.solve(SCENE, rve.Cell()), "solve takes a law, OnDemand(cell) or EveryRing(cell), not a Cell"),
    (lambda: macro_fem.compare(SCENE, start="disc"), "start = 'disc': expected 'slack' or 'disk'"),
    (lambda: macro_fem.localize(5), "curtain = 5: expected Curtain or a text or a path"),
    (lambda: macro_fem.load_scene(SCENE), "a file is read by its path, not from Scene("),
    (lambda: macro_fem.read_scene("scene.toml"), "scene: is not a table of names and values"),
    (lambda: macro_fem.largest_that_holds(SCENE, None, "pitch", 5, 1.5), "ends = 5: expected a list of 2"),
    (lambda: macro_fem.largest_that_holds(SCENE, None, "pithc", (5, 9), 1.5), "did you mean pitch?"),
    (lambda: macro_fem.Scene({"width": 5}), "expected Shape, got a dict"),
    (lambda: macro_fem.Scene(SCENE.curtain, macro_fem.Top()), "is no list of supports, loads and obstacles"),
    (lambda: macro_fem.Scene(SCENE.curtain, [], mesh={"cells": 4}), "expected Mesh, got a dict"),
    (lambda: macro_fem.Scene(SCENE.curtain, [], combination=[{"name": "a"}]), "expected a list, each Combination"),
    (lambda: macro_fem.Scene(SCENE.curtain, [], material="steel"), "material = 'steel': is no dict"),
    (lambda: macro_fem.EveryRing("law.json"), "rings = 'law.json': expected Cell or MembraneLaw"),
    (lambda: macro_fem.EveryRing(start="disc"), "start = 'disc': expected 'slack' or 'disk'"),
    (lambda: macro_fem.OnDemand({"r1": 5}), "expected Cell, got a dict"),
]


@pytest.mark.parametrize(("call", "sentence"), REFUSED, ids=[sentence for _, sentence in REFUSED])
def test_what_no_function_takes_is_one_sentence(call, sentence):
    with pytest.raises(rve.InputError, match=re.escape(sentence)) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_arguments_that_are_missing_are_told_by_python():
    with pytest.raises(TypeError, match=r"solve\(\) missing 1 required positional argument: 'scene'"):
        macro_fem.solve()


@pytest.fixture(scope="module")
def rings(answer):
    return answer.rings()


@pytest.mark.slow
def test_rings_of_an_answer_are_those_of_its_files(answer, rings, tmp_path):
    answer.save(tmp_path / "curtain", picture=False)
    summary = rings.save(tmp_path / "rings", picture=False)
    read = macro_fem.localize(tmp_path / "curtain")
    np.testing.assert_allclose(read.centre_mm, rings.centre_mm, atol=1e-9)
    np.testing.assert_allclose(read.contact_force_N, rings.contact_force_N, rtol=1e-9)
    np.testing.assert_array_equal(read.status, rings.status)
    saved = json.loads((tmp_path / "rings" / "localize.json").read_text())
    assert saved["files"].keys() == {"rings.vtu", "worst_cell.csv"}
    assert saved["rings"] == summary["rings"] == len(rings) == pytest.approx(400.0 * 150.0 / (11.0 * 12.646), rel=0.05)
    assert saved["curtain"] == "a curtain in memory"
    assert saved["r2_mm"] == 0.5
    assert read.summary["curtain"] == str(tmp_path / "curtain" / "curtain.vtu")


@pytest.mark.slow
def test_the_lines_of_the_readme_run_in_an_interpreter_of_their_own():
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    done = subprocess.run([sys.executable, "-c", block], cwd=ROOT, capture_output=True, text=True, check=True)
    assert float(done.stdout) == pytest.approx(420.26, abs=0.05)  # 3,584 cells: docs/reports/numbers.md


@pytest.fixture
def executed(tmp_path, monkeypatch):
    """The outputs of a notebook of examples/, run in a kernel of its own."""
    import nbformat
    from nbclient import NotebookClient

    for name in ("JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR", "IPYTHONDIR", "MPLCONFIGDIR"):
        monkeypatch.setenv(name, str(tmp_path))
    monkeypatch.delenv("MPLBACKEND", raising=False)  # the kernel draws inline

    def run(name):
        page = nbformat.read(ROOT / "examples" / name, as_version=4)
        assert not any(cell.get("outputs") for cell in page.cells)  # results are made anew, not stored
        done = NotebookClient(page, timeout=300, resources={"metadata": {"path": str(ROOT)}}).execute()
        return [output for cell in done.cells for output in cell.get("outputs", ())]

    return run


def data_of(outputs):
    return [output.data for output in outputs if "data" in output]


@pytest.mark.release
def test_the_notebook_runs(answer, rings, executed):
    found = data_of(executed("five_lines.ipynb"))
    assert sum("image/png" in data for data in found) == 3  # law, curtain, rings
    shown = "".join(data.get("text/html", data["text/plain"]) for data in found)
    assert str(answer) in shown
    assert str(rings) in shown


@pytest.mark.release
def test_the_curtain_of_titanium_hangs_from_its_hooks(executed):
    outputs = executed("own_curtain.ipynb")
    text = "".join(output.get("text", "") for output in outputs)
    hooks, weight = map(float, re.search(r"all hooks ([\d.]+) N, weight ([\d.]+) N", text).groups())
    assert hooks == pytest.approx(weight, abs=0.02)
    mesh, bar = map(float, re.search(r"mesh ([\d.]+) kg, bar ([\d.]+) kg", text).groups())
    assert (bar, mesh + bar) == (12.0, pytest.approx(weight / 9.81, abs=0.06))
    found = data_of(outputs)
    assert sum("image/png" in data for data in found) == 2  # line loads, utilisation
    assert any("safety_factor" in data["text/plain"] and "titanium grade 2" in data["text/plain"] for data in found)


@pytest.mark.slow
def test_the_notebook_of_the_law_shows_both_weaves(executed):
    found = data_of(executed("law.ipynb"))
    assert sum("image/png" in data for data in found) == 3  # locking surface, strength, weaves
    (table,) = [data["text/plain"] for data in found if "kg/m2" in data["text/plain"]]
    assert {"4-in-1", "6-in-1"} <= set(table.split())


def test_an_entry_that_a_summary_has_not_says_why(answer):
    with pytest.raises(KeyError, match="safety is no entry; did you mean safety_factor"):
        answer.summary["safety"]
    with pytest.raises(KeyError, match="limit_factor is left out here"):
        answer.summary["limit_factor"]
    assert answer.summary.get("safety") is None


def test_records_show_themselves_in_a_notebook(answer, table):
    assert "converged" in repr(table)
    assert "converged" in repr(answer)
    judged = macro_fem.solve(macro_fem.Scene(SCENE.curtain, [macro_fem.Corners(gather=0.9)], macro_fem.Mesh(cells=4)))
    assert re.search(r"converged, mean height [\d.]+ mm, holds, factor [\d.]+$", repr(judged))
    assert "converged" in repr(rve.support(rve.Cell(), [0.5, 0.0, 0.5]))
    law = homogenize.default_law()
    assert repr(law) == str(law)  # 527 lines of arrays in a console


def test_a_scene_of_nouns_is_that_of_a_file():
    built = macro_fem.Scene(
        macro_fem.Rectangle(400, 300, weave_angle=45),
        [
            macro_fem.Top(gather=0.9),
            macro_fem.PointLoad([200, 0], [0, -1]),
            macro_fem.EdgeLoad("bottom", [0.001, 0]),
            macro_fem.Bar(0.5, straight=False),
            macro_fem.Wind([1, 0], pressure=10),
            macro_fem.Floor(-200),
        ],
        macro_fem.Mesh(8, "P2"),
        macro_fem.Load(5, steps=2),
        macro_fem.Solver(tolerance=1e-8),
        material={"density": 4510},
    )
    written = """
        curtain = {width = 400.0, height = 300.0, weave_angle = 45.0}
        mesh = {cells = 8, element = "P2"}
        support = {kind = "top", gather = 0.9}
        load.gravity = 5.0
        load.steps = 2
        load.point = {at = [200.0, 0.0], force = [0.0, -1.0]}
        load.edge = {edge = "bottom", force = [0.001, 0.0]}
        load.bar = {mass = 0.5, straight = false}
        load.wind = {direction = [1.0, 0.0], pressure = 10.0}
        obstacle = {kind = "floor", height = -200.0}
        solver.tolerance = 1e-8
        material.density = 4510.0
    """
    read = macro_fem.read_scene(tomllib.loads(written))
    assert sorted(map(repr, built.items)) == sorted(map(repr, read.items))
    assert dataclasses.replace(built, items=()) == dataclasses.replace(read, items=())
