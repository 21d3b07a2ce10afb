"""The frame of all reports: tables and diagrams of a section, and Markdown in which one section is made anew at a time.

A report is a Markdown file with its pictures beside it. A section lies between `<!-- section: key -->` and
`<!-- end of section -->`; what stands outside is written by hand.
"""

import io
import math
import os
import platform
import re
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import distributions
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from benchmarks.measure import ROOT, TEXTS, Row
from rve.common import write_text

MARKERS = "osD^v<>pPX*h"
COLOURS = ["#3f90da", "#e76300", "#832db6", "#717581", "#bd1f01", "#008a6e", "#a96b59", "#b58900", "#1f3a5f", "#92a50f"]
"""Told apart by colour-blind readers, after M. Petroff (arXiv 2107.02270), without colours too light for lines."""


@dataclass(frozen=True)
class Table:
    """Title, names of columns with units, rows of as many texts, and a note below."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


@dataclass(frozen=True)
class Curve:
    """The ladder of one method; pairs that are not finite are left out. Without `joined`, points without a line."""

    label: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    joined: bool = True


@dataclass(frozen=True)
class Diagram:
    """Curves over logarithmic axes."""

    key: str
    title: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]


@dataclass(frozen=True)
class Section:
    """One topic: what was done (Markdown), tables, diagrams, and the conclusion computed from them (Markdown)."""

    title: str
    text: str
    tables: tuple[Table, ...]
    diagrams: tuple[Diagram, ...] = ()
    conclusion: str = ""


def table(title: str, rows: Sequence[Row], forms: Mapping[str, str] = MappingProxyType({}), note: str = "") -> Table:
    """The rows as a table; the longest row gives the columns, shorter ones (failed runs) have dashes in the others.

    `forms` says how a column is written (`.3g` if it is not named): a format of Python or one of `TEXTS`. ValueError
    for a form or a value without a column.

    >>> rows = [{"n": 1, "error": 3.4e-5}, {"n": 2, "_kept": 0.0}]
    >>> table("Runs", rows, {"error": "decade"}).rows
    (('1', '3e-05'), ('2', '-'))
    """
    heads = max(map(_heads, rows), key=len, default=_heads(forms))
    if unknown := {*forms, *(head for row in rows for head in _heads(row))} - {*heads}:
        raise ValueError(f"table '{title}': no columns {sorted(unknown)} among {heads}")
    cells = tuple(tuple(shown(row.get(head), forms.get(head, ".3g")) for head in heads) for row in rows)
    return Table(title, tuple(heads), cells, note)


def _heads(row: Mapping[str, Any]) -> list[str]:
    return [head for head in row if not head.startswith("_")]


def shown(value: Any, form: str = ".3g") -> str:
    """A cell as text."""
    value = value.item() if hasattr(value, "item") else value
    name, *arguments = form.split()
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None or isinstance(value, str):
        return value or "-"
    if name in TEXTS:
        return TEXTS[name](value, *map(float, arguments))
    if isinstance(value, int):
        return f"{value:,d}"
    return format(value, form) if math.isfinite(value) else "-"


def curves(rows: Sequence[Row], by: str, x: str, y: str) -> tuple[Curve, ...]:
    """A curve of the columns x and y for each value in the column `by`, in the order of the rows."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row[by], []).append(row)
    return tuple(
        Curve(name, tuple(float(row[x]) for row in mine), tuple(float(row[y]) for row in mine))
        for name, mine in groups.items()
    )


def markdown(section: Section, stem: str, seconds: float, numerics: str) -> str:
    """The section; its pictures are `stem_key.svg` beside the page, `numerics` the fingerprint of what it measures."""
    parts = [f"## {section.title}" if section.title else "", section.text]
    parts += [f"![{diagram.title}]({stem}_{diagram.key}.svg)" for diagram in section.diagrams]
    parts += [table_text(one) for one in section.tables]
    parts += [f"**Conclusion.** {section.conclusion}"] if section.conclusion else []
    return "\n\n".join([*filter(None, parts), f"*{seconds:.0f} s. {machine()} Numerics {numerics}.*"])


def table_text(one: Table) -> str:
    """Title, head, rows and note in Markdown."""
    rows = [one.columns, ("---",) * len(one.columns), *one.rows]
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n\n".join(filter(None, [f"**{one.title}**" if one.title else "", "\n".join(lines), one.note]))


def find(key: str) -> re.Pattern[str]:
    """What finds a section in a page; its text is the second group."""
    return re.compile(rf"(<!-- section: {key} -->\n)(.*?)(\n<!-- end of section -->)", re.DOTALL)


def write(page: Path, key: str, section: Section, seconds: float, numerics: str) -> None:
    """Puts the section in its place in the page, or at its end, and its pictures beside the page."""
    page.parent.mkdir(parents=True, exist_ok=True)
    before = page.read_text(encoding="utf-8") if page.exists() else f"# {page.stem}\n"
    if not find(key).search(before):
        before += f"\n<!-- section: {key} -->\n\n<!-- end of section -->\n"
    for diagram in section.diagrams:
        write_text(page.parent / f"{page.stem}_{diagram.key}.svg", svg(diagram))
    body = markdown(section, page.stem, seconds, numerics)
    write_text(page, find(key).sub(lambda found: f"{found[1]}\n{body}\n{found[3]}", before))


def svg(diagram: Diagram) -> str:
    """The picture, the same bytes for the same numbers."""
    import matplotlib.pyplot as plt

    settings: dict[Any, Any] = {"svg.hashsalt": diagram.key, "svg.fonttype": "none", "font.size": 10}
    with plt.rc_context(settings):
        figure, ax = plt.subplots(figsize=(7.6, 4.6), layout="constrained")
        for i, curve in enumerate(diagram.curves):
            x, y = np.array(curve.x, dtype=float), np.array(curve.y, dtype=float)
            kept = np.isfinite(x) & np.isfinite(y) & (x > 0.0) & (y > 0.0)
            look: Any = {"marker": MARKERS[i % len(MARKERS)], "color": COLOURS[i % len(COLOURS)], "label": curve.label}
            ax.loglog(x[kept], y[kept], ms=6, lw=1.6, linestyle="-" if curve.joined else "none", **look)
        ax.set(xlabel=diagram.x_label, ylabel=diagram.y_label)
        ax.set_title(diagram.title, loc="left", fontsize=11)
        ax.set_axisbelow(True)
        ax.grid(visible=True, which="major", alpha=0.35)
        ax.legend(fontsize=9, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
        plt.close(figure)
    return "\n".join(line.rstrip() for line in out.getvalue().splitlines()) + "\n"


def machine() -> str:
    """What a section was measured on: processor, system, versions, commit."""
    known = {one.name: one.version for one in distributions()}
    packages = ", ".join(
        f"{name} {known.get(name, 'absent')}" for name in ("numpy", "scipy", "scikit-fem", "scikit-sparse")
    )
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    name = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())
    return (
        f"Machine: {name}, {os.cpu_count()} cores, {platform.system()} {platform.release()}, Python "
        f"{platform.python_version()}; OMP_NUM_THREADS = {os.environ.get('OMP_NUM_THREADS', 'unset')}, load average at "
        f"the end {os.getloadavg()[1]:.1f} (1 is this benchmark). Versions: {packages}. Commit {commit()}."
    )


def commit() -> str:
    """The commit that is measured, and whether code has changed since; what benchmarks write is no code."""
    status = ["status", "--porcelain", "-uno", "--", ".", ":!docs", ":!*.md"]
    said = [
        subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=False).stdout.strip()
        for words in (["rev-parse", "--short", "HEAD"], status)
    ]
    return said[0] + (" with uncommitted changes" if said[1] else "")
