"""Sweeps give the files of the single commands, wherever they run and whoever is killed on the way."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from multiprocessing import active_children, get_context
from pathlib import Path

import openpyxl
import pytest
import skfem
from click.testing import CliRunner

from homogenize.io import DEFAULT_LAW
from macro_fem.cli import main as macro_fem
from macro_fem.scene import write_outline
from rve.cli import main as rve
from rve.cli import table_items
from rve.common import Progress, heard_by
from rve.common.commands.sweeps import Ended, SweepItem, _begin_worker, run_item, sweep
from tests.commands import cluster_that_loses_a_worker

ROOT = Path(__file__).resolve().parents[1]

GRID = ("--alpha", "0:45:45", "--beta", "0:90:45")
SCENE = """
curtain = {{width = 100.0, height = {height}, areal_mass = 1.0}}
mesh = {{cells = 4}}
support = {{kind = "top"}}
"""


def run(command, *arguments):
    return CliRunner().invoke(command, [str(one) for one in arguments])


def rows_of(out: Path) -> list[dict[str, str]]:
    with (out / "sweep.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def single(tmp_path_factory):
    """The tables of two cells, each by its own command."""
    out = tmp_path_factory.mktemp("single")
    tables = {}
    for r2 in ("0.5", "1"):
        path = out / f"{r2}.csv"
        assert run(rve, "table", "--out", path, "--r1", 5, "--r2", r2, *GRID).exit_code == 0
        tables[f"4-in-1_y_r1-5_r2-{r2}.csv"] = path.read_bytes()
    return tables


@pytest.mark.slow
def test_a_sweep_writes_what_single_commands_do_and_names_what_failed(tmp_path, single):
    found = run(rve, "sweep", "--out", tmp_path, "--r1", "5", "--r2", "0.5,1,3", *GRID)
    assert found.exit_code == 1
    assert "too thick for the 4-in-1 weave" in found.output
    for name, content in single.items():
        assert (tmp_path / name).read_bytes() == content
    rows = rows_of(tmp_path)
    assert [row["exit_code"] for row in rows] == ["0", "0", "2"]
    assert [row["rows_converged"] for row in rows[:2]] == ["6", "6"]


@pytest.mark.slow
def test_the_same_sweep_again_runs_only_what_is_not_finished(tmp_path, single):
    ask = ("sweep", "--out", tmp_path, "--r1", "5", "--r2", "0.5,1", *GRID)
    assert run(rve, *ask).exit_code == 0
    first, second = (tmp_path / name for name in single)
    times = first.stat().st_mtime_ns, second.stat().st_mtime_ns
    second.write_text(second.read_text().replace("converged", "stalled"))
    assert run(rve, *ask).exit_code == 0
    assert first.stat().st_mtime_ns == times[0]
    assert second.read_bytes() == single[second.name]
    assert second.stat().st_mtime_ns > times[1]
    changed = (*ask[:-1], "0:90:90")
    assert run(rve, *changed).exit_code == 0
    assert first.stat().st_mtime_ns > times[0]


@pytest.mark.slow
def test_scenes_side_by_side(tmp_path):
    for name, height in (("low", 50.0), ("high", 100.0), ("bad", -1.0)):
        (tmp_path / f"{name}.toml").write_text(SCENE.format(height=height))
    scenes = [tmp_path / f"{name}.toml" for name in ("low", "high", "bad")]
    found = run(macro_fem, "sweep", *scenes, "--no-picture", "--out", tmp_path / "out", "--jobs", 2)
    assert found.exit_code == 1, found.output
    assert "bad: " in found.output
    rows = rows_of(tmp_path / "out")
    assert [row["status"] for row in rows] == ["converged", "converged", ""]
    assert float(rows[0]["mass_kg"]) == pytest.approx(0.005)
    run(macro_fem, "sweep", *scenes, "--no-picture", "--out", tmp_path / "one")
    for name in ("low/curtain.vtu", "low/support_forces.csv", "high/curtain.vtu", "sweep.csv"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "out" / name).read_bytes(), name
    scenes[0].write_text(SCENE.format(height=50.0) + "motion = {duration = 1e-3}")
    assert run(macro_fem, "sweep", *scenes[:2], "--no-picture", "--out", tmp_path / "moved").exit_code == 0
    moved, still = rows_of(tmp_path / "moved")
    summary = json.loads((tmp_path / "moved" / "low" / "summary.json").read_text())
    assert float(moved["governing_factor"]) == float(moved["smallest_factor"]) == summary["smallest_factor"]
    assert (float(moved["at_s"]), moved["governing_link"], moved["governing_place"]) == (
        summary["at_s"],
        summary["weakest"],
        summary["weakest_place"],
    )
    assert (still["smallest_factor"], bool(still["governing_factor"])) == ("", True)


@pytest.fixture
def two_laws(tmp_path):
    """The default law, and one of rings twice as heavy that are no stronger."""
    record, paths = json.loads(DEFAULT_LAW.read_text()), [tmp_path / "light.json", tmp_path / "heavy.json"]
    for path in paths:
        path.write_text(json.dumps(record))
        record["cell"]["areal_mass_kg_per_m2"] *= 2.0
    return paths


@pytest.mark.slow
def test_every_scene_with_every_law_is_a_design_in_one_table(tmp_path, two_laws):
    """Twice the mass of rings that are no stronger is half the factor; a design that fails costs no other."""
    for name, height in (("low", 50.0), ("bad", -1.0)):
        (tmp_path / f"{name}.toml").write_text(SCENE.format(height=height).replace(", areal_mass = 1.0", ""))
    scenes, out = [tmp_path / f"{name}.toml" for name in ("low", "bad")], tmp_path / "out"
    laws = [f"--law={law}" for law in two_laws]
    ask = ("compare-designs", *scenes, *laws, "--out", out)
    found = run(macro_fem, *ask)
    assert found.exit_code == 1, found.output
    assert "2 of 4 done" in found.output
    assert "expected a number" in found.stderr
    with (out / "designs.csv").open() as file:
        rows = list(csv.DictReader(file))
    names = [f"{scene}_{law}" for scene in ("low", "bad") for law in ("light", "heavy")]
    assert [row["name"] for row in rows] == names
    assert [row["status"] for row in rows] == ["converged", "converged", "", ""]
    light, heavy = rows[:2]
    assert (light["scene"], light["rings"]) == (heavy["scene"], heavy["rings"])
    assert float(heavy["mass_kg"]) == pytest.approx(2.0 * float(light["mass_kg"]))
    # rings give a little, and more under twice the load
    assert float(heavy["governing_force_N"]) == pytest.approx(2.0 * float(light["governing_force_N"]), rel=1e-4)
    assert float(heavy["governing_factor"]) == pytest.approx(0.5 * float(light["governing_factor"]), rel=1e-3)
    assert "next: python -m macro_fem run" in found.stdout
    assert str(out / "low_light") in found.stdout.splitlines()[-1]  # the lightest
    header, *sheet = openpyxl.load_workbook(out / "designs.xlsx").active.iter_rows(values_only=True)
    assert list(header) == list(rows[0])
    for cell, text in zip(sheet[0], rows[0].values(), strict=True):  # numbers are numbers there
        is_same = float(text) == pytest.approx(cell) if isinstance(cell, float) else text == str(cell or "")
        assert is_same or (cell, text) == (0, "0"), (cell, text)
    drawn = json.loads((out / "designs.json").read_text())["files"]
    assert drawn.keys() == {"designs.xlsx", "designs.png", "curtains.png"}
    (out / "low_light" / "curtain.vtu").unlink()
    kept = {name: (out / name / "summary.json").stat().st_mtime_ns for name in names[:2]}
    assert run(macro_fem, *ask, "--no-picture").exit_code == 1
    assert not (out / "designs.png").exists()
    now = {name: (out / name / "summary.json").stat().st_mtime_ns for name in names[:2]}
    assert now["low_light"] > kept["low_light"]
    assert run(macro_fem, *ask[:2], *laws, "--out", out, "--no-picture").exit_code == 0
    assert now == {name: (out / name / "summary.json").stat().st_mtime_ns for name in names[:2]}


@pytest.mark.slow
def test_a_listener_hears_how_many_are_done_and_what_the_rest_takes(tmp_path):
    """As measured in this run: what was finished before counts for nothing in the pace."""
    items, told = table_items(tmp_path, {"r1": "5", "r2": "0.5,1,0.6"}, ["4-in-1"], "y", GRID), list[Progress]()
    sweep(items[:1], tmp_path)
    with heard_by(told.append):
        sweep(items, tmp_path, jobs=1)
    assert [(one.work, one.done, one.total) for one in told] == [
        ("sweep, 1 of 3 done", 0, 0),
        ("sweep, 2 of 3 done", 1, 2),
        ("sweep, 3 of 3 done", 2, 2),
    ]
    assert told[0].left_s is None
    assert (told[1].left_s, told[2].left_s) == (told[1].used_s, 0.0)
    assert str(told[1]).startswith("sweep, 2 of 3 done; ")


@pytest.mark.slow
def test_a_sweep_takes_several_laws(tmp_path, two_laws):
    (tmp_path / "low.toml").write_text(SCENE.format(height=50.0))
    laws = [word for law in two_laws for word in ("--law", law)]
    assert (
        run(macro_fem, "sweep", *laws, tmp_path / "low.toml", "--no-picture", "--out", tmp_path / "out").exit_code == 0
    )
    assert [(row["name"], row["scene"], row["law"]) for row in rows_of(tmp_path / "out")] == [
        ("low_light", "low", "light"),
        ("low_heavy", "low", "heavy"),
    ]
    twice = run(macro_fem, "sweep", tmp_path / "low.toml", *laws[:2], *laws[:2], "--out", tmp_path / "out")
    assert (twice.exit_code, "are called so" in twice.output) == (2, True)


@pytest.mark.slow
@pytest.mark.parametrize(("shape", "name"), [("file", "mesh.vtu"), ("dxf", "drawing.dxf")])
def test_what_was_read_has_changed_and_is_run_again(tmp_path, shape, name):
    def draw(side):
        square = skfem.MeshTri().refined(2).oriented().scaled(side)
        write_outline(tmp_path / name, square) if shape == "dxf" else square.save(tmp_path / name)

    draw(120.0)
    coarse = "[mesh]\ncells = 4\n" if shape == "dxf" else ""
    scene = f'[curtain]\nshape = "{shape}"\nfile = "{name}"\n{coarse}[support]\nkind = "top"\n'
    (tmp_path / "hung.toml").write_text(scene)
    law = tmp_path / "law.json"
    law.write_bytes(DEFAULT_LAW.read_bytes())
    ask = ("sweep", tmp_path / "hung.toml", "--out", tmp_path / "out", "--no-picture", f"--law={law}")

    def mass():
        assert run(macro_fem, *ask).exit_code == 0
        return float(rows_of(tmp_path / "out")[0]["mass_kg"])

    first = mass()
    assert run(macro_fem, "run", *ask[1:-1], "--dxf", tmp_path / name).exit_code == 2  # what it reads
    draw(240.0)
    assert mass() == pytest.approx(4.0 * first)
    record = json.loads(law.read_text())
    record["cell"]["areal_mass_kg_per_m2"] *= 2.0
    law.write_text(json.dumps(record))
    assert mass() == pytest.approx(8.0 * first)


@pytest.mark.parametrize(
    ("jobs", "number", "code"),
    [
        (1, signal.SIGINT, 130),
        pytest.param(1, signal.SIGHUP, 129, marks=pytest.mark.slow),
        pytest.param(2, signal.SIGTERM, 143, marks=pytest.mark.slow),
    ],
)
def test_a_stopped_sweep_ends_and_keeps_what_is_finished(tmp_path, number, code, jobs):
    words = ["sweep", "--out", tmp_path, "--r1", "5,6,7,8", "--r2", "0.5,0.6,0.7,0.8,0.9,1", "--jobs", jobs, "--quiet"]
    command = [sys.executable, "-m", "rve", *map(str, words), "--alpha", "0:45:15", "--beta", "0:90:45"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    heard = partial(signal.signal, number, signal.SIG_DFL)  # tests that run in the background ignore SIGINT
    process = subprocess.Popen(command, env=environment, preexec_fn=heard, stderr=subprocess.PIPE, text=True)
    while process.poll() is None and not list(tmp_path.glob(".sweep/*.json")):
        time.sleep(0.05)
    process.send_signal(number)
    _, errors = process.communicate()
    assert process.returncode == code, errors
    assert errors.startswith(f"Error: stopped by {number.name}; what is finished is kept in {tmp_path}")
    assert errors.count("\n") == 1
    assert 0 < len(list(tmp_path.glob("*.csv"))) < 24
    assert not list(tmp_path.glob(".part-*"))


def test_an_idle_worker_that_is_stopped_says_nothing(capfd):
    """A command has run in it before, which listens to the same signal."""
    before = active_children()
    with ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_begin_worker, initargs=([],)) as pool:
        item = SweepItem("worker", "rve", ("support", "--S", "1,0"), Path("none"))
        assert pool.submit(run_item, item).result().code == 2
        (worker,) = set(active_children()) - set(before)
        worker.terminate()
        worker.join(20.0)
    assert worker.exitcode == -signal.SIGTERM
    assert capfd.readouterr().err == ""


@pytest.mark.slow
def test_a_cluster_that_loses_a_worker_half_way_gives_the_same_tables(tmp_path, single):
    items = table_items(tmp_path, {"r1": "5", "r2": "0.5,1,0.6,0.7,0.8,0.9"}, ["4-in-1"], "y", GRID)
    with cluster_that_loses_a_worker("1 of 6") as address:
        ended = sweep(items, tmp_path, cluster=address)
    assert [how.code for how in ended] == [0] * len(items)
    for name, content in single.items():
        assert (tmp_path / name).read_bytes() == content


@pytest.mark.slow
def test_a_sweep_that_loses_its_processes_keeps_what_is_finished_and_says_what_is_not(tmp_path):
    items = table_items(tmp_path, {"r1": "5", "r2": "0.5,1,0.6,0.7"}, ["4-in-1"], "y", GRID)

    def listen(work):
        for child in active_children():
            child.kill()

    with heard_by(listen):
        ended = sweep(items, tmp_path, jobs=2)
    lost = [how for how in ended if how.code]
    assert 0 < len(lost) < 4
    assert all("worker" in how.message and "goes on" in how.message for how in lost)
    assert [how.code for how in sweep(items, tmp_path)] == [0] * 4


@pytest.mark.parametrize(
    ("done", "words"),
    [(lambda item: 1 / 0, "ZeroDivisionError: division by zero"), (lambda item: Ended(0, ""), "workers must see")],
)
def test_a_fault_beside_the_commands_fails_its_items_by_name(tmp_path, monkeypatch, done, words):
    """As does a record that is written to the disk of another machine."""
    monkeypatch.setattr("rve.common.commands.sweeps.ProcessPoolExecutor", lambda *_, **how: ThreadPoolExecutor(1))
    monkeypatch.setattr("rve.common.commands.sweeps.run_item", done)
    (how,) = sweep(table_items(tmp_path, {"r1": "5", "r2": "0.5"}, ["4-in-1"], "y", GRID), tmp_path, jobs=2)
    assert (how.code, words in how.message) == (1, True)
    assert not list(tmp_path.glob(".sweep/*.json"))
