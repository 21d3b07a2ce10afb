"""The rings against the disk: mean height, potential, lowest point, line load, by the number of rings across."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.every_ring.cases import ACROSS, SHEETS, Case, Sheet, disk_case, rings_case
from benchmarks.frame import Diagram, Section, Table, curves, table
from benchmarks.measure import Row, count_of
from homogenize import fit
from macro_fem import read_scene, solve
from macro_fem.rings import ring_scene
from rve import Cell, grid, solve_table
from rve.finite import FiniteOptions

LEAST_FITTED = 8
"""Cells across of the smallest sheet that the extrapolation uses."""
CELLS = 32
"""Of the disk's mesh across."""
SPREADS = (0, 3, 5)
"""Rings across the circle over which the pull is spread, 0 at a point."""
PIECES = {"4-in-1": (9, 6), "6-in-1": (11, 5), "8-in-1": (12, 4), "japanese-4-in-1": (5, 4)}
PIECES |= {"japanese-6-in-1": (4, 2), "kings-4-in-1": (4, 3)}
"""Reference cells across and down of a piece of each weave of the catalogue, hung by its corners."""
STEP = 22.5
"""Degrees between the loads of the table of a weave, to whose law its piece is compared."""
HEIGHT, POTENTIAL = "mean height, %", "potential, %"
LOWEST, LINE = "lowest point, %", "line load, %"


def measure(full: bool) -> Section:
    """The section."""
    sizes = {sheet: sheet.sizes if full else (1, 2) for sheet in SHEETS}
    rows = [compared(sheet, k, space) for sheet in SHEETS for space in (False, True) for k in sizes[sheet]]
    limits = [limit_row(sheet, space, rows) for sheet in SHEETS for space in (False, True)] if full else []
    forms = dict.fromkeys((HEIGHT, POTENTIAL, LOWEST, LINE), ".2f") | {"s": ".0f"}
    forms |= {"KKT residual": "at_most", "least gap, mm": "at_most 1e-9"}
    names = "; ".join(f"`{sheet.key}`: {sheet.title}" for sheet in SHEETS)
    text = (
        f"{names}. Rings of r1/r2 = 10, sides in the ratio of 4 to 3 cells. Loads grow with the weight, so that the "
        f"disk's answer over the height is one number for all sizes; it has {CELLS} columns of finite elements and "
        "certified bounds. `mean height`, `lowest point`: rings less disk, over the height. `potential`: rings less "
        "the middle of the disk's interval, over weight times height. `line load`: root mean square of the difference "
        f"of P averaged over {ACROSS} x {ACROSS} cells, over that of the disk."
    )
    limit_forms = dict.fromkeys(("order", "limit, %", "disk from, %", "disk to, %", "error, %"), ".2f")
    note = (
        f"The potential fitted by a + b / N over converged sizes with N >= {LEAST_FITTED} cells across; `limit` is a, "
        "`error` its standard error. `order`: of the difference from the middle of the disk's certified interval, "
        "fitted by N^-order. `inside`: whether the limit lies in the interval, give or take twice its error."
    )
    tables = (
        table("Rings less disk", rows, forms),
        *([table("Extrapolated to many rings", limits, limit_forms, note)] if limits else []),
        rule_table(rows),
        spread_table(full, forms),
        weave_table([weave_row(name, *cells) for name, cells in PIECES.items()]),
    )
    return Section("The rings and the disk", text, tables, diagrams(rows), conclusion(rows, limits))


def compared(sheet: Sheet, k: int, space: bool) -> Row:
    """Rings of one size against the disk."""
    rings, disk = rings_case(sheet, k, space), disk_case(sheet, CELLS)
    found, H = rings.numbers, sheet.sides(k)[1]
    low, high = (100.0 * part for part in interval(sheet, disk))
    potential = 100.0 * found["potential_N_mm"] / (sheet.weight(k) * H)
    centres = "space" if space else "plane"
    row = {"scene": sheet.key, "centres": centres, "cells across": k * sheet.columns, "rings": found["rings"]}
    row |= {
        "status": found["status"],
        HEIGHT: 100.0 * (found["mean_height_mm"] - k * disk.numbers["mean_height_mm"]) / H,
    }
    row |= {POTENTIAL: potential - 0.5 * (low + high)}
    row |= {LOWEST: 100.0 * (found["lowest_mm"] - k * disk.numbers["lowest_mm"]) / H}
    row |= {LINE: 100.0 * line_load_distance(sheet, rings, disk, k), "KKT residual": found["kkt_residual"]}
    row |= {"least gap, mm": min(0.0, found["min_gap_mm"]), "links intact": found["links_intact"]}
    return row | {"s": found["wall_s"], "_potential": potential}


def interval(sheet: Sheet, disk: Case) -> tuple[float, float]:
    """The certified interval of the disk's potential over weight times height."""
    scale = sheet.weight(1) * sheet.sides(1)[1]
    low, high = disk.numbers["potential_N_mm"]
    return low / scale, high / scale


def line_load_distance(sheet: Sheet, rings: Case, disk: Case, k: int) -> float:
    """Root mean square over the area of the difference of P, averaged over the same squares around each ring, over
    that of the disk's; P by weight / width."""
    W, H = sheet.sides(1)
    side = 0.25 * ACROSS * (W / sheet.columns + H / sheet.rows) * (1.0 + 1e-9)
    tree, half = cKDTree(k * disk.arrays["middle"]), max(side, 0.75 * k * W / CELLS)
    area, P = disk.arrays["area"], disk.arrays["P"]
    near = tree.query_ball_point(rings.arrays["X"], half, p=np.inf)
    good = [ring for ring, rows in enumerate(near) if rows]
    theirs = np.array([np.average(P[near[ring]], axis=0, weights=area[near[ring]]) for ring in good])
    theirs *= W / sheet.weight(1)
    ours = rings.arrays["P"][good, :2] * sheet.sides(k)[0] / sheet.weight(k)
    weight = rings.arrays["area"][good]
    away, own = (weight @ (part**2).sum(axis=(1, 2)) for part in (ours - theirs, theirs))
    return float(np.sqrt(away / own))


def limit_row(sheet: Sheet, space: bool, rows: Sequence[Row]) -> Row:
    """The extrapolated potential of a scene against the disk's interval."""
    which = sheet.key, "space" if space else "plane", "converged"
    rows = [row for row in rows if (row["scene"], row["centres"], row["status"]) == which]
    rows = [row for row in rows if row["cells across"] >= LEAST_FITTED]
    low, high = (100.0 * part for part in interval(sheet, disk_case(sheet, CELLS)))
    row: Row = {"scene": sheet.key, "centres": "space" if space else "plane", "sizes": len(rows)}
    if len(rows) < 3:
        return row
    N = np.array([float(one["cells across"]) for one in rows])
    line, spread = np.polyfit(1.0 / N, [one["_potential"] for one in rows], 1, cov=True)
    a, error = float(line[1]), float(np.sqrt(spread[1, 1]))
    order = -np.polyfit(np.log(N), np.log([abs(one[POTENTIAL]) for one in rows]), 1)[0]
    row |= {"order": float(order), "limit, %": a, "error, %": error, "disk from, %": low, "disk to, %": high}
    return row | {"inside": low - 2.0 * error <= a <= high + 2.0 * error}


AT_LEAST, WEIGHT, PULL = "cells across, at least", "weight alone, %", "with a point pull, %"


def worst_from(rows: Sequence[Row], least: int, pulled: bool) -> float | None:
    """The largest |difference of the mean height| in % of converged rows in space from that many cells across on."""
    keys = [sheet.key for sheet in SHEETS if any(sheet.pull) == pulled]
    good = [row for row in rows if row["status"] == "converged" and row["centres"] == "space" and row["scene"] in keys]
    return max((abs(row[HEIGHT]) for row in good if row["cells across"] >= least), default=None)


def rule_table(rows: Sequence[Row]) -> Table:
    """How near the mean height of curtains of that many cells across and more comes to the disk's."""
    sizes = sorted({row["cells across"] for row in rows})
    made = [{AT_LEAST: n, WEIGHT: worst_from(rows, n, False), PULL: worst_from(rows, n, True)} for n in sizes]
    note = (
        "The largest difference of the mean height, in % of the height, over converged scenes in space of that many "
        "cells across or more. Nothing is extrapolated."
    )
    return table("How many rings make a curtain large", made, {WEIGHT: ".2f", PULL: ".2f"}, note)


def spread_table(full: bool, forms: dict[str, str]) -> Table:
    """The pulled sheet with its pull spread over rings."""
    pull, sizes = SHEETS[-1], SHEETS[-1].sizes[1::2] if full else SHEETS[-1].sizes[1:2]
    spread = [(k, n, replace(pull, spread=n / (k * pull.columns))) for k in sizes for n in SPREADS]
    rows = [{"rings across the load": n} | compared(sheet, k, True) for k, n, sheet in spread]
    return table("A pull over more rings", rows, forms, "Pulled evenly over a circle in rings and disk; 0: at a point.")


def weave_row(name: str, columns: int, rows: int) -> Row:
    """A piece of a weave, ring by ring, against the disk by the law of its table."""
    cell = Cell(weave=name)
    law = fit(solve_table(cell, grid(STEP, cell.weave))).law
    assert law.cell is not None
    W, H = columns * law.cell.b_x_mm, rows * law.cell.b_y_mm
    support = {"kind": "corners", "gather": 0.9}
    scene = read_scene({"curtain": {"width": W, "height": H}, "mesh": {"cells": CELLS // 2}, "support": support})
    disk = solve(scene, law).solution.mean_height()
    rings = ring_scene(scene, law).solve(space=True, options=FiniteOptions(max_iterations=200, starts=1))
    row: Row = {"weave": name, "cells": f"{columns} x {rows}", "rings": len(rings.centre), "height, mm": H}
    row |= {"disk, mm": disk, "rings, mm": rings.mean_height, HEIGHT: 100.0 * (rings.mean_height - disk) / H}
    return row | {"status": rings.status, "KKT residual": rings.kkt_residual}


def weave_table(rows: Sequence[Row]) -> Table:
    """Every weave of the catalogue."""
    note = (
        f"Hung by the corners, 90 % apart, in space; r1/r2 = 10; the law of a table each {STEP:g} degrees. `disk`, "
        "`rings`: the mean height; one start and 200 iterations at most, where `iterations` is the best of them."
    )
    forms = dict.fromkeys(("disk, mm", "rings, mm", HEIGHT), ".2f") | {"height, mm": ".1f", "KKT residual": "at_most"}
    return table("Other weaves", rows, forms, note)


def diagrams(rows: Sequence[Row]) -> tuple[Diagram, ...]:
    """The differences of height and line load, in space and in the plane."""
    good = [row | {"_name": f"{row['scene']}, {row['centres']}"} for row in rows if row["status"] == "converged"]
    out = []
    for key, name, head in (("height", "mean height", HEIGHT), ("line_load", "line load", LINE)):
        lines = curves([row | {"_y": abs(row[head])} for row in good], "_name", "cells across", "_y")
        label = "% of the height" if head == HEIGHT else "% of the disk's"
        title = f"Difference of the {name}, rings to disk"
        out.append(Diagram(key, title, "cells across", label, lines))
    return tuple(out)


def conclusion(rows: Sequence[Row], limits: Sequence[Row]) -> str:
    """What the numbers say."""
    fitted = [row["inside"] for row in limits if "inside" in row]
    known = {(row["scene"], row["cells across"], row["centres"]): row for row in rows if row["status"] == "converged"}
    pairs = [(row, known.get((*key, "space"))) for (*key, centres), row in known.items() if centres == "plane"]
    cost = [plane["_potential"] - space["_potential"] for plane, space in pairs if space is not None]
    least = [n for n in sorted({row["cells across"] for row in rows}) if worst_from(rows, n, False) is not None]
    rule = "; ".join(f"{n} cells across: {worst_from(rows, n, False):.1f} %" for n in least)
    inside = f"inside the disk's interval, give or take twice the error, in {count_of(fitted)} rows"
    return (
        "Under its weight a curtain with centres free in space hangs where the disk does, in mean height and as a "
        f"part of the height, if it has at least {rule}. "
        + (f"The extrapolated potential is {inside}. " if fitted else "")
        + f"Confinement to the plane raises the potential by {min(cost):.2g} to {max(cost):.2g} % of weight times "
        "height."
    )
