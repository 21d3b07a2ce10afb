"""What importing costs: each package, the help of each command, and everything at once."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import click

from benchmarks.pages.model import Column, Curve, Diagram, Section, Table

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("rve.table", "rve.cli", "homogenize.law", "homogenize.cli", "macro_fem.cli")
HEAVY = ("scipy", "skfem", "meshio", "matplotlib", "clarabel", "pyvista", "pandas", "sksparse", "pyamg")
RUNS = 3

PROBE = """
import importlib, json, sys
missing = []
for name in {names!r}:
    try:
        importlib.import_module(name)
    except ImportError:
        missing.append(name)
print(json.dumps([len(sys.modules), [name for name in {heavy!r} if name in sys.modules], missing]))
"""
HELP = """
import contextlib, io, json, sys
from {package}.cli import main
with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
    main({arguments!r})
print(json.dumps([len(sys.modules), [name for name in {heavy!r} if name in sys.modules], []]))
"""


def measure(full: bool) -> Section:
    """The section."""
    runs = 2 * RUNS if full else RUNS
    start = probe("print('[0, [], []]')", runs)[0]
    rows = [(f"import {name}", *probe(PROBE.format(names=(name,), heavy=HEAVY), runs)) for name in PACKAGES]
    rows += [
        (
            f"{package} {' '.join(arguments)}",
            *probe(HELP.format(package=package, arguments=arguments, heavy=HEAVY), runs),
        )
        for package, arguments in helps()
    ]
    eager = ("matplotlib.pyplot", *HEAVY, *(f"{name}.cli" for name in ("rve", "homogenize", "macro_fem")))
    rows.append(("everything at once", *probe(PROBE.format(names=eager, heavy=HEAVY), runs)))
    text = (
        f"Processor seconds of a new interpreter, least of {runs} runs, and what it has loaded. Python alone takes "
        "what the first row says. Heavy are the packages that solvers, pictures and other formats need: "
        f"{', '.join(HEAVY)}. All imports of them stand in the functions that use them."
    )
    columns = (
        Column("command or import"),
        Column("s", ".2f", timed=True),
        Column("heavy packages loaded"),
        Column("absent"),
    )
    shown = [("python alone", start, "none", "")]
    shown += [(name, seconds, ", ".join(heavy) or "none", ", ".join(absent)) for name, seconds, heavy, absent in rows]
    longest = max(seconds for name, seconds, _, _ in rows[:-1])
    loaded = sorted({name for _, _, heavy, _ in rows[:-1] for name in heavy})
    what = (
        f"Packages and helps load {', '.join(loaded)} alone" if loaded else "No package and no help loads any of them"
    )
    conclusion = (
        f"{what}; the slowest takes {longest:.2f} s, everything at once {rows[-1][1]:.2f} s, of which Python itself "
        f"takes {start:.2f} s."
    )
    picks = [*rows[: len(PACKAGES)], rows[-1]]
    curve = Curve("least of some runs", tuple(map(float, range(len(picks)))), tuple(row[1] for row in picks))
    ticks = tuple(row[0].replace("import ", "").replace(".", ".\n").replace(" ", "\n") for row in picks)
    diagram = Diagram("imports", "Time to import", "what", "processor time (s)", (curve,), bars=True, ticks=ticks)
    tables = (Table("Imports", columns, tuple(shown)),)
    return Section("imports", "Heavy imports", text, tables, (diagram,), conclusion)


def helps() -> list[tuple[str, list[str]]]:
    """The help of every package and command."""
    found = []
    for package in ("rve", "homogenize", "macro_fem"):
        main = __import__(f"{package}.cli", fromlist=["main"]).main
        assert isinstance(main, click.Group)
        found += [(package, ["--help"]), *((package, [name, "--help"]) for name in sorted(main.commands))]
    return found


def probe(code: str, runs: int = RUNS) -> tuple[float, list[str], list[str]]:
    """Least processor seconds of a new interpreter that runs the code; heavy packages loaded, and those absent."""
    seconds, answer = [], "[0, [], []]"
    for _ in range(runs):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        run = subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, env=os.environ, capture_output=True, text=True, check=True
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
        answer = run.stdout.strip().splitlines()[-1]
    _, heavy, absent = json.loads(answer)
    return min(seconds), heavy, absent
