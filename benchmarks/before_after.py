"""Two trees of the project side by side: the same commands, the same numbers, and how long each takes.

    git worktree add ../before COMMIT
    python -m benchmarks.before_after ../before

Each command runs in both trees by turns, in folders of their own. Every number of the tables, laws, curtains and rings
that both write is compared. Exit code 1 if one differs by more than `--tolerance`.
"""

import csv
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from benchmarks.machine import ROOT, describe

NO_RESULT = (
    "wall",
    "version",
    "sha256",
    "bytes",
    "files",
    "iterations",
    "work",
    "options",
    "features",
    "worst_S",
    "_R",
    "gap",
)
"""Parts of keys that tell of the run or of its round-off, and not of the answer."""
FLOOR = 1e-6
"""Numbers below this part of the largest of their kind (column, field) are compared with that part."""
ZERO = 1e-3
"""Numbers below this, in mm, N, N/mm or as strains, are compared with it: round-off of what is zero."""
KEPT = 30
"""Kinds of numbers that are printed."""

TABLES = {
    "table 5": "--r1 5 --r2 1 --alpha 0:45:5 --beta 0:90:5",
    "table 10": "--r1 5 --r2 0.5",
    "table 20": "--r1 10 --r2 0.5 --alpha 0:45:15 --beta 10:90:10",
    "table x": "--grain x --alpha -45:45:15 --beta 0:90:15 --compliance 1000",
    "table 6-in-1": "--weave 6-in-1 --r1 8 --r2 1 --alpha -45:45:15 --beta 10:90:20",
}
SCENES = ("corner_hung", "facade_panel", "gathered_with_bar", "passage", "round_net", "shop_front", "turned_weave")
KINDS = ("rigid", "newton")
"""Solver kinds under names that both trees read: this one with a warning."""


def commands(quick: bool) -> Iterator[tuple[str, str]]:
    """Name and command line of each job; files are relative to the folder of a tree."""
    for name, options in TABLES.items():
        yield name, f"rve table {options} --out {name.replace(' ', '_')}.csv"
    yield "law", "homogenize fit table_10.csv --out law.json"
    for angle in ("20,30", "0,90", "45,45"):
        alpha, beta = angle.split(",")
        yield f"strain {angle}", f"homogenize strain law.json --alpha {alpha} --beta {beta}"
    yield "support", "homogenize support law.json --S 0.5,-0.1,0.5"
    for kind in KINDS[:1] if quick else KINDS:
        for scene in SCENES:
            yield (
                f"{scene} {kind}",
                f"macro_fem run {scene}_{kind}.toml --law law.json --out {scene}_{kind} --no-picture",
            )
    yield "rings", "rve localize corner_hung_rigid/curtain.vtu --out rings --no-picture"


def scene_text(path: Path, kind: str, cells: int, tolerance: float) -> str:
    """An example with another solver kind, fewer cells and its own tolerance; bounds belong to rigid curtains."""
    text, _, solver = path.read_text(encoding="utf-8").partition("[solver]")
    lines = [line if not line.startswith("cells =") else f"cells = {cells}" for line in text.splitlines()]
    keys = [f'kind = "{kind}"', f"tolerance = {tolerance:g}", *(solver.splitlines() if kind == "rigid" else ())]
    return "\n".join([*lines, "[solver]", *keys, ""])


def run(tree: Path, folder: Path, line: str) -> tuple[float, int, str]:
    """Processor seconds, exit code and standard output of a command of this tree in this folder."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    code = f"import runpy, sys; sys.path.insert(0, {str(tree)!r}); sys.argv = {line.split()!r}; "
    code += f"runpy.run_module({line.split()[0]!r}, run_name='__main__')"
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.returncode, done.stdout


def numbers(name: str, value: Any) -> Iterator[tuple[str, float]]:
    """Every number below a value read from JSON, with the path to it."""
    if isinstance(value, dict):
        for key, one in value.items():
            if not any(part in f"_{key}" for part in NO_RESULT):
                yield from numbers(f"{name}.{key}", one)
    elif isinstance(value, list):
        for place, one in enumerate(value):
            yield from numbers(f"{name}[{place}]", one)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield name, float(value)


def answers(folder: Path) -> dict[str, float]:
    """Every number of the CSV and JSON files below a folder."""
    found: dict[str, float] = {}
    for path in sorted(folder.rglob("*.json")):
        found |= dict(numbers(str(path.relative_to(folder)), json.loads(path.read_text(encoding="utf-8"))))
    for path in sorted(folder.rglob("*.csv")):
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        data = [{key: float(value) for key, value in row.items() if is_number(value)} for row in rows]
        found |= dict(numbers(str(path.relative_to(folder)), data))
    return found


def is_number(text: str) -> bool:
    """Whether a cell of a CSV file is a finite number."""
    try:
        return abs(float(text)) < float("inf")
    except ValueError:
        return False


def kind_of(name: str) -> str:
    """What numbers are compared with each other in size: a path without its places."""
    return "".join(part.split("]")[-1] for part in name.split("["))


def differences(first: dict[str, float], second: dict[str, float]) -> list[tuple[float, str]]:
    """Relative differences of the numbers that both have, largest first."""
    size: dict[str, float] = {}
    for name, value in first.items():
        size[kind_of(name)] = max(size.get(kind_of(name), 0.0), abs(value))
    both = [name for name in first if name in second]
    scale = {name: max(abs(first[name]), FLOOR * size[kind_of(name)], ZERO) for name in both}
    return sorted(((abs(first[name] - second[name]) / scale[name], name) for name in both), reverse=True)


def largest_of_kinds(found: list[tuple[float, str]]) -> dict[str, tuple[float, str, int]]:
    """The largest difference of each kind of number, its name, and how many there are; the first `KEPT` kinds."""
    kinds: dict[str, tuple[float, str, int]] = {}
    for difference, name in found:
        largest, where, count = kinds.get(kind_of(name), (difference, name, 0))
        kinds[kind_of(name)] = (largest, where, count + 1)
    return dict(list(kinds.items())[:KEPT])


@click.command()
@click.argument("before", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--tolerance", default=1e-9, show_default=True, help="Largest relative difference.")
@click.option("--gap", default=1e-10, show_default=True, help="Tolerance of the curtain solvers.")
@click.option("--cells", default=12, show_default=True, help="Cells along the shorter side of each curtain.")
@click.option("--quick", is_flag=True, help="Rigid curtains only.")
def main(before: Path, tolerance: float, gap: float, cells: int, quick: bool) -> None:
    """Compare the numbers and times of the tree BEFORE with those of this one."""
    trees = {"before": before.resolve(), "now": ROOT}
    with tempfile.TemporaryDirectory() as home:
        folders = {name: Path(home) / name for name in trees}
        for folder in folders.values():
            folder.mkdir()
        for name, folder in folders.items():
            for scene in SCENES:
                for kind in KINDS:
                    text = scene_text(trees[name] / "examples" / f"{scene}.toml", kind, cells, gap)
                    (folder / f"{scene}_{kind}.toml").write_text(text, encoding="utf-8")
        is_same, total = True, dict.fromkeys(trees, 0.0)
        for name, line in commands(quick):
            done = {key: run(tree, folders[key], line) for key, tree in trees.items()}
            for key, (seconds, _, text) in done.items():
                total[key] += seconds
                if text.lstrip().startswith("{"):
                    (folders[key] / f"{name.replace(' ', '_')}.json").write_text(text, encoding="utf-8")
            codes = [done[key][1] for key in trees]
            is_same &= codes[0] == codes[1]
            told = " ".join(f"{key} {done[key][0]:6.2f} s, exit code {done[key][1]};" for key in trees)
            click.echo(f"{name:<28} {told}")
        first, second = answers(folders["before"]), answers(folders["now"])
        shutil.rmtree(home, ignore_errors=True)
    found = differences(first, second)
    is_same &= bool(found) and found[0][0] <= tolerance
    click.echo(f"{len(found)} numbers in both; kinds that differ by more than {tolerance:g}:")
    beyond = [(difference, name) for difference, name in found if not difference <= tolerance]
    for kind, (difference, name, count) in largest_of_kinds(beyond).items():
        click.echo(f"  {difference:.1e} {kind} ({count}), {name}: {first[name]!r} and {second[name]!r}")
    for told, these, others in (("before", first, second), ("now", second, first)):
        kinds = sorted({kind_of(name) for name in these if name not in others})
        click.echo(f"{len(kinds)} kinds of numbers only {told}: {', '.join(kinds[:KEPT]) or 'none'}")
    click.echo(f"processor time: before {total['before']:.1f} s, now {total['now']:.1f} s\n{describe()}")
    sys.exit(0 if is_same else 1)


if __name__ == "__main__":
    main()
