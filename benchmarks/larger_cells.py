"""Where a larger cell with centres in space does more work than the planar primitive cell: a map over r1/r2.

`python -m benchmarks.larger_cells` prints the map of docs/reports/evidence.md. Loads are spread over the disc
of dead loads of unit trace, every third on its rim, where they are of rank one.
"""

from __future__ import annotations

import time

import numpy as np

from rve.common.tensor import from_disc
from rve.common.types import Array
from rve.geometry.cell import Cell
from rve.geometry.weave import WEAVES
from rve.support_function import support

RATIOS = {
    "6-in-1": (6.0, 7.0, 8.0, 10.0, 11.0, 12.0, 13.0, 14.0, 16.0, 20.0, 30.0, 50.0, 100.0),
    "4-in-1": (6.0, 10.0, 14.0, 20.0, 30.0, 50.0, 100.0),
}
LOADS = 15


def spread_loads(count: int = LOADS) -> Array:
    """Loads of unit trace (count, 3), evenly spread: a sunflower in the disc, every third drawn out to its rim."""
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    radius = np.sqrt((np.arange(count) + 0.5) / count)
    radius[::3] = 1.0
    return np.asarray(from_disc(radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)))


def row_of(weave: str, ratio: float, cells: tuple[int, int] = (2, 2)) -> str:
    """One line of the map: loads that do more work in the larger cell, how much more, depth, and times."""
    S, seconds, found = spread_loads(), [], []
    for size, centres in (((1, 1), "plane"), (cells, "space")):
        began = time.process_time()
        found.append(support(Cell(5.0, 5.0 / ratio, WEAVES[weave], cells=size, centres=centres), S))
        seconds.append(time.process_time() - began)
    more = np.nan_to_num(found[1].h - found[0].h)
    missing = int((found[1].status != "converged").sum())
    up = more > 1e-6
    share = (more / np.abs(found[0].h))[up].max(initial=0.0)
    numbers = f"{up.sum()} of {len(S)} | {more.max() if up.any() else 0.0:.4f} | {100.0 * share:.1f} % | {missing}"
    return f"| {weave} | {ratio:g} | {numbers} | {seconds[0]:.1f} | {seconds[1]:.1f} |"


def main() -> None:
    """Print the map."""
    print("| weave | r1/r2 | loads that do more | most, S:E - h | most, of h | no answer | plane, s | larger, s |")
    print("|---|---|---|---|---|---|---|---|", flush=True)
    for weave, ratios in RATIOS.items():
        for ratio in ratios:
            print(row_of(weave, ratio), flush=True)


if __name__ == "__main__":
    main()
