"""A report as files: `key.json` (data), `key.md`, one SVG for each diagram, and its part of `report.html`.

Markdown is the source of the page: `report.html` is the Markdown of all reports through markdown-it with the pictures
inline, so that it depends on no other file and no network.
"""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter

import click

from benchmarks.machine import ROOT, describe
from benchmarks.report.picture import svg
from benchmarks.report.records import Report, Section, Table, from_json, shown, to_json
from rve.common.storage.files import write_text

FOLDER = ROOT / "docs" / "reports"
OUT = click.Path(path_type=Path, file_okay=False)
ORDER = ("work_precision", "stability", "omissions", "every_ring")
STYLE = """
:root { color-scheme: light dark; --line: #8884; --head: #8882; }
body { font: 16px/1.55 system-ui, sans-serif; margin: 0 auto; max-width: 72rem; padding: 1rem 1.5rem 4rem; }
nav { position: sticky; top: 0; background: Canvas; border-bottom: 1px solid var(--line); padding: .5rem 0; }
nav a { margin-right: 1.2rem; }
h1 { margin-top: 3rem; } h2 { margin-top: 2.5rem; border-bottom: 1px solid var(--line); }
.scroll { overflow-x: auto; } table { border-collapse: collapse; font-size: .86rem; margin: .8rem 0; }
th, td { border: 1px solid var(--line); padding: .2rem .55rem; text-align: left; vertical-align: top; }
th { background: var(--head); } svg { max-width: 100%; height: auto; background: #fff; margin: .6rem 0; }
code { background: var(--head); padding: .05rem .25rem; border-radius: 3px; }
"""

Measure = Callable[[bool], Section]
"""A section's measurement: takes whether the full form is asked for."""


def markdown(report: Report) -> str:
    """The whole report; pictures are named relative to it."""
    lines = [f"# {report.title}", "", report.text, "", f"Made by `{report.command}`."]
    for section in report.sections:
        lines += ["", f"## {section.title}"] + (["", section.text] if section.text else [])
        for diagram in section.diagrams:
            lines += ["", f"![{diagram.title}]({report.key}_{diagram.key}.svg)"]
        for table in section.tables:
            lines += ["", *table_lines(table)]
        if section.conclusion:
            lines += ["", f"**Conclusion.** {section.conclusion}"]
        if section.machine:
            lines += ["", f"*{section.seconds:.0f} s. {section.machine}*"]
    return "\n".join(lines) + "\n"


def table_lines(table: Table) -> list[str]:
    """Title, header, rows and note in Markdown."""
    head = [column.name for column in table.columns]
    rows = [[shown(v, c.form) for v, c in zip(row, table.columns, strict=True)] for row in table.rows]
    lines = [" | ".join(cell.replace("|", "\\|") for cell in row) for row in [head, ["---"] * len(head), *rows]]
    title = [f"**{table.title}**", ""] if table.title else []
    note = ["", table.note] if table.note else []
    return [*title, *(f"| {line} |" for line in lines), *note]


def write_markdown(report: Report, folder: Path) -> None:
    """`key.md` and its pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    for section in report.sections:
        for diagram in section.diagrams:
            write_text(folder / f"{report.key}_{diagram.key}.svg", svg(diagram))
    write_text(folder / f"{report.key}.md", markdown(report))


def write(report: Report, folder: Path) -> None:
    """All files of the report, and the page of all reports in the folder."""
    write_markdown(report, folder)
    write_text(folder / f"{report.key}.json", json.dumps(to_json(report), indent=1, allow_nan=False) + "\n")
    write_text(folder / "report.html", page(folder))


def write_page(path: Path, title: str, text: str, command: str, measure: Callable[[], Section]) -> None:
    """A page of one section outside of the reports: its Markdown and pictures."""
    write_markdown(Report(path.stem, title, text, command, (measured(measure),)), path.parent)


def write_between_marks(page: Path, module: str, table: Table) -> None:
    """Puts the table and the machine between the marks that a page holds for `python -m module`, and prints them."""
    text = "\n".join(["", *table_lines(table), "", describe(), ""])
    begin, end = f"<!-- measured: python -m {module} -->\n", "\n<!-- end of measured -->"
    before, rest = page.read_text(encoding="utf-8").split(begin)
    write_text(page, before + begin + text + end + rest.split(end)[1])
    click.echo(text)


def read(key: str, folder: Path) -> Report | None:
    """The report as it was last written there, or None."""
    path = folder / f"{key}.json"
    return from_json(json.loads(path.read_text(encoding="utf-8"))) if path.exists() else None


def page(folder: Path) -> str:
    """The self-contained HTML page of all reports in the folder."""
    from markdown_it import MarkdownIt

    render = MarkdownIt("commonmark").enable("table").render
    links, parts = [], []
    for key in ORDER:
        path = folder / f"{key}.md"
        if not path.exists():
            continue
        text = path.read_text(encoding="utf-8")
        links.append(f'<a href="#{key}">{text.splitlines()[0].lstrip("# ")}</a>')
        body = re.sub(r'<img src="([^"]+\.svg)" alt="([^"]*)" />', lambda m: _inline(folder, m[1], m[2]), render(text))
        body = body.replace("<table>", '<div class="scroll"><table>').replace("</table>", "</table></div>")
        parts.append(f'<section id="{key}">\n{body}</section>')
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>Ring mesh: reports</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{STYLE}</style></head>\n<body><nav>{''.join(links)}</nav>\n" + "\n".join(parts) + "\n</body></html>\n"
    )


def command(report: Report, measures: Mapping[str, Measure]) -> click.Command:
    """The report's command line: each measure in turn; files are written after every one."""

    @click.command(help=report.text)
    @click.option("--full/--quick", default=False, show_default=True, help="more and finer cases, or under ten minutes")
    @click.option("--only", multiple=True, type=click.Choice(list(measures)), help="these sections; others are kept")
    @click.option("--out", type=OUT, default=FOLDER, help="folder  [default: docs/reports]")
    def main(full: bool, only: tuple[str, ...], out: Path) -> None:
        make(report, measures, full, only, out)

    return main


def make(report: Report, measures: Mapping[str, Measure], full: bool, only: tuple[str, ...], out: Path) -> None:
    """Measures the sections (`only` these; others are kept) and writes the report after every one."""
    before = read(report.key, out)
    kept = {section.key: section for section in before.sections} if before else {}
    for key in only or measures:
        kept[key] = measured(partial(measures[key], full), key)
        write(replace(report, sections=tuple(kept[name] for name in measures if name in kept)), out)
        click.echo(f"{report.key} {key}: {kept[key].seconds:.1f} s")
    click.echo(f"{out / report.key}.md")


def measured(measure: Callable[[], Section], key: str = "") -> Section:
    """The section with its key, the machine and the wall time of its measurement."""
    began = perf_counter()
    section = measure()
    return replace(section, key=key, machine=describe(), seconds=perf_counter() - began)


def _inline(folder: Path, name: str, title: str) -> str:
    """The picture itself, with its title for those who cannot see it."""
    text = (folder / name).read_text(encoding="utf-8")
    return text.replace("<svg ", f'<svg role="img" aria-label="{title}" ', 1)
