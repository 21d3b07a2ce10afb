"""All reports by one command: `OMP_NUM_THREADS=1 python -m benchmarks [SECTION]... [--full] [--list]`."""

import re
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from time import perf_counter

import click

from benchmarks.frame import Section, find, write
from benchmarks.measure import ROOT
from benchmarks.numerics import fingerprint

PAGES = {
    "docs/reports/work_precision.md": ("rve", "contact", "law", "curtain", "nested", "chain", "in_motion"),
    "docs/reports/stability.md": ("extremes",),
    "docs/reports/omissions.md": ("motion", "rings", "curtains"),
    "docs/reports/options.md": ("options",),
    "docs/reports/every_ring.md": ("disk", "let_go", "cell", "generic", "starts", "hooks", "growth"),
    "docs/measured/steel.md": ("steel",),
    "docs/measured/scaling.md": ("scaling",),
    "docs/measured/friction.md": ("friction",),
    "docs/measured/chains.md": ("chains",),
    "docs/measured/others.md": ("others",),
    "docs/measured/peers.md": ("peers",),
    "docs/reports/numbers.md": ("readme",),
}
"""Sections of every page. A section is `measure` of the module of that name, in its page's folder if there is one."""
SECTIONS = {key: ROOT / page for page, keys in PAGES.items() for key in keys}


def measure_of(key: str) -> Callable[[bool], Section]:
    """The function `measure(full)` of a section."""
    folder = SECTIONS[key].stem
    inside = (ROOT / "benchmarks" / folder / f"{key}.py").exists()
    module = import_module(f"benchmarks.{folder}.{key}" if inside else f"benchmarks.{key}")
    measure: Callable[[bool], Section] = module.measure
    return measure


def measured(key: str) -> str:
    """The fingerprint of what a section was measured with, "-" if it is not there."""
    page = SECTIONS[key]
    found = find(key).search(page.read_text(encoding="utf-8")) if page.exists() else None
    marks = re.findall(r"Numerics (\w+)\.", found[2]) if found else []
    return marks[-1] if marks else "-"


def stale() -> list[str]:
    """Sections whose numerics have changed since they were measured."""
    return [key for key in SECTIONS if measured(key) != fingerprint(measure_of(key).__module__)]


@click.command(help=__doc__)
@click.argument("names", nargs=-1, type=click.Choice(list(SECTIONS)), metavar="[SECTION]...")
@click.option("--full", is_flag=True, help="More and finer cases, hours.")
@click.option("--list", "lists", is_flag=True, help="Name the sections, their pages, and which are stale.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Folder for the pages, in place of docs.")
def main(names: tuple[str, ...], full: bool, lists: bool, out: Path | None) -> None:
    """Measures the named sections; by default those whose numerics have changed, so that a stopped run goes on."""
    old = stale() if lists or not names else []
    if lists:
        for key, page in SECTIONS.items():
            click.echo(f"{key:10} {page.relative_to(ROOT)}{'  stale' if key in old else ''}")
        return
    for key in names or old:
        began, measure, page = perf_counter(), measure_of(key), SECTIONS[key]
        section, seconds = measure(full), perf_counter() - began
        write(out / page.name if out else page, key, section, seconds, fingerprint(measure.__module__))
        click.echo(f"{key}: {seconds:.1f} s")


if __name__ == "__main__":
    main()
