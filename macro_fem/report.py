"""The report of a run: two pages of A4, or more of long tables, as PDF, vector graphics by matplotlib."""

import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from macro_fem.curtain import CurtainSolution
from macro_fem.judged import first_of_largest, links, spot_loads
from macro_fem.output.pictures import plot_line_loads, plot_utilisation
from macro_fem.output.told import (
    combination_lines,
    components,
    lean_note,
    limit_line,
    loads_in_words,
    order_lines,
    verdict,
)
from macro_fem.summary import CurtainSummary, SupportForce
from rve.common import atomic_path, checksum, digits
from rve.common.drawing.plane import BLUE, VERMILION, as_typed, new_figure
from rve.common.optional import Axes, Figure

A4 = (8.27, 11.69)
WIDTH = 112
"""Characters of a line."""
TOP, FOOT, LINE, FEWEST = 0.93, 0.05, 0.0138, 8
"""Where text begins and ends on a page, the height of a line, and the fewest lines of a section that are parted."""
MOST_ROWS, ROW = 44, "{:<31}{:<18}{:<20}{:<10}{}"
"""Most rows in the table of forces, those with the largest ones, and the form of a row."""
LIMITS = (
    "Rings are tori in contact without friction. Where the mesh is locked it gives no more, or as much as its rings "
    "bend; friction would hold folds that are shown as free to slip.",
    "The mesh is a homogenized membrane with the holes of the scene; seams and repairs are not in it. Forces at a hook "
    "are those of the rings that share it, as the scene states.",
    "Where balance leaves open how supports share the load, forces and factors are those of elastic rings, or one "
    "choice of many by a law without stiffness. Next to held and loaded points colours are no measure, as line loads "
    "grow there with every refinement: factors follow from averages over a cell of the weave, and from these forces.",
    "Factors are times all loads until the first ring yields, or a hook reaches its stated capacity, at the shape that "
    "is shown. They are no margin for wear, fatigue, impact, or wire weaker than stated. Partial factors are those of "
    "the load combinations, if there are any.",
)
"""What holds for every answer by a law."""


def write_report(
    path: str | Path, solution: CurtainSolution, summary: CurtainSummary, inputs: Iterable[Path | None] = ()
) -> None:
    """Write the report as PDF: scene with dimensions, shape, order; then forces, factors, limits, versions.

    `inputs`: files whose checksums the report states. InputError if the file cannot be written.
    """
    from matplotlib.backends.backend_pdf import PdfPages

    title = f"Curtain of ring mesh: {Path(solution.problem.scene.source).stem}"
    first = _page(title)
    _draw_scene(solution, first.add_axes((0.1, 0.56, 0.8, 0.29)))
    shape = first.add_axes((0.14, 0.24, 0.74, 0.28))
    plot_line_loads(solution, shape).legend().remove()
    shape.set_title("")
    shape.set_title("As it hangs: largest principal line load, and its direction", fontsize=8, loc="left")
    words, holds = verdict(summary)
    forces = _largest_forces(summary) if summary.envelope is not None else _forces(summary.support_forces)
    forces = [*forces, (0.0, "none", "")]
    size, name, _ = forces[first_of_largest([size for size, *_ in forces])]
    largest = f"Largest force of a support: {digits(size)} N ({name})"
    _section(first, 0.945, words, [largest], BLUE if holds else VERMILION)
    mesh, *more = (line.strip().removeprefix("order: ") for line in order_lines(summary.order))
    joint, stress = summary.ring_joint, summary.ring_yield_N_per_mm2
    closed = {None: "", "welded": "welded, "}.get(joint, "bent and not welded, ")
    rings = f"rings {closed}yield stress {'not known' if stress is None else f'{stress:g} N/mm2'}"
    order = [mesh, *more, rings, f"mean height {summary.mean_height_mm:.1f} mm"]
    _section(first, 0.18, "What to order, and how it hangs", _wrapped(order))
    pages, y = [first], FOOT
    loads = "Loads, at x and y in the flat sheet, mm", [loads_in_words(solution.problem.scene)], False
    for head, lines, is_table in (loads, *_sections(summary, filter(None, inputs))):
        left = _wrapped(lines, is_table)
        while left:
            if (room := int((y - FOOT) / LINE) - 3) < min(len(left), FEWEST):
                pages.append(_page(title))
                y, room = TOP, int((TOP - FOOT) / LINE) - 3
            y = _section(pages[-1], y, head, left[:room], is_table=is_table)
            left = left[room:]
    if y > 0.42 and summary.utilisation_max is not None:
        used = pages[-1].add_axes((0.14, 0.1, 0.74, y - 0.14))
        plot_utilisation(solution, used).legend().remove()
        used.set_title("Where the rings are used", fontsize=8, loc="left")
    for number, page in enumerate(pages, 1):
        page.text(0.92, 0.03, f"page {number} of {len(pages)}", size=8, ha="right")
    told = {"Title": title, "Creator": "macro_fem", "CreationDate": None}
    with atomic_path(path) as temporary, PdfPages(temporary, metadata=told) as file:
        for page in pages:
            file.savefig(as_typed(page))


def _page(title: str) -> Figure:
    """A page with its head."""
    figure = new_figure(*A4)
    figure.set_layout_engine("none")
    figure.text(0.08, 0.955, title, size=15, weight="bold")
    return figure


def _wrapped(lines: Iterable[str], is_table: bool = False) -> list[str]:
    """Lines as long as fit a page, which begin with a capital letter; those of tables are as they are."""
    each = ([line] if is_table else textwrap.wrap(line[:1].upper() + line[1:], WIDTH) for line in lines)
    return [part for parts in each for part in parts]


def _section(
    page: Figure, y: float, title: str, text: list[str], colour: str = "#111111", is_table: bool = False
) -> float:
    """A title and lines of text below the height `y`; the height below them."""
    head = textwrap.wrap(title[:1].upper() + title[1:], 90)
    page.text(0.08, y, "\n".join(head), size=10, weight="bold", va="top", color=colour, linespacing=1.25)
    y -= 0.006 + 0.0148 * len(head)
    family = "monospace" if is_table else "sans-serif"
    page.text(0.08, y, "\n".join(text), size=8 if is_table else 9, family=family, va="top", linespacing=1.25)
    return y - LINE * len(text) * (0.9 if is_table else 1.0) - 0.015


def _sections(summary: CurtainSummary, inputs: Iterable[Path]) -> Iterable[tuple[str, Iterable[str], bool]]:
    """Titles and lines of the further pages, and whether the lines are a table."""
    coarse = "at most " if summary.utilisation_too_low else ""
    is_combined, given = summary.combinations is not None, links(summary, summary.support_forces)
    factors = [f"{one.name}: at {coarse * (one.name == 'mesh')}{digits(one.factor)} times the load" for one in given]
    if is_combined:
        yield "Load combinations", combination_lines(summary), False
    of = " without partial factors" * is_combined
    factors += filter(None, [limit_line(summary)])
    yield f"What gives first{of}", factors or ["nothing whose strength is known is loaded"], False
    own = ROW.format("support", "x y in sheet, mm", "x y (z) hung, mm", "force, N", "its x y (z), N")
    tables = [(f"Forces of supports{of}", own, _forces(summary.support_forces))]
    if is_combined:
        head = ROW.format("support", "x y in sheet, mm", "", "force, N", "under")
        tables.insert(0, ("Largest forces of supports under the combinations", head, _largest_forces(summary)))
    for title, head, rows in tables:
        shown = sorted(sorted(range(len(rows)), key=lambda number: -rows[number][0])[:MOST_ROWS])
        most = "" if len(shown) == len(rows) else f", the {len(shown)} largest of {len(rows)}"
        yield f"{title}{most}", [head, *(rows[number][2] for number in shown)], True
    yield (
        "Assumptions and limits",
        filter(None, [*LIMITS, summary.governing_note, summary.single_forces_note, lean_note(summary)]),
        False,
    )
    versions = ", ".join(f"{key} {value}" for key, value in summary.versions.items())
    yield "Versions and files", [versions, *(f"SHA-256 of {one.name}: {checksum(one)}" for one in inputs)], False


def _forces(supports: Sequence[SupportForce]) -> list[tuple[float, str, str]]:
    """Size, name and row of each force: those of single points, and of each edge or area the sum."""
    rows = []
    for number, one in enumerate(supports, 1):
        of = f" of support {number}" if len(supports) > 1 else ""
        parts: list[tuple[str, Sequence[float], Sequence[float], Sequence[float]]]
        parts = [(f"{one.support}{of}, sum", (), (), one.force_N)]
        if one.largest_force_per_ring_N is not None:
            parts = [(f"{part.point}{of}", part.at_mm, part.place_mm, part.force_N or ()) for part in one.points]
        for name, *places, force in parts:
            at, place = (" ".join(f"{round(x)}" for x in where) for where in places)
            size = float(np.linalg.norm(force))
            rows.append((size, name, ROW.format(name, at, place, digits(size), components(*force))))
    return rows


def _largest_forces(summary: CurtainSummary) -> list[tuple[float, str, str]]:
    """Size, name and row of the largest force of each single point, and of each edge or area the largest sum."""
    supports, most, rows = summary.support_forces, summary.envelope, []
    assert most is not None
    for one in (*most.support_sums, *most.support_forces):
        is_sum = one.point is None
        is_single = supports[one.support_number - 1].largest_force_per_ring_N is not None
        if is_sum != is_single:
            of = f" of support {one.support_number}" if len(supports) > 1 else ""
            name = f"{one.support}{of}, sum" if is_sum else f"{one.point}{of}"
            at = "" if one.x_mm is None or one.y_mm is None else f"{round(one.x_mm)} {round(one.y_mm)}"
            size, under = one.force_N, one.combination
            rows.append((size, f"{name}, {under}", ROW.format(name, at, "", digits(size), under)))
    return rows


def _draw_scene(solution: CurtainSolution, ax: Axes) -> None:
    """The flat sheet with its outline, dimensions, held points and edges, and loads at points."""
    scene, mesh = solution.problem.scene, solution.problem.mesh.mesh
    ax.plot(*mesh.p[:, mesh.facets[:, mesh.boundary_facets()]], color="#555555", lw=1.0)
    for held in solution.problem.supports.held:
        marker, dot = ("s", 2) if len(held.facets) else ("v", 5)
        ax.plot(*solution.problem.disc.nodes[held.nodes].T, marker, color="#111111", ms=dot)
    (x0, y0), (x1, y1) = mesh.p.min(axis=1), mesh.p.max(axis=1)
    width, height = scene.curtain.extent(mesh.p.T).tolist()
    size = max(width, height)
    off = 0.06 * size

    def span(start: Any, end: Any, at: Any, told: str, **style: Any) -> None:
        ax.annotate("", start, end, arrowprops={"arrowstyle": "<->", "lw": 0.8, "shrinkA": 0, "shrinkB": 0})
        ax.text(at[0], at[1], told, va="center", size=8, **style)

    middle: dict[str, Any] = {"ha": "center", "backgroundcolor": "white"}
    span((x0, y0 - off), (x1, y0 - off), (0.5 * (x0 + x1), y0 - off), f"{width:g} mm", **middle)
    span((x1 + off, y0), (x1 + off, y1), (x1 + off, 0.5 * (y0 + y1)), f"{height:g} mm", rotation=90, **middle)
    for row in solution.problem.mesh.hooks.values():
        first, (x, y) = np.add(mesh.p[:, row.nodes[:2]].T, [0.0, 0.6 * off])
        span(first, (x, y), (x + 0.2 * off, y), f"{len(row.nodes)} points, {row.pitch:g} mm apart")
    for _, one in spot_loads(scene):
        way = np.array(one.force[:2]) / (np.linalg.norm(one.force) or 1.0) * 0.1 * size
        ax.annotate("", np.add(one.at, way), one.at, arrowprops={"arrowstyle": "->", "color": VERMILION, "lw": 1.5})
    ax.set_title("Flat sheet, mm", fontsize=8, loc="left")
    ax.set(xlim=(x0 - off, x1 + 2 * off), ylim=(y0 - 2 * off, y1 + 1.8 * off), aspect="equal")
    ax.axis("off")
