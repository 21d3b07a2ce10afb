"""Makes the report: `python -m benchmarks.every_ring [--full | --quick] [--only SECTION] [--out DIR] [--cases DIR]`."""

from functools import partial
from pathlib import Path

import click

from benchmarks.every_ring import cell, disk, edges, engine, generic, growth, leaving, loose, starts
from benchmarks.every_ring.cases import Store
from benchmarks.machine import ROOT
from benchmarks.report.files import FOLDER, OUT, make
from benchmarks.report.records import Report

REPORT = Report(
    "every_ring",
    "Every ring and the disk",
    "The finite mesh, in which every ring is a rigid body, against the homogenized disk, the periodic cell, a "
    "generic solver and a physics engine; what its answer depends on, and what it leaves undetermined. Every solved "
    "case is kept as a file: the seconds below a section are those of its making from the cases that were there.",
    "OMP_NUM_THREADS=1 python -m benchmarks.every_ring --full",
)
SECTIONS = (disk, edges, cell, generic, engine, starts, leaving, loose, growth)
KEPT = ROOT / "build" / "every_ring"
NAMES = tuple(module.__name__.split(".")[-1] for module in SECTIONS)


@click.command(help=REPORT.text)
@click.option("--full/--quick", default=False, show_default=True, help="all scenes and sizes, or the smallest ones")
@click.option("--only", multiple=True, type=click.Choice(NAMES), help="these sections; others are kept")
@click.option("--out", type=OUT, default=FOLDER, help="folder of the report  [default: docs/reports]")
@click.option(
    "--cases",
    type=OUT,
    default=KEPT,
    help="folder of solved cases, which are not solved again  [default: build/every_ring]",
)
@click.option("--solve/--no-solve", default=True, help="solve cases that are not there, or leave them out")
def main(full: bool, only: tuple[str, ...], out: Path, cases: Path, solve: bool) -> None:
    """The report; every solved case is kept as a file, so that a run that was stopped goes on where it was."""
    measures = {
        name: partial(module.measure, store=Store(cases, is_closed=not solve))
        for name, module in zip(NAMES, SECTIONS, strict=True)
    }
    make(REPORT, measures, full, only, out)


if __name__ == "__main__":
    main()
