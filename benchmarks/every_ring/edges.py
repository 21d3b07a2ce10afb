"""Where the disk is wrong: differences of line load and place by the distance from edges, supports and point loads."""

from functools import partial
from itertools import pairwise

import numpy as np

from benchmarks.every_ring.cases import SHEETS, Array, Case, Sheet, Store, disk_case, rings_case, those_there
from benchmarks.every_ring.disk import CELLS, QUICK_SIZES, line_loads
from benchmarks.report.measure import Row
from benchmarks.report.records import Section, table

BANDS = (0.0, 2.0, 4.0, 6.0, 9.0, np.inf)
"""Distances in rings; a ring's step is the square root of the reference area per ring."""
NEAR = "near"


def measure(full: bool, store: Store) -> Section:
    """The section."""
    rows, places = [], []
    k = 4 if full else QUICK_SIZES[-1]
    for sheet in SHEETS:
        found = those_there([partial(rings_case, sheet, k, True, store)])
        if not found or found[0].numbers["status"] != "converged":
            continue
        rings, disk = found[0], disk_case(sheet, CELLS, store)
        rows += _rows(sheet, rings, _line_difference(sheet, rings, disk, k))
        places += _rows(sheet, rings, _place_difference(sheet, rings, disk, k))
    text = (
        f"Sheets {k * SHEETS[0].columns} cells across, centres free in space. Root mean square over the rings of a "
        "band, by the distance from the nearest support or point load, and, for rings 6 or more from these, by the "
        "distance from the nearest free edge. A ring is a step of the square root of the reference area per ring, 8.3 "
        "mm. Line loads P are averaged over 3 x 3 cells, and given over the root mean square of the disk's in the "
        "scene. Places: distance in the plane from the point of the disk that belongs to the ring, over the height."
    )
    tables = (
        table("Line load: difference, % of the disk's", rows, dict.fromkeys(_heads(), ".1f")),
        table("Place: difference, % of the height", places, dict.fromkeys(_heads(), ".2f")),
    )
    return Section("Where the disk is wrong", text, tables, (), _conclusion(rows))


def _heads() -> list[str]:
    return [f"{a:g} to {b:g} rings" if np.isfinite(b) else f"{a:g} and more" for a, b in pairwise(BANDS)]


def _rows(sheet: Sheet, rings: Case, away: Array) -> list[Row]:
    """Root mean square, in %, of a difference (n,) by distance from supports and loads, and from free edges."""
    points, edges = distances(rings)
    out = []
    for name, distance, some in (
        ("supports, point loads", points, np.isfinite(away)),
        ("free edges", edges, np.isfinite(away) & (points >= 6.0)),
    ):
        row: Row = {"scene": sheet.key, NEAR: name}
        for head, (low, high) in zip(_heads(), pairwise(BANDS), strict=True):
            rows = some & (distance >= low) & (distance < high)
            row[head] = 100.0 * float(np.sqrt((away[rows] ** 2).mean())) if rows.sum() >= 5 else None
        out.append(row)
    return out


def distances(rings: Case) -> tuple[Array, Array]:
    """Distance (n,) of each ring, in rings, from the nearest support or point load, and from the nearest free edge."""
    X, load, area = rings.arrays["X"], rings.arrays["load"], rings.arrays["area"]
    step = float(np.sqrt(np.median(area)))
    marked = np.linalg.norm(rings.arrays["reaction"], axis=1) > 0.0
    per_area = load / area[:, None]
    marked |= np.linalg.norm(per_area - np.median(per_area, axis=0), axis=1) > 1e-6 * np.abs(per_area).max()
    points = np.linalg.norm(X[:, None] - X[None, marked], axis=2).min(axis=1)
    low, high = X.min(axis=0), X.max(axis=0)
    sides = [X[:, 0] - low[0], high[0] - X[:, 0], X[:, 1] - low[1]]
    if np.isclose(X[marked, 1], high[1]).sum() < 5:
        sides.append(high[1] - X[:, 1])
    return points / step, np.min(sides, axis=0) / step


def _line_difference(sheet: Sheet, rings: Case, disk: Case, k: int) -> Array:
    ours, theirs = line_loads(sheet, rings, disk, k)
    area = rings.arrays["area"]
    good = np.isfinite(theirs).all(axis=(1, 2))
    own = float(np.sqrt(area[good] @ (theirs[good] ** 2).sum(axis=(1, 2)) / area[good].sum()))
    return np.asarray(np.sqrt(((ours - theirs) ** 2).sum(axis=(1, 2))) / own)


def _place_difference(sheet: Sheet, rings: Case, disk: Case, k: int) -> Array:
    from scipy.interpolate import LinearNDInterpolator

    x = k * LinearNDInterpolator(disk.arrays["X"], disk.arrays["x"])(rings.arrays["X"] / k)
    return np.asarray(np.linalg.norm(rings.arrays["centre"][:, :2] - x, axis=1) / sheet.sides(k)[1])


def _conclusion(rows: list[Row]) -> str:
    heads = _heads()
    said = []
    for name in ("supports, point loads", "free edges"):
        mine = [row for row in rows if row[NEAR] == name and row[heads[0]] is not None]
        near = [row[heads[0]] for row in mine]
        inner = [[row[head] for head in heads if row[head] is not None][-1] for row in mine]
        said.append(
            f"within 2 rings of {name} line loads differ by {min(near):.0f} to {max(near):.0f} % of the mean of the "
            f"scene, far from them by {min(inner):.0f} to {max(inner):.0f} %"
        )
    return f"{said[0][0].upper()}{said[0][1:]}; {said[1]}."
