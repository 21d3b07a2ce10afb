"""A command of each kind killed at three times: what it leaves is the old or the new result, or is refused.
Searches and sweeps killed twelve times lose no answer."""

import json
import os
import shutil
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from glob import glob  # a folder that goes while it looks is none, which raises in pathlib
from pathlib import Path

import pandas as pd
import pytest

from rve.common import checksum

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / "tests" / "test_homogenize" / "data" / "table190.csv"
SCENE = '[curtain]\nwidth = 70.0\nheight = 60.0\n[mesh]\ncells = {cells}\n[support]\nkind = "corners"\n'
STEPS = SCENE + '[load]\nsteps = 2\n[[load.edge]]\nedge = "bottom"\nforce = [0.0, -1e-3]\n'
STUDY = (
    "from rve.simulation import SimulationOptions, run_study; "
    "run_study('out', {alpha}, [0.0, 45.0], SimulationOptions(max_steps=40))"
)


@dataclass(frozen=True)
class Case:
    """Two runs that write to one place. record: the result's JSON; key: what tells the runs apart in it."""

    old: tuple[str, ...]
    new: tuple[str, ...]
    record: str = ""
    key: str = ""


def module(name, *arguments):
    return ("-m", name, *(str(a) for a in arguments))


CASES = {
    "macro_fem run": Case(
        module("macro_fem", "run", "steps.toml", "--out", "out"),
        module("macro_fem", "run", "other.toml", "--out", "out"),
        "summary.json",
        "cells",
    ),
    "rve table": Case(
        module("rve", "table", "--out", "out/t.csv", "--alpha", "0:20:20", "--beta", "30:60:15"),
        module("rve", "table", "--out", "out/t.csv", "--alpha", "0:45:15", "--beta", "30:60:15"),
        "t.json",
        "rows",
    ),
    "macro_fem localize": Case(
        module("macro_fem", "localize", "hung/curtain.vtu", "--out", "out", "--no-picture", "--window", "0,0,30,30"),
        module("macro_fem", "localize", "hung/curtain.vtu", "--out", "out", "--no-picture"),
        "localize.json",
        "rings",
    ),
    "rve study": Case(
        ("-c", STUDY.format(alpha=[0.0, 10.0])), ("-c", STUDY.format(alpha=[5.0, 10.0])), "study.json", "files"
    ),
    "homogenize fit": Case(
        module("homogenize", "fit", TABLE, "--out", "out/law.json", "--kind", "net"),
        module("homogenize", "fit", TABLE, "--out", "out/law.json", "--kind", "outer"),
    ),
}


def start(arguments, folder):
    environment = os.environ | {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg", "OMP_NUM_THREADS": "1"}
    quiet = subprocess.DEVNULL
    return subprocess.Popen([sys.executable, *arguments], cwd=folder, env=environment, stdout=quiet, stderr=quiet)


def finish(arguments, folder):
    """Seconds that a run takes."""
    began = time.perf_counter()
    assert start(arguments, folder).wait() == 0, arguments
    return time.perf_counter() - began


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """Scenes, laws and a curtain for the commands to read."""
    folder = tmp_path_factory.mktemp("inputs")
    (folder / "steps.toml").write_text(STEPS.format(cells=3))
    (folder / "other.toml").write_text(SCENE.format(cells=4))
    finish(module("macro_fem", "run", "other.toml", "--out", "hung", "--no-picture"), folder)
    for kind in ("net", "outer"):
        finish(module("homogenize", "fit", TABLE, "--out", f"{kind}.json", "--kind", kind), folder)
    return folder


def job_in(out, case):
    """Which result `out` holds: its content, or names and key of its record; None if a checksum does not hold."""
    names = sorted(path.name for path in out.iterdir() if not path.name.startswith("."))
    if not case.key:
        return {name: (out / name).read_bytes() for name in names}
    record = json.loads((out / case.record).read_text())
    if record["files"] != {name: checksum(out / name) for name in names if name != case.record}:
        return None
    return names, len(json.dumps(record[case.key])) if case.key == "files" else record[case.key]


@pytest.mark.release
@pytest.mark.parametrize("name", CASES)
def test_a_killed_command_leaves_the_old_or_the_new_result(inputs, tmp_path, name):
    """Killed early and late, and as soon as it writes; where it ends before, its result is the new one. Pictures follow
    when the data are in place."""
    case, found = CASES[name], []
    work, out = tmp_path / "work", tmp_path / "work" / "out"
    shutil.copytree(inputs, work)
    for command in (case.new, case.old):
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        seconds = finish(command, work)
        found.append(job_in(out, case))
    assert found[0] != found[1]
    data = ([one for one in found[0][0] if not one.endswith(".png")], found[0][1]) if case.key else found[0]
    shutil.copytree(out, tmp_path / "old")
    for share in (0.3, 0.9, None):
        shutil.rmtree(out)
        shutil.copytree(tmp_path / "old", out)
        process = start(case.new, work)
        if share is not None:
            with suppress(subprocess.TimeoutExpired):
                process.wait(share * seconds)
        while share is None and process.poll() is None and not glob(f"{out}/.part-*/*"):
            time.sleep(1e-4)
        process.kill()
        process.wait()
        assert job_in(out, case) in (*found, data, None), share
    finish(case.new, work)
    assert job_in(out, case) == found[0]


MOVE = """
curtain = {width = 400.0, height = 400.0}
mesh = {cells = 3}
support = [{kind = "point", at = [0.0, 400.0]}, {kind = "point", at = [400.0, 400.0], release = 0.01}]
motion = {duration = 0.1}
"""


@pytest.mark.release
def test_twelve_kills_of_a_motion_lose_no_step(tmp_path):
    """Each as soon as a step more is there: as many steps stay, and the run goes on to the same numbers."""
    (tmp_path / "move.toml").write_text(MOVE)
    words, table = module("macro_fem", "run", "move.toml", "--no-picture", "--out"), tmp_path / "out" / "motion.csv"
    finish((*words, "whole"), tmp_path)

    def rows():
        return table.read_text().count("\n") - 1 if table.exists() else 0

    for number in range(12):
        before, again = rows(), ["--continue"] * bool(number)
        process = start((*words, "out", *again), tmp_path)
        while process.poll() is None and rows() < max(2, before + 1):
            time.sleep(1e-4)
        process.kill()
        process.wait()
        assert rows() > before
    finish((*words, "out", "--continue"), tmp_path)
    assert table.read_text() == (tmp_path / "whole" / "motion.csv").read_text()
    names = sorted(path.name for path in table.parent.iterdir())
    assert names == sorted(path.name for path in (tmp_path / "whole").iterdir())


BARRED = SCENE.format(cells=3).replace("corners", "top") + "[load.bar]\nmass = {mass}\n"
KEEPING = {
    "size": (
        ".size",
        "size.csv",
        ("size", "1.toml", "--vary", "mass", "--from", "1e-3", "--to", "1e3", "--factor", "2"),
    ),
    "sweep": (".sweep", "sweep.csv", ("sweep", *(f"{number}.toml" for number in range(1, 15)))),
}


@pytest.mark.release
@pytest.mark.parametrize("name", KEEPING)
def test_twelve_kills_lose_no_answer(tmp_path, name):
    """Each kill comes as soon as an answer is kept; files of answers stay, and the end is that of an unbroken run."""
    marks, table, words = KEEPING[name]
    for number in range(1, 15):
        (tmp_path / f"{number}.toml").write_text(BARRED.format(mass=0.1 * number))
    kept = dict[str, int]()
    for _ in range(12):
        process = start(module("macro_fem", *words, "--out", "out", "--no-picture"), tmp_path)
        while process.poll() is None and len(glob(f"{tmp_path}/out/{marks}/*.json")) <= len(kept):
            time.sleep(1e-3)
        process.kill()
        process.wait()
        now = {path: os.stat(path).st_mtime_ns for path in glob(f"{tmp_path}/out/{marks}/*.json")}
        assert now.items() >= kept.items()
        kept = now
    assert len(kept) >= 12
    for out in ("out", "whole"):
        finish(module("macro_fem", *words, "--out", out, "--no-picture"), tmp_path)
    assert {path: os.stat(path).st_mtime_ns for path in kept} == kept
    both = [pd.read_csv(tmp_path / out / table) for out in ("out", "whole")]
    pd.testing.assert_frame_equal(*both, rtol=1e-6)
