"""The report of a run: two pages of A4 as PDF, vector graphics by matplotlib."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from macro_fem.output.plots import plot_line_loads
from macro_fem.output.weakest import holds_line, links
from macro_fem.scene.tables import Bar, EdgeLoad, PatchLoad, PointLoad, Wind
from macro_fem.solution import CurtainSolution
from rve.common.drawing.plane import BLUE, VERMILION, new_figure
from rve.common.files import atomic_path, checksum

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

A4 = (8.27, 11.69)
MOST_ROWS = 22
"""Most points in the table of forces: those with the largest ones."""
LIMITS = (
    "Rings are tori in contact without friction. Where the mesh is locked it gives no more, or as much as its rings "
    "bend; friction would hold folds that are shown as free to slip.",
    "The mesh is a homogenized membrane: holes, seams and repairs are not in it. Forces at a hook are those of the "
    "rings that share it, as the scene states.",
    "Factors are times all loads until the first ring yields, or a hook reaches its stated capacity, at the shape that "
    "is shown. They are no margin for wear, fatigue, impact, or wire weaker than stated. Partial factors are those of "
    "the load combinations, if there are any.",
)
"""What holds for every answer by a law."""


def write_report(
    path: str | Path, solution: CurtainSolution, summary: dict[str, Any], inputs: Iterable[Path | None] = ()
) -> None:
    """Write the report as PDF: scene with dimensions, shape, order; then forces, factors, limits, versions.

    `inputs`: files whose checksums the report states. InputError if the file cannot be written.
    """
    from matplotlib.backends.backend_pdf import PdfPages

    name = Path(solution.problem.scene.source).stem
    pages = [_first(solution, summary, name), _second(summary, name, [one for one in inputs if one is not None])]
    told = {"Title": f"Curtain of ring mesh: {name}", "Creator": "macro_fem", "CreationDate": None}
    with atomic_path(path) as temporary, PdfPages(temporary, metadata=told) as file:
        for page in pages:
            file.savefig(page)


def _page(name: str, number: int) -> Figure:
    """A page with its head and foot."""
    figure = new_figure(*A4)
    figure.set_layout_engine("none")
    figure.text(0.08, 0.955, f"Curtain of ring mesh: {name}", size=15, weight="bold")
    figure.text(0.92, 0.03, f"page {number} of 2", size=8, ha="right")
    return figure


def _first(solution: CurtainSolution, summary: dict[str, Any], name: str) -> Figure:
    page = _page(name, 1)
    verdict = holds_line(summary) if summary["status"] == "converged" else f"{summary['status']}: {summary['message']}"
    # The first sentence says whether it holds; the second page has the rest.
    head = "; ".join(verdict.split("; ")[:2])
    _paragraph(page, 0.93, [head], size=10, colour=BLUE)
    _draw_scene(solution, page.add_axes((0.1, 0.56, 0.8, 0.33)))
    shape = page.add_axes((0.14, 0.2, 0.74, 0.31))
    plot_line_loads(solution, shape)
    shape.set_title("")
    shape.set_title("As it hangs: largest principal line load, and its direction", fontsize=8, loc="left")
    if (legend := shape.get_legend()) is not None:
        legend.remove()
    order = summary["order"]
    rows = [
        ("mesh, pulled along its grain", f"{order['mesh_width_mm']:g} x {order['mesh_height_mm']:g} mm"),
        ("rings, mass", f"{_text(order['rings'])} rings, {order['mass_kg']:.3f} kg"),
        ("single points to hang by", f"{order['hooks']}, {_text(order['hook_pitch_mm'])} mm apart along the mesh"),
        ("covers, lowest point", f"{order['covers_width_mm']:.0f} mm, y = {order['lowest_point_mm']:.0f} mm"),
        ("mean height", f"{summary['mean_height_mm']:.1f} mm"),
    ]
    _columns(page, 0.14, rows)
    return page


def _second(summary: dict[str, Any], name: str, inputs: Sequence[Path]) -> Figure:
    page = _page(name, 2)
    y = _title(page, 0.92, "What gives first")
    rows = [(link.name, f"{link.factor:.3g} times the load") for link in sorted(links(summary))]
    stress = summary["ring_yield_N_per_mm2"]
    told = "not known" if stress is None else f"{stress:g} N/mm2"
    rows += [("material of the rings", f"{_text(summary['ring_material'])}, yield stress {told}")]
    y = _columns(page, y, rows)
    if combinations := summary.get("combinations"):
        y = _title(page, y - 0.012, f"Load combinations; {summary['envelope']['governing']} governs")
        for row in combinations:
            factors = ", ".join(f"{value:g} {key}" for key, value in row["factors"].items() if value != 1.0)
            least = "" if row["weakest_factor"] is None else f", factor {row['weakest_factor']:.3g} ({row['weakest']})"
            y = _columns(page, y, [(row["name"], f"{factors}: {row['largest_force_N']:.4g} N at most{least}")])
    y = _forces(page, y - 0.012, summary)
    y = _title(page, y - 0.012, "Assumptions and limits")
    notes = [summary["support_forces_note"], summary["line_load_warning"]]
    y = _paragraph(page, y, [*LIMITS, *filter(None, notes)], size=7.5)
    y = _title(page, y - 0.012, "Versions and files")
    rows = [("versions", ", ".join(f"{key} {value}" for key, value in summary["versions"].items()))]
    rows += [(one.name, f"SHA-256 {checksum(one)}") for one in inputs]
    _columns(page, y, rows, size=7)
    return page


def _forces(page: Figure, y: float, summary: dict[str, Any]) -> float:
    """The points with the largest forces, in two columns; the height below."""
    points = [
        (np.linalg.norm(point["force_N"]), one["support"], *point["at_mm"], point["force_N"])
        for one in summary["support_forces"]
        for point in one["points"]
    ]
    largest = sorted(points, key=lambda row: -row[0])[: 2 * MOST_ROWS]
    shown = sorted(largest, key=lambda row: (row[1], row[2], -row[3]))
    head = "Forces of supports" + ("" if len(shown) == len(points) else f", the {len(shown)} largest of {len(points)}")
    y = _title(page, y, f"{head} (N; place in the flat sheet, mm)")
    lines = [
        f"{name:<8}{x:>8.0f}{h:>8.0f}{float(size):>9.3g}   ({', '.join(f'{part:.3g}' for part in force)})"
        for size, name, x, h, force in shown
    ]
    half = (len(lines) + 1) // 2
    for left, part in ((0.08, lines[:half]), (0.52, lines[half:])):
        page.text(left, y, "\n".join(part), size=7, family="monospace", va="top", linespacing=1.25)
    return y - 0.0128 * half


def _draw_scene(solution: CurtainSolution, ax: Axes) -> None:
    """The flat sheet with its outline, dimensions, held points and edges, and loads."""
    mesh = solution.problem.mesh.mesh
    ends = mesh.p[:, mesh.facets[:, mesh.boundary_facets()]]
    ax.plot(*ends.transpose(0, 1, 2).reshape(2, 2, -1), color="#555555", lw=1.0)
    (x0, y0), (x1, y1) = mesh.p.min(axis=1), mesh.p.max(axis=1)
    for held in solution.problem.supports.held:
        at = solution.problem.disc.nodes[held.nodes]
        ax.plot(*at.T, "v" if not len(held.facets) else "s", color="#111111", ms=5 if not len(held.facets) else 2)
    size = max(x1 - x0, y1 - y0)
    off = 0.06 * size
    for start, end, text, turn in (
        ((x0, y0 - off), (x1, y0 - off), f"{x1 - x0:g} mm", 0),
        ((x1 + off, y0), (x1 + off, y1), f"{y1 - y0:g} mm", 90),
    ):
        ax.annotate("", start, end, arrowprops={"arrowstyle": "<->", "lw": 0.8})
        x, y = 0.5 * np.add(start, end)
        ax.text(x, y, text, ha="center", va="center", rotation=turn, size=8, backgroundcolor="white")
    for one in _forces_at(solution):
        way = np.array(one.force[:2]) / (np.linalg.norm(one.force) or 1.0) * 0.1 * size
        ax.annotate("", np.add(one.at, way), one.at, arrowprops={"arrowstyle": "->", "color": VERMILION, "lw": 1.5})
    ax.text(0.0, 1.02, "Flat sheet, mm. " + _loads(solution), transform=ax.transAxes, size=8, wrap=True)
    ax.set(xlim=(x0 - off, x1 + 2 * off), ylim=(y0 - 2 * off, y1 + 0.5 * off), aspect="equal")
    ax.axis("off")


def _forces_at(solution: CurtainSolution) -> tuple[PointLoad | PatchLoad, ...]:
    return (*solution.problem.scene.of(PointLoad), *solution.problem.scene.of(PatchLoad))


def _loads(solution: CurtainSolution) -> str:
    """The loads in words."""
    scene = solution.problem.scene
    told = ["Loads: weight"]
    told += [f"bar of {one.mass:g} kg on {one.edge}" for one in scene.of(Bar)]
    told += [
        f"wind of {one.speed:g} m/s" if one.speed is not None else f"wind of {one.pressure:g} N/m2"
        for one in scene.of(Wind)
    ]
    told += [f"{list(one.force)} N at {list(one.at)}" for one in _forces_at(solution)]
    told += [f"{list(one.force)} N/mm on {one.edge}" for one in scene.of(EdgeLoad)]
    return ", ".join(told)


def _text(value: Any) -> str:
    """A value that may not be known."""
    return "-" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _title(page: Figure, y: float, text: str) -> float:
    page.text(0.08, y, text, size=11, weight="bold", va="top")
    return y - 0.024


def _columns(page: Figure, y: float, rows: Sequence[tuple[str, str]], size: float = 8.5) -> float:
    """Names and values, one row each, long values in several lines; the height below."""
    for name, value in rows:
        lines = textwrap.wrap(value, round(700 / size)) or [""]
        page.text(0.08, y, name, size=size, va="top")
        page.text(0.34, y, "\n".join(lines), size=size, va="top", linespacing=1.25)
        y -= 0.0022 * size * len(lines)
    return y


def _paragraph(page: Figure, y: float, texts: Iterable[str], size: float, colour: str = "#111111") -> float:
    for text in texts:
        lines = textwrap.wrap(text, round(960 / size))
        page.text(0.08, y, "\n".join(lines), size=size, va="top", color=colour, linespacing=1.25)
        y -= 0.0022 * size * len(lines) + 0.004
    return y
