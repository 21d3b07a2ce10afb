"""Own laws, supports, loads and materials: the examples by the command line, against closed forms."""

import json
import sys
from collections.abc import Iterator, MutableMapping
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import homogenize
import macro_fem
import rve
from homogenize.laws import highest, outer_vertices
from macro_fem.output import loads_in_words
from macro_fem.output.plans import draw_sheet
from macro_fem.size import find_size
from macro_fem.trials import Sought
from rve.common import load_installed, load_plugin
from rve.common.files import PLUGINS
from rve.common.plugins import forget_plugins
from tests.commands import cluster_that_loses_a_worker, run

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
SCENE = """
[curtain]
width = 600.0
height = 400.0
areal_mass = 0.9
[mesh]
cells = 6
[support]
kind = "rope"
sag = 40.0
gather = 0.9
"""


@pytest.fixture(scope="module", autouse=True)
def examples() -> Iterator[None]:
    """All examples of plugins are loaded; afterwards other tests know nothing of these and of the plugins below."""
    known: list[MutableMapping[Any, Any]] = [
        homogenize.Law.kinds,
        macro_fem.Support.kinds,
        macro_fem.Load.kinds,
        rve.MATERIALS,
        PLUGINS,
    ]
    before = [dict(one) for one in known]
    for path in EXAMPLES.glob("own_*.py"):
        load_plugin(path)
    yield
    for one, was in zip(known, before, strict=True):
        one.clear()
        one.update(was)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A scene on a rope, and a law file written by hand."""
    (tmp_path / "scene.toml").write_text(SCENE)
    law = {"kind": "woven", "parameters": {"warp": 1.02, "weft": 1.08}, "plugin": "own_law.py"}
    (tmp_path / "law.json").write_text(json.dumps(law))
    return tmp_path


def woven(**parameters: float) -> homogenize.Law:
    return homogenize.Law.kinds["woven"](**parameters)


def test_an_own_law_has_the_support_of_its_half_spaces() -> None:
    """And the file tells its parameters, its mass and its plugin."""
    law = woven(warp=1.02, weft=1.08, areal_mass_kg_per_m2=0.9)
    S = np.array([[1.0, 0.0, 0.0], [0.5, 0.3, 0.5], [0.2, -0.4, 0.8]])
    start = law.half_spaces()
    assert law.support(S) == pytest.approx(highest(S, outer_vertices(start.S, start.h)), abs=1e-4)
    cut = law.cut(np.array([[0.05, 0.3, 0.0], [0.0, 0.0, 0.1]]))
    assert cut.S.tolist() == [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    assert cut.violation == pytest.approx([0.05 - 0.0202, 0.1 - 0.0832], abs=1e-12)
    assert pytest.approx(np.array([[5.0, 0.0, 0.0]]), abs=1e-9) == law.response(np.array([[0.0302, 0.0, 0.0]])).S


def test_an_own_law_goes_through_its_file(tmp_path: Path) -> None:
    woven(warp=1.02, weft=1.08, areal_mass_kg_per_m2=0.9).save(tmp_path / "law.json")
    record = json.loads((tmp_path / "law.json").read_text())
    assert (record["kind"], record["plugin"]) == ("woven", "own_law.py")
    assert record["parameters"] == {"warp": 1.02, "weft": 1.08, "stiffness": 500.0}
    again = homogenize.load_law(tmp_path / "law.json")
    assert (type(again).__name__, again.areal_mass_kg_per_m2) == ("WovenLaw", 0.9)
    for change, sentence in (
        ({"parameters": {"warp": 1.02}}, "parameters weft: is missing"),
        ({"parameters": {"warp": 1.02, "weft": 1.0, "slack": 1}}, "parameters slack = 1: unknown key"),
        ({"kind": "knitted"}, "is of the plugin own_law.py, which is not loaded; give --plugin own_law.py"),
    ):
        (tmp_path / "bad.json").write_text(json.dumps(record | change))
        with pytest.raises(rve.InputError, match=sentence):
            homogenize.load_law(tmp_path / "bad.json")


def test_a_curtain_of_an_own_law_on_an_own_support(folder: Path) -> None:
    """Its top edge lies on the parabola, and its supports bear its weight."""
    out = folder / "out"
    words = ["--law", folder / "law.json", "--plugin", EXAMPLES / "own_law.py", "--out", out, "--no-picture"]
    run("macro_fem", "run", folder / "scene.toml", "--plugin", EXAMPLES / "own_support.py", *words)
    summary = json.loads((out / "summary.json").read_text())
    assert summary["law"] == "woven"
    assert {"plugin own_law.py", "plugin own_support.py"} <= summary["versions"].keys()
    (rope,) = summary["support_forces"]
    assert rope["force_N"][1] == pytest.approx(0.9 * 0.24 * 9.81, rel=1e-6)
    place = np.array([point["place_mm"] for point in rope["points"]])
    assert place[:, 1] == pytest.approx(400.0 - 160.0 * (x := (place[:, 0] - 30.0) / 540.0) * (1.0 - x), abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_workers_of_a_sweep_load_plugins(folder: Path, jobs: int) -> None:
    (folder / "other.toml").write_text(SCENE.replace("40.0", "20.0"))
    words = ["--law", folder / "law.json", "--no-picture", "--out", folder / "all", "--jobs", jobs]
    words += [f"--plugin={EXAMPLES / name}" for name in ("own_law.py", "own_support.py")]
    done = run("macro_fem", "sweep", folder / "scene.toml", folder / "other.toml", *words)
    assert "2 of 2 done" in done.output


@pytest.mark.slow
def test_a_search_on_a_cluster_that_loses_a_worker_is_that_of_this_machine(folder: Path) -> None:
    """With plugins that its workers have not seen."""
    hooks = SCENE.replace('kind = "rope"\nsag = 40.0\n', 'kind = "hooks"\npitch = 100.0\ncapacity = 20.0\n')
    (folder / "hung.toml").write_text(hooks)
    load_plugin(EXAMPLES / "own_law.py")
    law = homogenize.load_law(folder / "law.json")
    sought, ends = Sought(macro_fem.load_scene(folder / "hung.toml"), law, "pitch", 2.0), (100.0, 300.0)
    with cluster_that_loses_a_worker(" left; ") as address:
        there = find_size(sought, ends, cluster=address)
    assert there == find_size(sought, ends)


@pytest.mark.slow
def test_where_an_own_law_leaves_the_strength_open_every_verdict_says_so(folder: Path) -> None:
    """A law without rings has none to make a table of."""
    hooks = SCENE.replace('kind = "rope"\nsag = 40.0\n', 'kind = "hooks"\npitch = 100.0\ncapacity = 20.0\n')
    (folder / "still.toml").write_text(hooks)
    (folder / "moved.toml").write_text(hooks + "[motion]\nduration = 0.01\nstep = 0.01\n")
    words = ["--law", folder / "law.json", "--plugin", EXAMPLES / "own_law.py"]
    ends = ["--vary", "pitch", "--from", 100, "--to", 300, "--factor", 2]
    sized = run("macro_fem", "size", folder / "still.toml", *words, *ends)
    both = folder / "still.toml", folder / "moved.toml"
    compared = run("macro_fem", "compare-designs", *both, *words, "--no-picture", "--out", folder / "all")
    assert "rve table" not in sized.output + compared.output
    note = "the strength of the mesh is not known: the law has no rings that bear the loads"
    assert [text.count(note) for text in (sized.output, compared.output)] == [1, 2]
    assert "still: holds, factor of at most" in compared.output


@pytest.mark.slow
def test_an_own_load_is_integrated_and_scaled(folder: Path) -> None:
    """p at the hem that fades to 0 at half the height: p b h / 4, times the factor of a combination."""
    data: dict[str, Any] = {
        "curtain": {"width": 600.0, "height": 400.0},
        "mesh": {"cells": 6},
        "support": {"kind": "top"},
    }
    data["load"] = {"gravity": 0.0, "dirt": {"pressure": 40.0, "height": 200.0}}
    data |= {"combination": [{"name": "wet", "dirt": 1.5}], "material": {"material": "wire of my mill"}}
    answer = macro_fem.solve(macro_fem.read_scene(data))
    whole = 40.0 * 0.6 * 0.1
    hung = -answer.summary.total_load_N[1]
    assert hung == pytest.approx(whole, rel=0.02)  # of the middles of cells
    assert answer.summary.combinations is not None
    (wet,) = answer.summary.combinations
    assert wet.factors["dirt"] == 1.5
    assert answer.summary.envelope is not None
    assert answer.summary.envelope.support_sums[0].force_N == pytest.approx(
        -1.5 * answer.summary.total_load_N[1], rel=1e-6
    )
    assert answer.summary.ring_material == "wire of my mill"
    assert loads_in_words(answer.scene) == "dirt (pressure = 40.0, height = 200.0)"
    texts = [one.get_text() for one in draw_sheet(answer.solution, 160.0, 160.0).axes[0].texts]
    assert f"dirt {hung:.4g} N" in texts


@pytest.mark.slow
def test_a_number_in_a_table_of_a_plugin_is_sized() -> None:
    """Of a curtain without weight the factor is inverse to the only load, but for the stretch of elastic rings."""
    data: dict[str, Any] = {"curtain": {"width": 60.0, "height": 40.0}, "mesh": {"cells": 2}}
    data["support"], data["load"] = {"kind": "top"}, {"gravity": 0.0, "dirt": {"pressure": 1.0, "height": 40.0}}
    scene = macro_fem.read_scene(data)
    size = macro_fem.largest_that_holds(scene, None, "pressure", (1e3, 1e6), 4.0)
    first = size.curve[0]
    assert size.value == pytest.approx(first.value * (first.factor or 0.0) / 4.0, rel=0.02)
    assert str(size).startswith(f"pressure = {size.value:.6g} is the last that holds with a factor 4: ")
    with pytest.raises(rve.InputError, match="is not one of pitch, mass, speed, r2, height, pressure; did you mean pr"):
        macro_fem.largest_that_holds(scene, None, "presure", (1e3, 1e6), 4.0)


def test_the_command_that_is_told_next_has_the_plugins(tmp_path: Path) -> None:
    table, plugin = Path(__file__).parent / "test_homogenize" / "data" / "table190.csv", EXAMPLES / "own_law.py"
    done = run("homogenize", "fit", table, "--kind", "net", "--out", tmp_path / "law.json", "--plugin", plugin)
    assert f" --plugin={plugin}" in done.output.splitlines()[-1]


def test_a_load_of_the_table_is_still_made_by_its_name() -> None:
    loading = macro_fem.Load(gravity=5.0, steps=2)
    assert isinstance(loading, macro_fem.Loading)
    assert (loading.gravity, loading.steps) == (5.0, 2)


BAD = {
    "raises.py": ("1 / 0", "ZeroDivisionError: division by zero"),
    "line.py": ("\n\npressure", "line.py, line 3: NameError: name 'pressure' is not defined"),
    "clash.py": (
        "import macro_fem\n\nclass Mine(macro_fem.Support, kind='hooks'): ...",
        "kind = 'hooks' of Mine: is that of Hooks; choose another word",
    ),
    "text.txt": ("", "is no Python file"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_plugin_that_cannot_be_loaded_is_one_sentence(folder: Path, name: str) -> None:
    code, sentence = BAD[name]
    (folder / name).write_text(code)
    words = ["run", folder / "scene.toml", "--plugin", folder / name, "--out", folder / "new"]
    error = run("macro_fem", *words, codes=(2,)).stderr
    assert sentence in error
    assert error.count("\n") == 1
    missing = run("macro_fem", *words[:2], "--plugin", "none.py", "--out", folder / "new", codes=(2,)).stderr
    assert "none.py: cannot be read: No such file" in missing


OWN = """
from dataclasses import dataclass
import homogenize, macro_fem
from homogenize.laws import HalfSpaces
from macro_fem.scene import Places

@dataclass(frozen=True, eq=False, repr=False)
class Tape(homogenize.Law, kind="tape"):
    limit: float
    def half_spaces(self):
        return HalfSpaces([[2.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [2.0 * self.limit, self.limit])

@dataclass(frozen=True)
class Pegs(macro_fem.Support, kind="pegs"):
    number: int
    def places(self, border):
        (line,) = border.lines("top")
        return Places(line.at(line.arc[[0, -1]]))
    def hold(self, border, nodes):
        return self.held_at("pegs", border, nodes, border.points[nodes])

@dataclass(frozen=True)
class Ramp(macro_fem.Load, kind="ramp"):
    pressure: float
    def per_area(self, X):
        return 1e-6 * self.pressure * X
"""
OWN_SCENE = """
curtain = {width = 60.0, height = 40.0, areal_mass = 0.9}
mesh = {cells = 2}
support = {kind = "pegs", number = 2}
load = {ramp = {pressure = 0.0}}
"""
HOLD, PLACES, FORCE = "return self.held_at", "return Places(line.at(line.arc[[0, -1]]))", "1e-6 * self.pressure * X"
SET = "HalfSpaces([[2.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [2.0 * self.limit, self.limit])"
MISTAKES = [
    (SET, "[[1.0, 0.0, 0.0]], [0.1]", "returns ([[1.0, 0.0, 0.0]], [0.1]), not homogenize.laws.HalfSpaces(S, h)"),
    ("def half_spaces", "def halfspaces", "half_spaces: Tape has none: return homogenize.laws.HalfSpaces(S, h)"),
    ("[2.0, 0.0, 0.0]", "[1.5, 0, -0.5]", "law 'tape': half_spaces: half-space 0, S = [1.5, 0.0, -0.5], is not"),
    ("[2.0, 0.0, 0.0]", "[2.0, 0.0]", "half_spaces: S = [[2.0, 0.0], [0.0, 0.0, 1.0]]: is no array"),
    ("[2.0 * self.limit, self.limit]", "[0.1]", "got S (2, 3) and h (1,)"),
    ("self.limit])", "float('nan')])", "half-spaces are finite triples"),
    ("2.0 * self.limit", "-1.0", "law 'tape': half_spaces: h = -0.5: leaves no strain"),
    (SET, "HalfSpaces([[1.0, 0.0, 0.0]], [0.1])", "law 'tape': half_spaces: leave the strain open in one direction"),
    ("    limit: float", "    limit: float\n    compliance = 0.1", "law 'tape': compliance = 0.1: is no (3, 3)"),
    ("        return HalfSpaces", "        1 / 0\n        return HalfSpaces", "plugin own.py, line 11: ZeroDiv"),
    (
        'border.lines("top")',
        'border.lines("tip")',
        "'tip' is not one of outline, top, bottom, left, ",
    ),
    ("border.points[nodes])", "border.points[nodes], 'xq')", "pegs: held = 'xq': is both or some of the letters xyz"),
    (HOLD, "return self.heldat", "own.py, line 20: AttributeError: 'Pegs' object has no"),
    (HOLD, "self.held_at", "[support] (pegs): hold returns None, not macro_fem.scene.Held"),
    ("border.points[nodes])", "border.points[nodes] * float('nan'))", "hold returns positions that are not finite"),
    (PLACES, "return line.at(line.arc[[0, -1]])", "(pegs): places returns array("),
    (PLACES, "return Places([0.0, 40.0])", "(pegs): places: points = [0.0, 40.0]: are not finite and (k, 2)"),
    (PLACES, "return Places(edge='tp')", "(pegs) needs edge = 'tp': the curtain has no such edge"),
    ("per_area", "per_length", "[load.ramp]: Ramp has per_length but no field `edge`"),
    (FORCE, "'down'", "[load.ramp]: force of Ramp = 'down': is no array of numbers"),
    (FORCE, "X[:, [0, 0, 1]]", "[load.ramp]: Ramp has forces along z: give it a text space_reason, or [solver] space"),
    ("(frozen=True, eq=False, repr=False)", "(frozen=True)", ""),
    ("@dataclass(frozen=True, eq=False, repr=False)", "", "class Tape has no fields of its own: is it a @dataclass"),
    ("@dataclass(frozen=True)\nclass Pegs", "class Pegs", "class Pegs has no fields of its own: is it a @dataclass"),
    ("@dataclass(frozen=True)\nclass Ramp", "class Ramp", "class Ramp has no fields of its own: is it a @dataclass"),
]


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a plugin, a law of it and a scene; its words are forgotten afterwards."""
    for base in (homogenize.Law, macro_fem.Support, macro_fem.Load):
        monkeypatch.setattr(base, "kinds", dict(base.kinds))
    (tmp_path / "own.py").write_text(OWN)
    (tmp_path / "scene.toml").write_text(OWN_SCENE)
    (tmp_path / "law.json").write_text('{"kind": "tape", "parameters": {"limit": 0.05}}')
    return tmp_path


def run_own(folder: Path, *words: object, code: int = 0) -> str:
    """What a run of the curtain of the plugin in a folder says on standard error."""
    law = ("--law", folder / "law.json", "--out", folder / "out", "--no-picture")
    return run("macro_fem", "run", folder / "scene.toml", *law, *words, codes=(code,)).stderr


@pytest.mark.parametrize(("right", "wrong", "sentence"), MISTAKES)
def test_a_mistake_in_a_plugin_is_one_sentence_that_names_it(own: Path, right: str, wrong: str, sentence: str) -> None:
    assert OWN.count(right) == 1
    (own / "own.py").write_text(OWN.replace(right, wrong))
    error = run_own(own, "--plugin", own / "own.py", code=(0 if not sentence else 1 if "own.py" in sentence else 2))
    assert sentence in error
    assert "please report it" not in error


NAILS = """
@dataclass(frozen=True)
class Nails(macro_fem.Support, kind="nails"):
    one = "nail"
    capacity: float
    every: int = 2
    def hold(self, border, nodes):
        return self.held_at("nails", border, nodes[::self.every], border.points[nodes[::self.every]])

@dataclass(frozen=True)
class Tacks(macro_fem.Support, kind="tacks"):
    one = "tack"
    capacity: float
    rings_per_hook: int = 1
    def places(self, border):
        (line,) = border.lines("top")
        return Places(line.at([0.0, 0.5 * line.arc[-1], line.arc[-1]]))
    def hold(self, border, nodes):
        return self.held_at("tacks", border, nodes, border.points[nodes])
"""


def test_points_that_an_own_support_holds_on_an_edge_are_judged_as_hooks_are(own: Path) -> None:
    """Each bears what the same hook does, together the weight; a whole edge has no points that could be judged."""
    (own / "own.py").write_text(OWN + NAILS)
    text, told = OWN_SCENE.replace("cells = 2", "cells = 4"), list[Any]()
    tacks = "kind = 'tacks', rings_per_hook = 2"
    for kind in ("kind = 'nails'", "kind = 'hooks', count = 3", "kind = 'nails', every = 1", tacks):
        (own / "scene.toml").write_text(text.replace('kind = "pegs", number = 2', f"{kind}, capacity = 0.02"))
        run_own(own, "--plugin", own / "own.py")
        told.append(json.loads((own / "out" / "summary.json").read_text()))
    nails, hooks, edge, tacks = (one["support_forces"][0] for one in told)
    assert [point["point"] for point in nails["points"]] == ["nail 1", "nail 2", "nail 3"]
    for name in ("force_N", "largest_force_per_ring_N", "capacity_N", "nodes_held", "length_held_mm"):
        assert nails[name] == pytest.approx(hooks[name]), name
    for point, same in zip(nails["points"], hooks["points"], strict=True):
        assert point["force_N"] == pytest.approx(same["force_N"], abs=1e-9)
    assert nails["force_N"] == pytest.approx([0.0, 0.9 * 0.06 * 0.04 * 9.81], abs=1e-9)
    assert told[0]["order"]["hooks"] == 3
    assert told[0]["weakest"] == "nail capacity"
    assert told[0]["weakest_factor"] == pytest.approx(told[1]["weakest_factor"])
    assert tacks["largest_force_per_ring_N"] == pytest.approx(0.5 * hooks["largest_nodal_force_N"])
    assert told[3]["single_forces_note"].replace("tack", "hook") == told[1]["single_forces_note"]
    assert (edge["nodes_held"], "capacity_N" in edge, told[2]["weakest"]) == (5, False, None)


def test_half_spaces_of_any_trace_are_the_same_law(own: Path) -> None:
    run_own(own, "--plugin", own / "own.py")
    start = homogenize.load_law(own / "law.json").half_spaces()
    assert (start.S.tolist(), start.h.tolist()) == ([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [0.05, 0.05])


def test_a_plugin_that_was_forgotten_is_asked_for(own: Path) -> None:
    (own / "law.json").write_text('{"kind": "cloth", "parameters": {}}')
    error = run_own(own, code=2)
    assert "[load] ramp = {'pressure': 0.0}: unknown key" in error
    assert error.strip().endswith("; one of a plugin needs --plugin FILE.py")


def test_a_changed_plugin_is_loaded_anew(tmp_path: Path) -> None:
    file = tmp_path / "weight.py"
    for pressure in (1.0, 2.0):
        file.write_text(f"import rve\nrve.MATERIALS['changing'] = rve.Material('changing', yield_N_per_mm2={pressure})")
        load_plugin(file)
        assert rve.named_material("changing").yield_N_per_mm2 == pressure
    del rve.MATERIALS["changing"]


def test_installed_packages_are_plugins_by_entry_points(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_mill.py").write_text("import rve\nrve.MATERIALS['my wire'] = rve.Material('my wire')")
    monkeypatch.syspath_prepend(tmp_path)
    listed = [EntryPoint("mill", "my_mill", "ring_mesh.plugins")]
    monkeypatch.setattr("rve.common.plugins.entry_points", lambda group: [one for one in listed if one.group == group])
    load_installed.cache_clear()
    try:
        assert rve.named_material("my wire").name == "my wire"
        listed.append(EntryPoint("gone", "not_there", "ring_mesh.plugins"))
        load_installed.cache_clear()
        with pytest.raises(rve.InputError, match="plugin gone = not_there: ModuleNotFoundError"):
            rve.named_material("their wire")
    finally:
        load_installed.cache_clear()
        rve.MATERIALS.pop("my wire")
        sys.modules.pop("my_mill")


@pytest.mark.slow
def test_workers_of_a_cluster_know_only_the_plugins_of_their_item(folder: Path, tmp_path: Path) -> None:
    """They live longer than a sweep, whose plugins another one replaces by a file of the same words."""
    import distributed

    steep = tmp_path / "steep" / "own_support.py"
    steep.parent.mkdir()
    steep.write_text((EXAMPLES / "own_support.py").read_text().replace("4.0 * self.sag", "6.0 * self.sag"))

    def sweep(out: str, support: Path) -> tuple[Any, int]:
        """The summary of the scene on the support, and when it was written."""
        forget_plugins()
        words = ["--law", folder / "law.json", "--no-picture", "--out", folder / out, "--cluster", address]
        words += [f"--plugin={EXAMPLES / 'own_law.py'}", f"--plugin={support}"]
        run("macro_fem", "sweep", folder / "scene.toml", *words)
        path = folder / out / "scene" / "summary.json"
        return json.loads(path.read_text()), path.stat().st_mtime_ns

    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        first, written = sweep("flat", EXAMPLES / "own_support.py")
        other, _ = sweep("steep", steep)
        assert sweep("flat", EXAMPLES / "own_support.py")[1] == written
    for path in EXAMPLES.glob("own_*.py"):  # as other tests here know them
        load_plugin(path)
    names = {"plugin own_law.py", "plugin own_support.py"}
    assert [{name for name in one["versions"] if name.startswith("plugin")} for one in (first, other)] == [names] * 2
    assert other["mean_height_mm"] < first["mean_height_mm"] - 10.0
