"""Every command in a terminal, piped, with --json and with --quiet: a new command fails here until it is told of."""

import io
import json
import os
import re
import shlex
import sys
import threading
from contextlib import chdir, redirect_stdout
from multiprocessing.resource_tracker import ensure_running
from typing import get_args

import click
import pytest

from homogenize import FitOptions
from homogenize.cli import KINDS
from rve import WEAVES
from rve.cli import WEAVE_NAMES
from rve.common import types_of
from tests.commands import GROUPS, run

GRID = ("--alpha", "0,20,45", "--beta", "0:90:30")
SCENE = """
curtain = {width = 33.0, height = 25.292139247}
mesh = {cells = 4}
support = {kind = "corners"}
load = {gravity = 9.81, bar = {mass = 0.5}}
"""
COMMANDS = {
    "rve table": ("--out", "new.csv", "--alpha", "0,20", "--beta", "30,60", "--rings"),
    "rve case": ("--alpha", "20", "--beta", "45"),
    "rve support": ("--S", "0.5,-0.1,0.5"),
    "rve weaves": (),
    "rve ring": ("--inner", "8", "--wire", "1"),
    "rve export": ("--inner", "8", "--wire", "1", "--size", "30x30", "--out", "part.3mf"),
    "rve sweep": ("--out", "tables", "--r1", "5", "--r2", "0.5", "--alpha", "0", "--beta", "45,60"),
    "rve simulate": ("--alpha", "20", "--beta", "45", "--set", "h_max=10", "--out", "moved.csv"),
    "macro_fem localize": ("curtain", "--out", "each", "--no-picture"),
    "homogenize fit": ("table.csv", "--out", "fitted.json"),
    "homogenize strain": ("law.json", "--alpha", "20", "--beta", "45"),
    "homogenize support": ("law.json", "--S", "0.5,-0.1,0.5"),
    "homogenize strength": ("law.json", "--S", "0,0,1", "--yield", "275"),
    "homogenize plot": ("law.json", "--table", "table.csv", "--out", "pictures"),
    "homogenize export": ("law.json", "--out", "law.f"),
    "macro_fem run": ("scene.toml", "--out", ".", "--no-picture"),
    "macro_fem deck": ("scene.toml", "--law", "law.json", "--out", "deck", "--no-run"),
    "macro_fem modes": ("scene.toml", "--number", "2", "--out", "modes", "--no-picture"),
    "macro_fem size": ("scene.toml", "--vary", "mass", "--from", "0.5", "--to", "1", "--factor", "1e-3"),
    "macro_fem sweep": ("scene.toml", "--out", "curtains", "--no-picture"),
    "macro_fem compare-designs": ("scene.toml", "--law", "law.json", "--out", "designs", "--no-picture"),
    "macro_fem rings": ("scene.toml", "--out", "rings", "--no-picture"),
    "macro_fem compare": ("scene.toml", "--out", "both.json"),
}
"""Arguments with which every command runs for a few seconds at most, in the folder of `folder`."""
ANSWERS = {"rve case", "rve support", "rve ring", "rve weaves"}
ANSWERS |= {f"macro_fem {name}" for name in ("compare", "modes", "size")}
ANSWERS |= {f"homogenize {name}" for name in ("strain", "support", "strength")}
"""Commands that are asked for what they print: they print it with --quiet too."""


def each():
    """The commands, those that take longest among the slow tests."""
    slow = {
        f"macro_fem {name}" for name in ("localize", "rings", "compare", "compare-designs", "size", "modes", "sweep")
    }
    slow |= {"homogenize plot", "rve sweep"}
    return [pytest.param(name, marks=pytest.mark.slow if name in slow else ()) for name in COMMANDS]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a table, a law, a scene and a curtain, made by the commands themselves."""
    out = tmp_path_factory.mktemp("terminal")
    (out / "scene.toml").write_text(SCENE)
    with chdir(out):
        run("rve", "table", "--out", "table.csv", *GRID, "--rings")
        run("homogenize", "fit", "table.csv", "--out", "law.json")
        run("macro_fem", "run", "scene.toml", "--out", "curtain", "--no-picture")
    return out


@pytest.fixture
def there(monkeypatch, folder):
    monkeypatch.chdir(folder)


def typed(command, *options):
    """Exit code, standard output and what a terminal shows of a command whose output is piped."""
    package, name = command.split()
    ensure_running()  # or a sweep starts it, and it keeps the terminal open, as it keeps the stderr that it finds
    master, slave = os.openpty()
    seen = []

    def read():
        while True:
            try:
                text = os.read(master, 65536)
            except OSError:  # the other end is closed
                return
            if not text:
                return
            seen.append(text)

    reader = threading.Thread(target=read)
    reader.start()
    out, before = io.StringIO(), sys.stderr
    sys.stderr = os.fdopen(slave, "w")
    try:
        with redirect_stdout(out):
            code = GROUPS[package].main([name, *COMMANDS[command], *options], prog_name=package, standalone_mode=False)
    finally:
        sys.stderr.close()
        sys.stderr = before
        reader.join(timeout=10.0)
        os.close(master)
    return code or 0, out.getvalue(), b"".join(seen).decode()


def test_no_command_is_forgotten():
    known = {f"{package} {name}" for package, group in GROUPS.items() for name in group.commands}
    assert set(COMMANDS) == known - {"rve study"}  # which takes minutes


@pytest.mark.parametrize("command", each())
def test_work_is_shown_in_a_terminal_and_json_is_one_record(command, there, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    code, out, screen = typed(command, "--json")
    assert code == 0, screen
    assert isinstance(json.loads(out), dict)
    assert "starting" in screen  # before packages are imported
    assert "\x1b[2K" in screen  # the line is wiped


@pytest.mark.parametrize("command", each())
def test_the_last_line_of_a_piped_command_says_what_to_do_next(command, there):
    """A command that there is, with options that it has, and with paths that are there; nothing moves."""
    package, name = command.split()
    done = run(package, name, *COMMANDS[command])
    assert done.stderr == ""
    last = done.stdout.splitlines()[-1]
    if not last.startswith("next: "):
        assert command in ANSWERS | {"rve table", "rve sweep"}  # too few rows for a law
        return
    _, _, script, following, *words = shlex.split(last.removeprefix("next: ").split("  #")[0])
    GROUPS[script].commands[following].make_context(following, list(words))
    assert words[0].startswith("--") or os.path.exists(words[0])
    assert "._rings" not in words


@pytest.mark.slow
def test_a_search_tells_a_pipe_value_factor_and_how_much_is_left(there, monkeypatch):
    monkeypatch.setattr(GROUPS["macro_fem"].commands["size"], "period_s", 0.0)  # else every 10 s
    words = "macro_fem", "size", *COMMANDS["macro_fem size"]
    lines = run(*words).stderr.splitlines()
    told = r"mass = 1 kg, about \d+ answers left; 0\.7071 kg: factor [\d.]+; [\d.]+ s used, about [\d.]+ s left"
    assert lines[0].startswith("mass = 0.5 kg, the first of about 8 answers")
    assert any(re.match(told, line) for line in lines), lines
    assert run(*words, "--quiet").stderr == ""


@pytest.mark.slow
@pytest.mark.parametrize("command", ["rve table", "homogenize support", "macro_fem run"])
def test_quiet_commands_print_only_what_they_are_asked_for(command, there):
    package, name = command.split()
    done = run(package, name, *COMMANDS[command], "--quiet")
    assert done.stderr == ""
    assert bool(done.stdout) == (command in ANSWERS)


@pytest.mark.parametrize(
    ("package", "command"), [(package, name) for package, group in GROUPS.items() for name in group.commands]
)
def test_the_help_lists_choices_and_has_an_example_that_parses(package, command):
    entry = GROUPS[package].commands[command]
    assert entry.epilog.startswith(f"Example: {package} {command} ")
    words = shlex.split(entry.epilog.removeprefix(f"Example: {package} {command} "))
    entry.make_context(command, words)
    for option in entry.params:
        if isinstance(option, click.Option) and not option.hidden:
            assert option.help, option.name
            assert option.help.endswith((".", "]", ")")), option.help


def test_choices_are_those_of_the_packages():
    assert tuple(WEAVES) == WEAVE_NAMES
    assert set(get_args(types_of(FitOptions)["kind"])) == set(KINDS)
