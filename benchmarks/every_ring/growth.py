"""How time and memory of the rings grow with their number: squares hung by two corners, up to a square metre."""

import multiprocessing
import resource
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product

from benchmarks.every_ring.cases import SHEETS
from benchmarks.frame import Section, table
from benchmarks.measure import ROOT, Row
from macro_fem import load_scene, solve
from macro_fem.rings import ring_scene

METRE = 91
"""Cells across the square metre of the README."""
SHEET = replace(SHEETS[0], gather=1.0, columns=1, rows=1)
QUICK, FULL = (6, 10, 22), (10, 15, 22, 44, METRE)
"""Cells across."""
STARTS = ("slack", "disk")


def measure(full: bool) -> Section:
    """The section."""
    each = product(FULL if full else QUICK, (False, True), STARTS)
    rows = [alone(partial(_solved, *one)) for one in each]
    forms = {"potential, N mm": ".4f", "KKT residual": "at_most", "s": ".1f", "s of wall time": ".1f", "MB": ".0f"}
    text = (
        "Squares hung by two corners at their full distance, from the slack weave and guided by the disk, each in a "
        "process of its own; the largest one is the square metre of `examples/corner_hung.toml`. `trials`: searches "
        "for contacts and looks at known ones; `factors`: of the Newton matrix; `s`: processor time without that of "
        "the disk; `MB`: the most that the whole process held."
    )
    good = sum(row["status"] == "converged" and row["links intact"] for row in rows)
    most = max(rows, key=lambda row: row["rings"])["rings"]
    conclusion = f"{good} of {len(rows)} squares of up to {most:,d} rings converged with their links intact."
    return Section("Time and memory", text, (table("Squares of growing size", rows, forms),), (), conclusion)


def alone(solved: Callable[[], Row]) -> Row:
    """The row of a process of its own, so that its memory is that of this case."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(solved)


def _solved(k: int, space: bool, start: str) -> Row:
    scene = load_scene(ROOT / "examples" / "corner_hung.toml") if k == METRE else SHEET.scene(k, 8)
    rings = ring_scene(scene)
    disk = solve(scene).solution if start == "disk" else None
    began, watch = time.process_time(), time.perf_counter()
    found = rings.solve(space=space, disk=disk)
    seconds, wall = time.process_time() - began, time.perf_counter() - watch
    row = {"rings": len(found.centre), "centres": "space" if space else "plane", "start": start}
    row |= {"status": found.status, "links intact": found.contacts.links_intact, "iterations": found.iterations}
    row |= {name: sum(getattr(one, name) for one in found.history) for name in ("trials", "factors")}
    row |= {"potential, N mm": found.potential, "KKT residual": found.kkt_residual, "s": seconds}
    return row | {"s of wall time": wall, "MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}
