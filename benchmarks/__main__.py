"""All reports by one command: `OMP_NUM_THREADS=1 python -m benchmarks [SECTION]... [--full] [--list]`."""

import re
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from time import perf_counter

import click

from benchmarks.frame import Section, commit, find, write
from benchmarks.measure import ROOT

PAGES = {
    "docs/reports/work_precision.md": ("rve", "contact", "law", "curtain", "nested", "chain"),
    "docs/reports/stability.md": ("extremes",),
    "docs/reports/omissions.md": ("motion", "rings", "curtains"),
    "docs/reports/every_ring.md": ("disk", "cell", "generic", "starts", "growth"),
    "docs/measured/steel.md": ("steel",),
    "README.md": ("readme",),
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


def commit_of(key: str) -> str:
    """The commit that a section was measured from, "-" if it is not there."""
    page = SECTIONS[key]
    found = find(key).search(page.read_text(encoding="utf-8")) if page.exists() else None
    commits = re.findall(r"Commit (.+?)\.", found[2]) if found else []
    return commits[-1] if commits else "-"


@click.command(help=__doc__)
@click.argument("names", nargs=-1, type=click.Choice(list(SECTIONS)), metavar="[SECTION]...")
@click.option("--full", is_flag=True, help="More and finer cases, hours.")
@click.option("--list", "lists", is_flag=True, help="Name the sections, their pages and the commits they are of.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Folder for the pages, in place of docs.")
def main(names: tuple[str, ...], full: bool, lists: bool, out: Path | None) -> None:
    """Measures the named sections; by default all that are not of this commit, so that a stopped run goes on."""
    if lists:
        for key, page in SECTIONS.items():
            click.echo(f"{key:10} {page.relative_to(ROOT)}  {commit_of(key)}")
        return
    for key in names or [key for key in SECTIONS if commit_of(key) != commit()]:
        began = perf_counter()
        section = measure_of(key)(full)
        write(out / SECTIONS[key].name if out else SECTIONS[key], key, section, perf_counter() - began)
        click.echo(f"{key}: {perf_counter() - began:.1f} s")


if __name__ == "__main__":
    main()
