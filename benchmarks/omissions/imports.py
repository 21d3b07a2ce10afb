"""The cost of imports: each package, the help of each command, and all packages together."""

import resource
import sys

import click

from benchmarks.report.measure import Row, last_line
from benchmarks.report.records import Diagram, Section, curves, table

PACKAGES = ("rve.table", "rve.cli", "homogenize", "homogenize.cli", "macro_fem.cli")
HEAVY = ("scipy", "skfem", "meshio", "matplotlib", "clarabel", "pyvista", "pandas", "sksparse")
RUNS = 3
WHAT = "command or import"

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
    eager = ("matplotlib.pyplot", *HEAVY, *(f"{name}.cli" for name in ("rve", "homogenize", "macro_fem")))
    codes = {"python alone": "print('[0, [], []]')"}
    codes |= {f"import {name}": PROBE.format(names=(name,), heavy=HEAVY) for name in PACKAGES}
    for package, arguments in helps():
        codes[f"{package} {' '.join(arguments)}"] = HELP.format(package=package, arguments=arguments, heavy=HEAVY)
    codes["everything at once"] = PROBE.format(names=eager, heavy=HEAVY)
    rows = [row_of(name, *probe(code, runs)) for name, code in codes.items()]
    text = (
        f"Processor seconds of a new interpreter, least of {runs} runs, and the heavy packages it has loaded. The "
        "first row is the interpreter alone. Heavy packages are those of solvers, pictures and other formats: "
        f"{', '.join(HEAVY)}. They are imported inside the functions that use them."
    )
    alone, *ours, eager_row = rows
    loaded = sorted({name for row in ours for name in row["_heavy"]})
    what = f"Packages and helps load only {', '.join(loaded)}" if loaded else "No package and no help loads any of them"
    conclusion = (
        f"{what}. The slowest takes {max(row['s'] for row in ours):.2f} s; all packages together take "
        f"{eager_row['s']:.2f} s, of which Python itself takes {alone['s']:.2f} s."
    )
    shown = [*ours[: len(PACKAGES)], eager_row]
    placed = [row | {"_place": place, "_name": "least of some runs"} for place, row in enumerate(shown)]
    ticks = tuple(row[WHAT].replace("import ", "").replace(".", ".\n").replace(" ", "\n") for row in placed)
    drawn = curves(placed, "_name", "_place", "s")
    diagram = Diagram("imports", "Time to import", "what", "processor time (s)", drawn, bars=True, ticks=ticks)
    return Section("Heavy imports", text, (table("Imports", rows, {"s": ".2f timed"}),), (diagram,), conclusion)


def row_of(name: str, seconds: float, heavy: list[str], absent: list[str]) -> Row:
    """The cells of one probe."""
    row = {WHAT: name, "s": seconds, "heavy packages loaded": ", ".join(heavy) or "none", "absent": ", ".join(absent)}
    return row | {"_heavy": heavy}


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
    seconds = []
    for _ in range(runs):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        _, heavy, absent = last_line([sys.executable, "-c", code])
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(seconds), heavy, absent
