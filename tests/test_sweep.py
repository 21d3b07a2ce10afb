"""Sweeps give the files of the single commands, wherever they run and whoever is killed on the way."""

import csv
import os
import signal
from pathlib import Path

import pytest
from click.testing import CliRunner

from macro_fem.cli import main as macro_fem
from rve.cli import main as rve
from rve.common.sweeps import sweep
from rve.sweep import table_columns, table_items

GRID = ("--alpha", "0:45:45", "--beta", "0:90:45")
SCENE = """
[curtain]
width = 100.0
height = {height}
areal_mass = 1.0
[mesh]
cells = 4
[support]
kind = "top"
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


@pytest.mark.parametrize("words", [("--weave", "felt"), ("--bogus",), ("--jobs", "2", "--load", "heavy")])
def test_options_that_no_table_takes_are_refused_before_the_first_one(tmp_path, words):
    found = run(rve, "sweep", "--out", tmp_path / "out", "--r1", "5", "--r2", "0.5,1", *words)
    assert found.exit_code == 2
    assert found.output.count("\n") == 1
    assert "see rve table --help" in found.output
    assert not (tmp_path / "out").exists()


def test_a_sweep_writes_what_single_commands_do_and_names_what_failed(tmp_path, single):
    found = run(rve, "sweep", "--out", tmp_path, "--r1", "5", "--r2", "0.5,1,3", *GRID)
    assert found.exit_code == 1
    assert "too thick for the 4-in-1 weave" in found.output
    for name, content in single.items():
        assert (tmp_path / name).read_bytes() == content
    rows = rows_of(tmp_path)
    assert [row["exit_code"] for row in rows] == ["0", "0", "2"]
    assert [row["rows_converged"] for row in rows[:2]] == ["6", "6"]


def test_the_same_sweep_again_runs_only_what_is_not_finished(tmp_path, single):
    ask = ("sweep", "--out", tmp_path, "--r1", "5", "--r2", "0.5,1", *GRID)
    assert run(rve, *ask).exit_code == 0
    first, second = (tmp_path / name for name in single)
    times = first.stat().st_mtime_ns, second.stat().st_mtime_ns
    (tmp_path / ".sweep" / f"{second.stem}.json").unlink()
    assert run(rve, *ask).exit_code == 0
    assert first.stat().st_mtime_ns == times[0]
    assert second.stat().st_mtime_ns > times[1]
    changed = (*ask[:-1], "0:90:90")
    assert run(rve, *changed).exit_code == 0
    assert first.stat().st_mtime_ns > times[0]


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


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--r1", "5", "--r2", "a"), "--r2 = 'a': is not a list of numbers"),
        (("--r1", "5", "--r2", "0.5", "--cluster", "tcp://127.0.0.1:9"), "no Dask scheduler answers there"),
        (("--r1", "5", "--r2", "0.5", "--cluster", "x", "--jobs", "2"), "two ways to run a sweep"),
        (("--r1", "5", "--r2", "0.5", "--jobs", "0"), "--jobs"),
    ],
)
def test_bad_input_is_one_sentence(tmp_path, monkeypatch, arguments, sentence):
    monkeypatch.setattr("rve.common.sweeps.CONNECT_S", 0.5)
    found = run(rve, "sweep", "--out", tmp_path, *arguments)
    assert found.exit_code == 2
    assert sentence in found.output


@pytest.mark.slow
def test_a_cluster_that_loses_a_worker_half_way_gives_the_same_tables(tmp_path, single):
    distributed = pytest.importorskip("distributed")
    r2 = [0.5, 1.0, 0.6, 0.7, 0.8, 0.9]
    items = table_items(tmp_path, [5.0], r2, ["4-in-1"], "y", GRID)
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        victim = cluster.workers[1].pid
        killed = []

        def done(name):
            if not killed:
                os.kill(victim, signal.SIGKILL)
                killed.append(name)

        ended = sweep(items, tmp_path, cluster=cluster.scheduler_address, done=done)
    assert killed
    assert [how.code for how in ended] == [0] * len(items)
    for name, content in single.items():
        assert (tmp_path / name).read_bytes() == content
    assert table_columns({"rows": {"converged": 3, "stalled": 1}})["rows_other"] == 1
