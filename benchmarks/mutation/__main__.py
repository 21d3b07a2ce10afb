"""Makes the report: `python -m benchmarks.mutation [--sample 120] [--seed 1] [--only PATH] [--record FILE]`.

The quick tests run once under coverage, which tells the tests that execute each line. Then each mutant of the sample is
put into a temporary copy of the tree, where these tests run, shortest first, until one fails or takes ten times as long
as it should. mutmut and cosmic-ray have neither a seeded sample nor the mistakes listed in `mutants`, and cosmic-ray
runs one command for all mutants.
"""

from __future__ import annotations

import compileall
import contextlib
import json
import os
import py_compile
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from benchmarks.machine import ROOT, describe
from benchmarks.mutation.mutants import Mutant, modules, sample
from benchmarks.mutation.plugin import PACKAGES

SURVIVORS = Path(__file__).with_name("survivors.toml")
PYTEST = (sys.executable, "-m", "pytest", "-p", "benchmarks.mutation.plugin", "-p", "no:cacheprovider")
OPTIONS = ("--hypothesis-seed=0", "--assert=plain", "-x", "-o", "testpaths=")
SLOWDOWN, GRACE = 10.0, 20.0
"""A test may take SLOWDOWN times as long as without the mutant, plus GRACE seconds."""


TEMPLATE = """# Mutation sample of the numerics

Realistic one-line mistakes, made by `{command}`. Each runs the quick tests that execute its line, shortest first, until
one fails. A hang counts as killed. Survivors that are explained count as such and are not run again without `--again`.

{rates}

Tests that failed without a mutant and were left out: {failed}.

{minutes:.0f} min. {machine}

## Not killed

{left}

## All mutants

| state | place | change | killed by |
|---|---|---|---|
{table}
"""


@dataclass(frozen=True)
class Verdict:
    """What became of a mutant: "killed", "survived" or "not covered"; the test that killed it, and how."""

    mutant: Mutant
    state: str
    by: str
    tests: int


def copy_tree(folder: Path) -> Path:
    """The tree in a new folder, compiled; sources are told by their content, since a mutant may keep time and size."""
    shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(".*", "__pycache__", "*.egg-info", "build"))
    compileall.compile_dir(folder, quiet=2, invalidation_mode=py_compile.PycInvalidationMode.CHECKED_HASH)
    return folder


def run_pytest(folder: Path, arguments: list[str], **environment: str) -> int:
    """Exit code of pytest in a folder; negative where a signal ended it. Nothing that it started stays."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "PYTHONDONTWRITEBYTECODE"), "1")
    env = {**os.environ, "MPLBACKEND": "Agg", **threads, **environment}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    run = subprocess.Popen([*PYTEST, *arguments], cwd=folder, env=env, start_new_session=True, **quiet)
    try:
        return run.wait()
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(run.pid, signal.SIGKILL)


def tests_of(mutant: Mutant, record: dict[str, Any]) -> list[str]:
    """Passing tests that execute the mutated line, shortest first; for lines run at import, all tests of the module."""
    lines = {int(line): tests for line, tests in record["lines"].get(mutant.file, {}).items()}
    first, last = mutant.lines or (0, 0)
    reached = [tests for line, tests in lines.items() if first <= line <= last]
    found = {test for tests in reached for test in tests}
    if not found and (reached or not mutant.lines):
        found = {test for tests in lines.values() for test in tests}
    return sorted(found - set(record["failed"]), key=lambda test: (record["seconds"][test], test))


def verdict(folder: Path, mutant: Mutant, record: dict[str, Any]) -> Verdict:
    """Run a mutant in a copy of the tree, which is as before afterwards."""
    tests = tests_of(mutant, record)
    if not tests:
        return Verdict(mutant, "not covered", "", 0)
    path, plan = folder / mutant.file, folder / "mutation.json"
    source = path.read_bytes()
    plan.write_text(json.dumps([[test, GRACE + SLOWDOWN * record["seconds"][test]] for test in tests]))
    last = Path(f"{plan}.last")
    last.unlink(missing_ok=True)
    try:
        path.write_bytes(mutant.applied(source))
        files = list(dict.fromkeys(test.split("::")[0] for test in tests))
        code = run_pytest(folder, [*OPTIONS, *files], MUTATION_RUN=str(plan))
    finally:
        path.write_bytes(source)
        shutil.rmtree(folder / ".hypothesis", ignore_errors=True)
    if code in (0, 5):
        return Verdict(mutant, "survived" if code == 0 else "not covered", "", len(tests))
    how = {-signal.SIGALRM: " (time limit)", 1: ""}.get(code, f" (exit code {code})")
    return Verdict(mutant, "killed", (last.read_text() if last.exists() else "import of the tests") + how, len(tests))


def record_of(folder: Path, keep: Path | None) -> dict[str, Any]:
    """Which test executes which line and for how long: from the file `keep` if it is there, else by running them."""
    out = keep or folder / "record.json"
    if not out.exists():
        run_pytest(folder, ["--hypothesis-seed=0"], MUTATION_RECORD=str(out.absolute()))
    record: dict[str, Any] = json.loads(out.read_text())
    return record


def explained() -> dict[tuple[str, str, str, str], str]:
    """Why a survivor is none that a test should notice, by its key."""
    entries = tomllib.loads(SURVIVORS.read_text()).get("survivor", []) if SURVIVORS.exists() else []
    return {(e["file"], e["code"], e["was"], e["now"]): e["why"] for e in entries}


def key_of(mutant: Mutant) -> tuple[str, str, str, str]:
    """What a survivor is known by: file, line of code before the change, and the change."""
    code = (ROOT / mutant.file).read_text(encoding="utf-8").splitlines()[mutant.line - 1].strip()
    return mutant.file, code, mutant.was, mutant.now


def report(verdicts: list[Verdict], record: dict[str, Any], command: str, seconds: float) -> str:
    """The report in Markdown."""
    rows = ["| package | mutants | killed | survived | not covered | killed, % |", "|---|---|---|---|---|---|"]
    for package in (*PACKAGES, ""):
        count = Counter(v.state for v in verdicts if v.mutant.file.startswith(package))
        if total := sum(count.values()):
            states = " | ".join(str(count[state]) for state in ("killed", "survived", "not covered"))
            rows.append(f"| {package or 'all'} | {total} | {states} | {100.0 * count['killed'] / total:.0f} |")
    reasons, left, table = explained(), [], []
    for v in verdicts:
        m = v.mutant
        change = f"`{_cell(m.was)}` → `{_cell(m.now)}`"
        table.append(f"| {v.state} | {m.file}:{m.line} | {change} | {_cell(v.by)} |")
        if v.state != "killed":
            why = reasons.get(key_of(m), "**not explained**")
            tests = f"{v.tests} tests" if v.tests else "not run"
            left.append(f"- {m.file}:{m.line}, in `{_cell(key_of(m)[1])}`: {change}, {tests}. {why}")
    return TEMPLATE.format(
        command=command,
        rates="\n".join(rows),
        failed=", ".join(record["failed"]) or "none",
        minutes=seconds / 60.0,
        machine=describe(),
        left="\n".join(left) or "None.",
        table="\n".join(table),
    )


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


@click.command()
@click.option("--sample", "n", default=120, show_default=True, help="Number of mutants.")
@click.option("--seed", default=1, show_default=True, help="Seed of the sample.")
@click.option("--only", default="", help="Beginning of the paths to mutate, say macro_fem/solvers/soc.py.")
@click.option("--workers", default=2, show_default=True, help="Mutants that run at the same time.")
@click.option("--record", "keep", type=click.Path(path_type=Path), help="Keep or reuse the tests' record here.")
@click.option("--again", is_flag=True, help="Run mutants that are explained survivors, too.")
@click.option("--out", default=ROOT / "docs/reports/mutation.md", type=click.Path(path_type=Path), help="The report.")
def main(n: int, seed: int, only: str, workers: int, keep: Path | None, again: bool, out: Path) -> None:
    """Put mistakes into the numerics and state which ones the quick tests notice."""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(workers) as pool:
        folders: queue.Queue[Path] = queue.Queue()
        for i in range(workers):
            folders.put(copy_tree(Path(name) / f"tree{i}"))
        record = record_of(Path(name) / "tree0", keep)
        known = {} if again else explained()

        def judged(mutant: Mutant) -> Verdict:
            if key_of(mutant) in known:  # a survivor runs all its tests, for minutes
                return Verdict(mutant, "survived", "", 0)
            folder = folders.get()
            found = verdict(folder, mutant, record)
            folders.put(folder)
            change = f"{mutant.file}:{mutant.line} {mutant.was} -> {mutant.now}"
            click.echo(f"{found.state:11} {change}  {found.by}", err=True)
            return found

        verdicts = list(pool.map(judged, sample(ROOT, modules(ROOT, PACKAGES, only), n, seed)))
    command = f"python -m benchmarks.mutation --sample {n} --seed {seed}" + (f" --only {only}" if only else "")
    out.write_text(report(verdicts, record, command, time.perf_counter() - began), encoding="utf-8")
    click.echo(out)


if __name__ == "__main__":
    main()
