"""What is said of a scene, its loads and its answer: the sentences that commands print."""

from collections.abc import Iterable, Iterator
from dataclasses import fields
from pathlib import Path

from macro_fem.judged import asked_of_rings, links, spot_loads
from macro_fem.motion_summary import CurtainMotionSummary, MotionSummary
from macro_fem.ring_summary import EveryRingSummary
from macro_fem.scene.loads import loads_of_plugins
from macro_fem.scene.scene import Scene
from macro_fem.scene.tables import Bar, EdgeLoad, Load, PatchLoad, Wind
from macro_fem.summary import CombinationRow, CurtainNumbers, CurtainSummary, Envelope, Order
from rve.common import digits
from rve.common.files import Record

OF_FORCE = (
    "triangles there are too large for an average over one cell of the rings, so for the mesh the factor is that of "
    "the force at this point over the width of one cell"
)
"""What is said of a factor that follows from the force at a point."""
ROOM = 1.5
"""What rings next to hooks bear at most over their estimate: ten scenes, `python -m benchmarks hooks --full`."""
LEANS = 0.02
"""Share of the height from which a lean to a side is told."""


def holds_line(summary: CurtainNumbers | CurtainMotionSummary) -> str:
    """Whether the curtain holds, in one line: the factor, what gives first, what the other links bear."""
    found, too_low = links(summary, summary.support_forces), summary.utilisation_too_low
    gives = "collapse" if isinstance(summary, CurtainNumbers) and summary.limit_of_mesh is not None else "yield"
    least = found[0].factor if found else float("inf")
    if least < 1.0:
        parts = [f"does not hold, factor {digits(least)}"]
    elif summary.strength_note is not None and summary.utilisation_of_averages_max is None:
        parts = [f"strength of the rings not known: {summary.strength_note}"]
    else:
        room = any(link.factor < ROOM and "capacity" not in link.name for link in found)
        ask = f" (ask for {ROOM:g}: rings next to hooks may bear so many times their estimate)" if room else ""
        parts = [f"holds with a factor {'of at most ' if too_low else ''}{digits(least)}{ask}" if found else "no load"]
    for number, link in enumerate(found):
        material = f"({summary.ring_material}, {summary.ring_yield_N_per_mm2 or 0.0:g} N/mm2)"
        verb = f"{gives}s" if link.text.startswith("the ") else gives
        of_rings = (
            f"would {gives} first {material}" if not number else f"{verb} at {digits(link.factor)} times the load"
        )
        place = f", {link.place}" if link.place and link.name != "mesh" else ""
        parts.append(f"{link.text if 'capacity' in link.name else f'{link.text} {of_rings}'}{place}")
    averages, points, _ = asked_of_rings(summary)
    if too_low:
        parts.append(too_low)
    if found and points > averages:
        parts.append(OF_FORCE)
    return "; ".join(parts)


def limit_line(summary: CurtainNumbers) -> str | None:
    """First yield, collapse of the worst cell and limit of the curtain, in this order; None where rings do not flow."""
    ends = summary.limit_interval
    if ends is None or summary.limit_factor is None:
        return None
    known = {"first yield": summary.safety_factor, "collapse of the worst cell": summary.collapse_factor}
    told = [
        f"{name} at {'an unknown number of' if one is None else digits(one)} times the load"
        for name, one in known.items()
    ]
    low, high = (digits(one, 5) for one in ends)
    told.append(f"limit of the curtain at {digits(summary.limit_factor, 5)} times, certified between {low} and {high}")
    flow, most = 100.0 * (summary.plastic_area_share or 0.0), 100.0 * (summary.largest_plastic_strain or 0.0)
    told.append(
        f"under the load as it is rings flow in {digits(flow)} % of the area, by up to {digits(most)} % in length"
    )
    if summary.rupture_factor and summary.way_at_rupture_mm and summary.energy_until_rupture_N_mm:
        factors, ways = (" to ".join(map(digits, one)) for one in (summary.rupture_factor, summary.way_at_rupture_mm))
        energies = " to ".join(digits(1e-3 * one) for one in summary.energy_until_rupture_N_mm)
        told.append(
            f"strings break at {factors} times the live loads, {ways} mm along them, with {energies} J taken up"
        )
    return "; ".join([*told, *filter(None, [summary.limit_note])])


def default_law_lines(given: Path | None) -> list[str]:
    """Which rings are taken where no law is `given`."""
    from homogenize import default_law

    if given is not None:
        return []
    law = default_law()
    assert law.cell is not None
    assert law.strength is not None
    rings = f"rings of r1 = {law.cell.r1_mm:g} mm and r2 = {law.cell.r2_mm:g} mm, 4-in-1"
    return [f"no --law: {rings}, {law.strength.material.name} unless the scene has a [material]"]


def curtain_lines(summary: CurtainSummary, out: Path, *, explain: bool) -> Iterator[str]:
    """How a curtain ended, its numbers, what to order, and whether it holds; `explain`: what was used and left out."""
    yield f"{summary.status}: {summary.message}"
    yield from summary.notes
    yield f"{_heights(summary)}, largest line load {digits(summary.max_principal_line_load_N_per_mm, 4)} N/mm"
    sizes = f"{summary.cells} cells, {summary.dofs} unknowns, {summary.iterations} iterations"
    yield f"{sizes}, {summary.wall_s:.2f} s; written to {out}"
    yield from hooks_lines(summary)
    yield from order_lines(summary.order)
    if summary.status == "converged":
        yield f"{'without the factors of combinations: ' * ('envelope' in summary)}{holds_line(summary)}"
    yield from filter(None, [limit_line(summary)])
    if summary.status == "converged":
        yield from filter(None, [summary.support_forces_note, summary.single_forces_note, lean_note(summary)])
    yield from combination_lines(summary)
    if summary.bounds is not None:
        yield interval_line(summary)
    if explain:
        for row in summary.features:
            yield f"{row.feature:<16} {'used' if row.used else 'left out':<9} {row.why}"


def lean_note(summary: CurtainSummary) -> str | None:
    """That the curtain leans to a side, and how far; None where it hardly does."""
    lean, height = summary.lean_mm, summary.order.mesh_height_mm
    if abs(lean) < LEANS * height:
        return None
    return (
        f"the curtain leans as its mesh shears: its lower end hangs {digits(abs(lean))} mm to the "
        f"{'right' if lean > 0.0 else 'left'} of its upper one, over a height of {height:g} mm"
    )


def _heights(told: CurtainNumbers | EveryRingSummary) -> str:
    """Where the mesh hangs; of a sheet whose weight acts along z how far it sags."""
    if (sag := told.get("mean_sag_mm")) is not None:
        return f"mean sag {sag:.3f} mm, largest {told['largest_sag_mm']:.3f} mm"
    away = f", |z| up to {out:.3f} mm" if (out := told.get("out_of_plane_mm")) is not None else ""
    return f"mean height {told.mean_height_mm:.3f} mm, lowest point {told.lowest_point_mm:.3f} mm{away}"


def motion_lines(summary: MotionSummary, out: Path) -> Iterator[str]:
    """How a curtain in motion ended, its peaks, what its scheme lost, and whether it holds."""
    yield f"{summary.status}: {summary.message}"
    yield from summary.notes
    yield (
        f"{summary.reached_s:g} s in {summary.steps} steps, forces of all supports add up to at most "
        f"{digits(summary.peak_support_force_N, 4)} N, at {digits(summary.peak_support_force_at_s, 4)} s; "
        f"lowest point {summary.lowest_point_mm:.3f} mm, {summary.wall_s:.2f} s; written to {out}"
    )
    if summary.lost_by_scheme_share is not None:
        share, lost = 100.0 * summary.lost_by_scheme_share, digits(summary.lost_by_scheme_N_mm)
        yield (
            f"the scheme lost {digits(share)} % of the largest kinetic energy, {lost} N mm (shorter steps lose less); "
            f"locking and touching took {digits(summary.lost_by_locking_N_mm)} N mm, damping "
            f"{digits(summary.lost_by_damping_N_mm)} N mm"
        )
    if isinstance(summary, CurtainMotionSummary):
        yield f"weakest at {summary.at_s:.4g} s: {holds_line(summary)}"
    yield from filter(None, [summary.verdict_note])


def motion_verdict(summary: MotionSummary) -> str:
    """Whether a curtain in motion holds, in a few words."""
    if summary.smallest_factor is None:
        return "whether it holds is not known"
    factor = f"smallest factor {digits(summary.smallest_factor)}, {summary.weakest}, at {summary.at_s:.4g} s"
    return {True: "holds", False: "does not hold", None: "not known whether it holds"}[summary.holds] + f": {factor}"


def every_ring_lines(summary: EveryRingSummary, out: Path) -> list[str]:
    """How a curtain solved ring by ring ended, and its numbers."""
    left = f"supports are up to {summary.way_left_mm:.3f} mm from their places"
    largest, residual = summary.largest_contact_force_N, summary.kkt_residual
    if largest is not None and residual is not None:
        left = f"largest contact force {digits(largest, 4)} N, residual {residual:.1e}"
    gap = f"smallest gap {summary.min_gap_mm:.1e} mm, {summary.iterations} iterations"
    return [
        f"{summary.status}: {summary.message}",
        *summary.notes,
        f"{summary.ring_count} rings, {_heights(summary)}",
        left,
        f"{gap}, {summary.wall_s:.2f} s; written to {out}",
    ]


def ring_field_lines(found: Record, out: Path) -> Iterator[str]:
    """How the rings of a curtain fit, and the forces between them."""
    by_status = ", ".join(f"{count} {name}" for name, count in found["cells_by_status"].items())
    yield f"{found['rings']} rings in {found['cells']} cells ({by_status}), {found['wall_s']:.1f} s; in {out}"
    yield f"{found['links'] - found['links_intact']} of {found['links']} links drawn open, as cells stand one by one"
    if found["curtain_status"] not in ("converged", "unknown"):
        yield f"the curtain is not solved: its status is {found['curtain_status']} (summary.json)"
    worst = found["worst_cell"]
    most = digits(max(found["largest_contact_force_N"], worst["largest_force_N"]), 4)
    where = f"in cell {worst['cell']}, which has the largest line load, {digits(worst['largest_force_N'], 4)} N"
    yield f"forces between rings away from supports: at most {most} N; {where} at {worst['contacts']} contacts"
    if held := found["ring_at_support"]:
        yield f"the ring at {held['support']} that takes most is pulled by {digits(held['force_N'], 4)} N"
    yield from (f"{name}: {text}" for name, text in found["meanings"].items() if name != "met")


def hooks_lines(summary: CurtainNumbers) -> list[str]:
    """How far apart hooks and runners are, whether as the scene asks, and how many points count for another support."""
    lines = []
    for one in summary.support_forces:
        if one.pitch_mm is not None:
            pitch, asked = one.pitch_mm, one.pitch_asked_mm
            differs = asked is not None and abs(pitch - asked) > 1e-9 * asked
            note = f"; pitch = {asked:g} does not divide the edge" if differs else ""
            lines.append(f"{one.support}: {one.nodes_held}, {pitch:g} mm apart{note}")
        if both := one.nodes_held - len(one.points):
            lines.append(f"{one.support}: the forces of {both} of its points count for a support before it")
    return lines


def order_lines(order: Order) -> list[str]:
    """The order sheet in lines."""
    mesh = f"mesh of {order.mesh_width_mm:g} x {order.mesh_height_mm:g} mm"
    holes = f", less {order.holes} hole{'s' * (order.holes > 1)}" if order.holes else ""
    lines, rings = [f"order: {mesh}, {digits(order.area_m2, 4)} m2{holes}, pulled along its grain"], ""
    if order.wire_mm is not None:
        across, metal = f"{order.outer_diameter_mm:g} mm across, {order.inner_diameter_mm:g} mm inside", order.material
        lines += [f"  {order.weave}, rings of {metal or 'material not known'}, {across}, wire {order.wire_mm:g} mm"]
        rings = f"{order.rings} rings in {order.cells} cells of the weave, "
    pitch = "" if order.hook_pitch_mm is None else f", {order.hook_pitch_mm:g} mm apart along the mesh"
    lines += [f"  {rings}{digits(order.mass_kg, 4)} kg; {order.hooks or 'no'} single points to hang by{pitch}"]
    if order.bars:
        lines += [f"  bar{'s' * (order.bars > 1)} of {order.bars_kg:g} kg, {digits(order.bars_mm, 5)} mm long"]
    if order.track_mm is not None:
        lines += [f"  track of {digits(order.track_mm, 5)} mm"]
    return [*lines, f"  held over {order.held_width_mm:.1f} mm"]


def combination_lines(summary: CurtainSummary) -> list[str]:
    """Each combination in a line, the one that governs last."""
    lines = []
    for row in summary.combinations or ():
        named = ", ".join(f"{value:g} {name}" for name, value in row.factors.items() if value != 1.0)
        ended = f"{row.status}, largest force {digits(row.largest_force_N, 4)} N{_factor(row)}"
        lines.append(f"combination {row.name} ({named or 'all loads as they are'}): {ended}")
    return [*lines, governing_line(summary)] if lines else []


def _factor(row: CombinationRow | Envelope) -> str:
    """The factor of a combination, as far as it is known, and what gives first."""
    if row.weakest_factor is None:
        return ""
    most = "of at most " if row.utilisation_too_low else ""
    place = f", {row.weakest_place}" if row.weakest_place else ""
    return f", factor {most}{digits(row.weakest_factor)} ({row.weakest}{place})"


def governing_line(summary: CurtainSummary) -> str:
    """The combination that governs, and whether the curtain holds under it, as far as that is known."""
    most, rows = summary.envelope, summary.combinations
    assert most is not None
    assert rows is not None
    factor, text = most.weakest_factor, f"governing combination: {most.governing}"
    if failed := [row.name for row in rows if row.status != "converged"]:
        return f"{text}; no answer for {', '.join(failed)}"
    if factor is None:
        return text
    force = max(row.largest_force_N for row in rows)
    held = "holds" if factor >= 1.0 else "does not hold"
    return f"{text}, {held}{_factor(most)}; largest force of a single point {digits(force, 4)} N"


def interval_line(summary: CurtainSummary) -> str:
    """Interval of the answer, its parts, and what the rings were asked."""
    what, unit = "mean height", "mm"
    ends, law, mesh = summary.mean_height_interval_mm, summary.law_part_mm, summary.mesh_part_mm
    if ends is None:
        what, unit = "potential", "N mm"
        ends, law, mesh = summary.potential_interval_N_mm, summary.law_part_N_mm, summary.mesh_part_N_mm
    if summary.plastic_work_interval_N_mm is not None:
        what, ends = "plastic work", summary.plastic_work_interval_N_mm
    (low, high), (of, part) = ends or (), ("law", "") if law is None else ("rings", f"law {digits(law)}, ")
    text = f"{what} of the {of} in [{low:.6g}, {high:.6g}] {unit}: {part}mesh {digits(mesh or 0.0)} {unit}"
    if summary.ring_solves is None:
        return text
    return f"{text}; {summary.ring_solves} ring problems solved, {summary.cache_hits} read from the cache"


def components(x: float, y: float, z: float = 0.0) -> str:
    """Of a force with three digits, rounding beside the largest as 0; the third one only where there is one."""
    least = 1e-6 * max(abs(x), abs(y), abs(z))
    parts = [one if abs(one) > least else 0.0 for one in (x, y, z)]
    return " ".join(map(digits, parts if parts[2] else parts[:2]))


def loads_in_words(scene: Scene) -> str:
    """The loads of a scene in words."""
    loads = ["weight"] if any(scene.load.acceleration) else []
    loads += [f"bar of {one.mass:g} kg on {one.edge}" for one in scene.of(Bar)]
    for one in scene.of(Wind):
        strength = f"{one.pressure:g} N/m2" if one.speed is None else f"{one.speed:g} m/s"
        loads.append(f"wind of {strength} along {_vector(one.direction)}{' that follows the surface' * one.follows}")
    for _, spot in spot_loads(scene):
        spread = f" (radius {spot.radius:g} mm)" if isinstance(spot, PatchLoad) else ""
        loads.append(f"{_vector(spot.force)} N at {_vector(spot.at)}{spread}")
    loads += [f"{_vector(one.force)} N/mm on {one.edge}" for one in scene.of(EdgeLoad)]
    return ", ".join([*loads, *map(_own_in_words, loads_of_plugins(scene))])


def _own_in_words(load: Load) -> str:
    given = [(one.name, vars(load)[one.name]) for one in fields(load) if vars(load)[one.name] != one.default]
    values = [f"{name} = {value}" for name, value in given]
    return f"{load.kind} ({', '.join(values)})" if values else load.kind


def _vector(parts: Iterable[float]) -> str:
    return f"({', '.join(f'{part:g}' for part in parts)})"
