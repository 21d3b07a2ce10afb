"""Where a larger cell with centres in space does more work than the planar primitive cell: a map over r1/r2.

`python -m benchmarks.larger_cells` prints the map of docs/reports/evidence.md. Loads are spread over the disc
of dead loads of unit trace, every third on its rim, where they are of rank one.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.frame import table, table_text
from benchmarks.measure import Row, least_seconds
from rve import WEAVES, Cell, support
from rve.common import Array, from_disc

RATIOS = {
    "6-in-1": (6.0, 7.0, 8.0, 10.0, 11.0, 12.0, 13.0, 14.0, 16.0, 20.0, 30.0, 50.0, 100.0),
    "4-in-1": (6.0, 10.0, 14.0, 20.0, 30.0, 50.0, 100.0),
}


def spread_loads(count: int = 15) -> Array:
    """Loads of unit trace (count, 3), evenly spread: a sunflower in the disc, every third drawn out to its rim."""
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    radius = np.sqrt((np.arange(count) + 0.5) / count)
    radius[::3] = 1.0
    return np.asarray(from_disc(radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)))


def row_of(weave: str, ratio: float) -> Row:
    """One line of the map: loads that do more work in the larger cell, how much more, and times."""
    S, cell = spread_loads(), Cell(5.0, 5.0 / ratio, WEAVES[weave])
    larger = replace(cell, cells=(2, 2), centres="space")
    (found, seconds), (more, longer) = (least_seconds(partial(support, one, S), long=0.0) for one in (cell, larger))
    gain = np.nan_to_num(more.h - found.h)
    up = gain > 1e-6
    return {
        "weave": weave,
        "r1/r2": ratio,
        "loads that do more": f"{up.sum()} of {len(S)}",
        "most, S:E - h": gain[up].max(initial=0.0),
        "most, of h": (gain / np.abs(found.h))[up].max(initial=0.0),
        "no answer": int((more.status != "converged").sum()),
        "plane, s": seconds,
        "larger, s": longer,
    }


if __name__ == "__main__":
    rows = [row_of(weave, ratio) for weave, ratios in RATIOS.items() for ratio in ratios]
    forms = {"r1/r2": "g", "most, S:E - h": ".4f", "most, of h": ".1%", "plane, s": ".1f", "larger, s": ".1f"}
    print(table_text(table("", rows, forms)))
