"""The report of a curtain at rest: what its pages say, which `macro_fem.output.report_pages` sets as PDF."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from macro_fem.curtain import CurtainSolution
from macro_fem.judged import asked_of_rings, first_of_largest, links
from macro_fem.output import plans
from macro_fem.output.report_pages import GAP, HIGH, PAGE, Chapter, Headline, PageTable, Picture, write_pages
from macro_fem.output.sentences import lean_note, limit_line, loads_in_words
from macro_fem.scene.support_kinds import Track
from macro_fem.scene.tables import Load, in_3d
from macro_fem.summary import CombinationRow, CurtainSummary, SupportForce
from rve.common import digits

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
OF_SHEET = (
    "The sheet is slack up to the limit of its law. Where it is locked it gives no more, or as much as the stiffness "
    "of the law says; friction would hold folds that are shown as free to slip."
)
"""The first of them for a law without rings."""
NOISE = 1e-4
"""Components of forces below this part of the largest one are shown as 0."""
AS_GIVEN, MOST_CASES = "as given", 5
"""The loads without partial factors; so many cases are in one table of design forces."""


def write_report(
    path: str | Path, solution: CurtainSolution, summary: CurtainSummary,
    combinations: Iterable[tuple[str, CurtainSummary]] = (), inputs: Iterable[Path | None] = (),
) -> None:  # fmt: skip
    """Write the report of a curtain at rest: verdict, drawings with dimensions, every support force under every one of
    the named combinations, order, factors, limits, versions and checksums of `inputs`. InputError as `write_pages`."""
    cases = [(AS_GIVEN, summary), *combinations]
    nodes = Chapter("Forces at the nodes of held edges", tables=_by_case(cases, is_single=False))
    sections = [
        _forces(cases),
        _factors(solution, cases),
        _order(solution, summary),
        *_further(summary),
        _limits(summary),
        nodes,
    ]
    sections = [one for one in sections if one.text or one.tables]
    verdict = Headline(verdict_lines(summary), summary.holds if summary.status == "converged" else False)
    write_pages(path, solution.problem.scene, verdict, _first_page(solution), sections, summary.versions, inputs)


def verdict_lines(summary: CurtainSummary) -> list[str]:
    """Whether the curtain holds, and by which factor; what governs; the largest force."""
    factor, force = summary.governing_factor, digits(summary.governing_force_N, 4)
    under = "" if summary.governing_combination is None else f" under {summary.governing_combination}"
    if summary.status != "converged":
        first = f"No verdict, {summary.status}: {summary.message}"
    elif factor is None or summary.holds is None:
        first = "Only forces: nothing is loaded whose strength is known"
    else:
        most = "of at most " if summary.governing_note else ""
        verb = "holds with a" if summary.holds else "does NOT hold:"
        first = f"The curtain {verb} factor {most}{digits(factor, 4)}{under}"
    place = f", {summary.governing_place}" if summary.governing_place else ""
    second = f"First to give: {summary.governing_link}{place}." if summary.governing_link else ""
    unsure = " Uncertain: see limits." if summary.single_forces_note else ""
    third = f"Largest force of a single support: {force} N{_whose(summary)}.{unsure}"
    return [first, *filter(None, [second]), third]


def _whose(summary: CurtainSummary) -> str:
    """Which point has the largest force, and under which combination; the first of mirrored ones."""
    if (most := summary.envelope) is not None and most.support_forces:
        top = most.support_forces[first_of_largest([one.force_N for one in most.support_forces])]
        return f" at {top.point}{_of(summary, top.support_number)}, under {top.combination}"
    each = [(one.size_N, f"{one.point}{_of(summary, k)}") for k, held in _supports(summary) for one in held.points]
    return f" at {each[first_of_largest([size for size, _ in each])][1]}" if each else ""


def _of(summary: CurtainSummary, number: int) -> str:
    return f" of support {number}" if len(summary.support_forces) > 1 else ""


def _first_page(solution: CurtainSolution) -> list[list[Picture]]:
    """Drawings with dimensions and loads; in space plan, side and a view, in the plane how it hangs."""
    scene, half = solution.problem.scene, 0.5 * (PAGE - GAP)
    loads = f"Flat sheet with its supports and loads: {loads_in_words(scene) or 'none'}. Dimensions in mm."
    if not scene.in_space:
        # A sheet so many times wider than high is drawn over the whole width.
        is_wide = bool(np.divide(*scene.curtain.extent(solution.problem.mesh.mesh.p.T)) > 2.0)
        sheet = Picture(lambda width: plans.draw_sheet(solution, width, HIGH), PAGE if is_wide else half, loads)
        words = "As it hangs: largest line load, and its direction; dashed: before deformation."
        hung = Picture(lambda width: plans.draw_hung(solution, width, HIGH), half, words)
        return [[sheet], [hung]] if is_wide else [[sheet, hung]]
    slim = 34.0 if plans.side_is_slim(solution) else 60.0
    sheet = Picture(lambda width: plans.draw_sheet(solution, width, HIGH), half, loads)
    words = "In space, with line loads and forces."
    view = Picture(lambda width: plans.draw_view(solution, width, 1.25 * HIGH), half, words)
    above = Picture(lambda width: plans.draw_plan(solution, width, HIGH), PAGE - GAP - slim, _plan_words(solution))
    side = Picture(lambda width: plans.draw_side(solution, width, HIGH), slim, "From the left side.")
    return [[sheet, view], [above, side]]


def _plan_words(solution: CurtainSolution) -> str:
    """What a plan shows, and of each track its length and the distance of its runners."""
    words = ["Plan, seen from above"]
    for item, held in zip(solution.problem.scene.support, solution.problem.supports.held, strict=True):
        if isinstance(item, Track):
            curve = item.along(solution.problem.mesh.border)[1]
            told = f"track {digits(curve.length, 5)} mm long"
            if item.has_hooks and len(held.nodes) > 1:
                apart = digits(item.drawn * curve.length / (len(held.nodes) - 1), 4)
                told += f", {len(held.nodes)} runners {apart} mm apart along it"
            words.append(f"{told}{f', {item.drawn:g} of it covered' if item.drawn < 1.0 else ''}")
    return f"{'; '.join(words)}."


def _forces(cases: Sequence[tuple[str, CurtainSummary]]) -> Chapter:
    """The design force of each support and point, the supports in a line each, and all forces under every case."""
    summary = cases[0][1]
    most, each = summary.envelope, _all_forces(cases, is_single=True)
    each |= {key: row for key, row in _all_forces(cases, is_single=False).items() if len(key) == 1}
    shown = cases if most is not None and len(cases) <= MOST_CASES else []
    hung = {(number, *_at(point)): point for number, one in _supports(summary) for point in one.points}
    largest = (
        {}
        if most is None
        else {
            (
                one.support_number,
                *([] if one.point is None else [round(one.x_mm or 0.0, 6), round(one.y_mm or 0.0, 6)]),
            ): one
            for one in (*most.support_forces, *most.support_sums)
        }
    )
    rows = []
    for key, (name, *forces) in each.items():
        place = places_of(hung[key]) if key in hung else 5 * [""]
        top = [_size(forces[0])] if most is None else [digits(largest[key].force_N, 4), largest[key].combination]
        rows.append([name, *place, *(_size(force) for force in forces[: len(shown)]), *top])
    end = ["force, N"] if most is None else ["largest, N", "under"]
    head = ["point", "x", "y", "x", "y", "z", *(name for name, _ in shown), *end]
    groups = [("", 1), ("in sheet, mm", 2), ("hung, mm", 3), ("force, N", len(shown)), ("", len(end))]
    text = "" if most is None else f", the largest under any of {len(cases) - 1} load combinations"
    design = PageTable(f"Design forces{text}", head, rows, [one for one in groups if one[1]])
    tables = [one for one in (design, _supports_table(summary)) if one.rows]
    return Chapter("Forces of supports", tables=[*tables, *_by_case(cases, is_single=True)])


def _supports(summary: CurtainSummary) -> list[tuple[int, SupportForce]]:
    return list(enumerate(summary.support_forces, 1))


def _at(point: Any) -> tuple[float, float]:
    return round(point.at_mm[0], 6), round(point.at_mm[1], 6)


def places_of(point: Any) -> list[str]:
    """Coordinates of a held point in mm, in words: in the flat sheet, then where it hangs."""
    return [f"{round(one)}" for one in (*point.at_mm[:2], *in_3d(tuple(point.place_mm)))]


def _size(force: Sequence[float]) -> str:
    return digits(math.hypot(*force), 4)


def _supports_table(summary: CurtainSummary) -> PageTable:
    """Each support in a row: what it holds, its largest force at a point and per ring, and what a point bears."""
    head = [
        "no.",
        "support",
        "points",
        "apart in mesh, mm",
        "held edge, mm",
        "largest at a point, N",
        "per ring, N",
        "capacity, N",
    ]
    rows = []
    for number, one in _supports(summary):
        optional = (one.largest_force_per_ring_N, one.capacity_N)
        rows.append([
            f"{number}", one.support, f"{one.nodes_held}", _or_none(one.pitch_mm), _or_none(one.length_held_mm or None),
            digits(one.largest_nodal_force_N, 4), *map(_or_none, optional),
        ])  # fmt: skip
    return PageTable("Supports, loads as given", head, rows)


def _or_none(value: float | None, count: int = 4) -> str:
    return "" if value is None else digits(value, count)


def _all_forces(cases: Sequence[tuple[str, CurtainSummary]], *, is_single: bool) -> dict[tuple[Any, ...], list[Any]]:
    """Name, and force under every case, of each point by its support and place, then of the sum by the support alone;
    of supports with single points, or of held edges."""
    rows = dict[tuple[Any, ...], list[Any]]()
    for number, (_, summary) in enumerate(cases):
        for support, one in _supports(summary):
            if (one.largest_force_per_ring_N is not None) != is_single:
                continue
            of = _of(summary, support)
            each = [((support, *_at(point)), f"{point.point}{of}", point.force_N or ()) for point in one.points]
            for key, name, force in [*each, ((support,), f"sum of {one.support}{of}", one.force_N)]:
                rows.setdefault(key, [name, *len(cases) * [()]])[number + 1] = force
    return rows


def _by_case(cases: Sequence[tuple[str, CurtainSummary]], *, is_single: bool) -> list[PageTable]:
    """Forces and their components at all points of supports with single points, or of held edges, and their sums."""
    ordered = list(_all_forces(cases, is_single=is_single).values())
    if not ordered:
        return []
    d = max(len(force) for row in ordered for force in row[1:])
    axes, tables, step = ("x", "y", "z")[:d], list[PageTable](), 3 if d == 3 else 4
    for begin in range(0, len(cases), step):
        some = range(begin, min(begin + step, len(cases)))
        least = [NOISE * max((abs(part) for row in ordered for part in row[k + 1]), default=0.0) for k in some]
        each = list(zip(some, least, strict=True))
        body = [
            [row[0], *(text for k, small in each for text in components_of(row[k + 1], small, d))] for row in ordered
        ]
        groups = [("force on the curtain, N", 1), *((cases[k][0], d + 1) for k in some)]
        title = ("All forces and their components" if is_single else "Nodes of held edges") + ", continued" * bool(
            begin
        )
        tables.append(PageTable(title, ["point", *len(some) * ("size", *axes)], body, groups))
    return tables


def components_of(force: Sequence[float], least: float, d: int) -> list[str]:
    """Size and components of a force, with rounding beside the largest as 0; nothing where there is none."""
    return (
        [_size(force), *(digits(one) if abs(one) > least else "0" for one in force)] if len(force) else (d + 1) * [""]
    )


def _factors(solution: CurtainSolution, cases: Sequence[tuple[str, CurtainSummary]]) -> Chapter:
    """What gives first at how many times the loads, as given and under each combination."""
    summary = cases[0][1]
    given = [[one.name, digits(one.factor, 4), one.text] for one in links(summary, summary.support_forces)]
    tables = [PageTable("Links, loads as given without partial factors", ("link", "factor", "what gives"), given)]
    axes = ("x", "y", "z")[: len(summary.total_load_N)]
    head = ("loads", "yields", "collapses", "largest", "mesh", "at points", "rings at hooks", *axes)
    rows = []
    for name, one in cases:
        used = (one.utilisation_max, *(asked_of_rings(one) if one.utilisation_max is not None else (None, None, None)))
        factors = (_or_none(value) for value in (one.safety_factor, one.collapse_factor, *used))
        least = NOISE * max(map(abs, one.total_load_N), default=0.0)
        rows.append([name, *factors, *components_of(one.total_load_N, least, len(axes))[1:]])
    groups = [("", 1), ("a ring, at times the loads", 2), ("utilisation, 1: yields", 4), ("sum of loads, N", len(axes))]
    tables.append(PageTable("Rings", head, rows, groups))
    if summary.combinations is not None:
        tables.append(_combinations(summary.combinations, {one.kind for one in solution.problem.scene.of(Load)}))
    words = "Where the rings are used, 1 is first yield; circles: rings at hooks and other held and loaded points."
    shown = Picture(lambda width: plans.draw_hung(solution, width, HIGH, used=True), 0.5 * PAGE, words)
    is_drawn = summary.utilisation_max is not None and not solution.problem.scene.in_space
    filled = [one for one in tables if one.rows]
    return Chapter("Factors and the weakest link", (), [[shown]] if is_drawn else [], filled)


def _combinations(each: Sequence[CombinationRow], kinds: set[str]) -> PageTable:
    """Load combinations with their partial factors on weight and kinds of loads, and what gives first under them."""
    head = ("combination", "partial factors", "answer", "largest force, N", "first yield", "factor", "first to give")
    rows = []
    for one in each:
        parts = ", ".join(f"{name} {value:g}" for name, value in one.factors.items() if name in {"weight", *kinds})
        factors = (_or_none(one.safety_factor), _or_none(one.weakest_factor))
        first = ", ".join(filter(None, [one.weakest, one.weakest_place]))
        rows.append([one.name, parts, one.status, digits(one.largest_force_N, 4), *factors, first])
    return PageTable("Load combinations", head, rows)


def _order(solution: CurtainSolution, summary: CurtainSummary) -> Chapter:
    """What to order: mesh, rings, hooks or runners, tracks and bars."""
    order = summary.order
    material = [] if order.material is None else [["metal of the rings", order.material]]
    joint = {None: "", "welded": ", welded"}.get(summary.ring_joint, ", bent and not welded")
    stress = summary.ring_yield_N_per_mm2
    rows = [
        ["mesh, width by height, pulled along its grain", f"{order.mesh_width_mm:g} x {order.mesh_height_mm:g} mm"],
        ["area", f"{digits(order.area_m2, 5)} m2"],
        ["holes", f"{order.holes}"],
        ["weave", order.weave or "not known"],
        ["outer diameter of a ring", _with(order.outer_diameter_mm, "mm")],
        ["inner diameter of a ring", _with(order.inner_diameter_mm, "mm")],
        ["wire", _with(order.wire_mm, "mm")],
        ["to the middle of the wire r1, and of the wire r2", f"{_with(order.r1_mm, 'mm')}, {_with(order.r2_mm, 'mm')}"],
        *material,
        ["yield stress of the wire", f"{_with(stress, 'N/mm2')}{joint}"],
        ["rings, in cells of the weave", f"{order.rings}, {order.cells}" if order.rings else "not known"],
        ["mass of the mesh", f"{digits(order.mass_kg, 4)} kg"],
        ["points to hang by", f"{order.hooks}"],
        ["their distance along the mesh", _with(order.hook_pitch_mm, "mm")],
        ["track", _with(order.track_mm, "mm")],
        [
            "bars",
            f"{order.bars}, {digits(order.bars_mm, 6)} mm long, {digits(order.bars_kg, 6)} kg"
            if order.bars
            else "none",
        ],
        ["held over a width of", f"{digits(order.held_width_mm, 5)} mm"],
        ["lowest point", f"y = {digits(order.lowest_point_mm, 5)} mm"],
        ["mean height", f"y = {digits(summary.mean_height_mm, 5)} mm"],
    ]
    if summary.mean_sag_mm is not None:
        sags = ("mean sag", summary.mean_sag_mm), ("largest sag", summary.largest_sag_mm)
        rows[-2:] = [[name, _with(float(digits(sag or 0.0, 5)), "mm")] for name, sag in sags]
    shown = [row for row in rows if row[1] != NOT_GIVEN]
    tables = [PageTable("", ("what", "how much"), shown)]
    for number, item in enumerate(solution.problem.scene.support, 1):
        if isinstance(item, Track):
            parts = plans.track_parts(item.along(solution.problem.mesh.border)[1])
            head = ("part", "shape", "length, mm", "radius, mm", "turns, degrees", "corner before it, degrees")
            body = [
                [
                    f"{k}",
                    "arc" if one.radius else "straight",
                    digits(one.length, 5),
                    *(_or_none(value or None, 4) for value in one[1:]),
                ]
                for k, one in enumerate(parts, 1)
            ]
            tables.append(
                PageTable(f"Track of support {number}, from its start; turns to the left are positive", head, body)
            )
    return Chapter("What to order", tables=tables)


NOT_GIVEN = "none"


def _with(value: float | None, unit: str) -> str:
    return NOT_GIVEN if value is None else f"{digits(value, 6)} {unit}"


def _further(summary: CurtainSummary) -> list[Chapter]:
    """Obstacles, wind, bounds, and nodes of held edges, of a curtain that has them."""
    sections = []
    if summary.obstacles:
        head = ("obstacle", "kind", "nodes touched", "moved by, mm", "x", "y", "z")
        rows, least = [], NOISE * max(map(abs, summary.total_load_N), default=0.0)
        for one in summary.obstacles:
            for k, step in enumerate(one.steps, 1):
                of = f", step {k}" if len(one.steps) > 1 else ""
                push = components_of(in_3d(tuple(step.reaction_N)), least, 3)[1:]
                touched = f"{one.nodes_touched}" if k == len(one.steps) else ""
                rows.append([f"{one.obstacle}{of}", one.kind, touched, digits(step.displacement_mm, 4), *push])
        sections.append(
            Chapter("Obstacles", tables=[PageTable("", head, rows, [("", 4), ("force on the curtain, N", 3)])])
        )
    if summary.wind:
        head = ("speed, m/s", "solidity", "drag coefficient", "pressure, N/m2", "front, m2", "layers", "drag, N")
        rows = [[digits(value, 4) for value in vars(one).values()] for one in summary.wind]
        sections.append(Chapter("Wind", tables=[PageTable("", head, rows)]))
    return sections


def _limits(summary: CurtainSummary) -> Chapter:
    """Assumptions and limits in words: those of every answer, and those of this one."""
    own = [
        limit_line(summary),
        summary.governing_note,
        summary.support_forces_note,
        summary.single_forces_note,
        lean_note(summary),
        *summary.notes,
    ]
    own += [summary.strength_note] if summary.utilisation_of_averages_max is None else []
    first = LIMITS[0] if summary.order.r1_mm is not None else OF_SHEET
    return Chapter(
        "Assumptions and limits", [first, *LIMITS[1:], *(f"{one[:1].upper()}{one[1:]}." for one in own if one)]
    )
