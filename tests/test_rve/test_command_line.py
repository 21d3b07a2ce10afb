"""How every command ends: one sentence and a code, whatever happens; stopped, it takes its workers along."""

import os
import resource
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from homogenize.io import DEFAULT_LAW
from rve import InputError, NotConverged
from rve.common.commands.command_line import Group

ROOT = Path(__file__).resolve().parents[2]
TABLE = ROOT / "tests" / "test_homogenize" / "data" / "table190.csv"
SCENE = '[curtain]\nwidth = 70.0\nheight = 60.0\n[mesh]\ncells = {cells}\n[support]\nkind = "corners"\n'


def ended(error, *options):
    """A command that raises `error`."""

    @click.group(cls=Group)
    def main():
        pass

    @main.command()
    def go():
        raise error

    return CliRunner().invoke(main, ["go", *options])


@pytest.mark.parametrize(("told", "threads"), [({}, "1"), ({"OMP_NUM_THREADS": "2"}, "2")])
def test_a_command_takes_one_thread_of_blas_unless_told_otherwise(monkeypatch, told, threads):
    monkeypatch.setattr(os, "environ", dict(told))
    ended(ZeroDivisionError())
    assert os.environ["OMP_NUM_THREADS"] == threads


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (InputError("x = 3: too small"), 2, "Error: x = 3: too small"),
        (NotConverged("stalled"), 1, "Error: stalled"),
        (ZeroDivisionError("division\nby zero"), 1, "Error: unforeseen ZeroDivisionError: division by zero"),
        (AssertionError(), 1, "unforeseen AssertionError: no message"),
        (RecursionError("too deep"), 1, "unforeseen RecursionError"),
        (MemoryError(), 1, "not enough memory"),
        (OSError(28, "No space left on device", "a.csv"), 1, "a.csv: No space left on device, make room there; files"),
        (FileNotFoundError(2, "No such file", "law.json"), 1, "law.json: No such file"),
        (KeyboardInterrupt(), 130, "stopped by SIGINT; no file is left half-written, and the same command begins anew"),
    ],
)
def test_whatever_a_command_raises_is_one_sentence(error, code, words):
    done = ended(error)
    assert done.exit_code == code
    assert words in done.stderr
    assert done.stderr.count("\n") == 1
    traced = ended(error, "--traceback")
    assert traced.exit_code == code
    assert "Traceback (most recent call last)" in traced.stderr
    assert "in go" in traced.stderr
    assert traced.stderr.splitlines()[-1] == done.stderr.strip()


def started(*arguments, limit=None):
    """A command as a user starts it, in a session of its own; `limit`: largest file in bytes."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    small = None if limit is None else lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    command = [sys.executable, "-m", *(str(a) for a in arguments)]
    pipe = subprocess.PIPE
    return subprocess.Popen(
        command, env=environment, stdout=pipe, stderr=pipe, text=True, start_new_session=True, preexec_fn=small
    )


@pytest.mark.slow
def test_a_disk_that_is_full_is_a_sentence_and_old_files_stay(tmp_path):
    """Files may not grow beyond 1 kB: the same error path as a full disk."""
    table, law, out = tmp_path / "t.csv", tmp_path / "law.json", tmp_path / "out"
    (tmp_path / "scene.toml").write_text(SCENE.format(cells=2))
    runs = [
        ("rve", "table", "--out", table, "--alpha", "0:20:10", "--beta", "30,60"),
        ("homogenize", "fit", TABLE, "--out", law, "--kind", "net"),
        ("macro_fem", "run", tmp_path / "scene.toml", "--out", out, "--no-picture"),
    ]
    for command in runs:
        process = started(*command)
        assert process.wait() == 0, process.stderr.read()
        process.communicate()
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    before = {path: path.read_bytes() for path in files}
    assert len(before) == 8  # table, sidecar, law, scene; summary, support forces, order, VTU
    for command in runs:
        process = started(*command, limit=200)
        _, errors = process.communicate()
        assert process.returncode == 1
        assert "File too large; files that were there before are unchanged" in errors
        assert errors.count("\n") == 1
        assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(
    ("module", "extra", "arguments"),
    [
        ("matplotlib", "plots", ("homogenize", "plot", DEFAULT_LAW, "--table", TABLE, "--out", "out")),
        ("pyvista", "three-d", ("macro_fem", "run", "space.toml", "--out", "out")),
        ("plotly", "pages", ("macro_fem", "run", "scene.toml", "--out", "out", "--html")),
    ],
)
def test_what_a_command_needs_is_checked_first(tmp_path, monkeypatch, module, extra, arguments):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, module, None)
    Path("scene.toml").write_text(SCENE.format(cells=2))
    Path("space.toml").write_text(SCENE.format(cells=2) + "[solver]\nspace = true\n")
    package, *rest = (str(a) for a in arguments)
    run = CliRunner().invoke(import_module(f"{package}.cli").main, rest)
    assert (run.exit_code, run.stdout) == (2, "")
    assert f"needs {module}: run pip install {module} " in run.stderr
    assert f"(extra {extra})" in run.stderr
    assert run.stderr.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scene.toml", "space.toml"]
