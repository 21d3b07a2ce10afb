"""How time and memory of the rings grow with their number: a square of n by n cells hung by two corners."""

import multiprocessing
import resource
import time
from dataclasses import replace
from functools import partial

from benchmarks.every_ring.cases import SHEETS, Store, kept_rows
from benchmarks.report.measure import Row
from benchmarks.report.records import Section, table
from macro_fem.every_ring import ring_scene

SHEET = replace(SHEETS[0], gather=1.0, columns=1, rows=1)
QUICK, FULL = (6, 10), (10, 15, 22, 44)
"""Cells across."""


def measure(full: bool, store: Store) -> Section:
    """The section."""
    makes = {
        f"growth_{k}_{'space' if space else 'plane'}": partial(_alone, k, space)
        for space in (False, True)
        for k in (FULL if full else QUICK)
    }
    rows = kept_rows(store, {}, makes)
    forms = {"potential, N mm": ".4f", "KKT residual": "at_most", "s": ".1f timed", "MB": ".0f timed"}
    text = (
        "A square of n by n cells hung by two corners at their full distance, from the slack weave, each in a process "
        "of its own with one thread. `trials`: searches for contacts and looks at known ones; `factors`: of the Newton "
        "matrix; `s`: processor time; `MB`: the most that the whole process held."
    )
    good = sum(row["status"] == "converged" and row["links intact"] for row in rows)
    most = max(rows, key=lambda row: row["rings"])["rings"]
    conclusion = f"{good} of {len(rows)} squares of up to {most:,d} rings converged with their links intact."
    return Section("Time and memory", text, (table("Squares of growing size", rows, forms),), (), conclusion)


def _alone(k: int, space: bool) -> Row:
    """The row of a process of its own, so that its memory is that of this case."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_solved, (k, space))


def _solved(k: int, space: bool) -> Row:
    rings = ring_scene(SHEET.scene(k, 8))
    began = time.process_time()
    found = rings.solve(space=space)
    seconds = time.process_time() - began
    return {
        "rings": len(found.centre),
        "centres": "space" if space else "plane",
        "status": found.status,
        "links intact": found.links_intact,
        "iterations": found.iterations,
        "trials": sum(one.trials for one in found.history),
        "factors": sum(one.factors for one in found.history),
        "potential, N mm": found.potential,
        "KKT residual": found.kkt_residual,
        "s": seconds,
        "MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }
