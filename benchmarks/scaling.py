"""How time and memory of a rigid curtain grow with its mesh, a square metre hung by two corners; and how many tables
are made side by side."""

import math
import resource
import time
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from distributed import LocalCluster

from benchmarks.every_ring.growth import alone
from benchmarks.frame import Section, table
from benchmarks.measure import Row
from benchmarks.problems import square
from homogenize import default_law
from macro_fem import read_scene
from macro_fem.job import solve_membrane
from rve.cli import table_items
from rve.common.commands.sweeps import sweep

QUICK, FULL = (16, 28, 50, 90), (16, 28, 50, 90, 160)
"""Cells along the width."""
FEW, MANY = 2, 18
"""Tables of a sweep; the time for each, and that for the start of workers, are those of both sweeps."""
PLACES = {"a laptop, 2": 2, "a node, 64": 64, "a cluster, 1,024": 1024}


def measure(full: bool) -> Section:
    """The section; `full` has 1e5 triangles."""
    rows = [alone(partial(_solved, cells)) for cells in (FULL if full else QUICK)]
    text = "The default law, on one thread, each in a process of its own. `MB`: the most that it held, with imports."
    forms = {"mean height, mm": ".4f", "s": ".1f", "MB": ".0f"}
    swept = side_by_side()
    form = {"s a table": ".2f", "start, s": ".1f"} | dict.fromkeys((f"{FEW} tables, s", f"{MANY} tables, s"), ".1f")
    note = (
        "N equal tables on W workers take start + ceil(N / W) times the time of one, which is what the estimates for a "
        f"thousand say of cores as fast as these: {thousand(swept)}. What is larger than one machine is split by "
        "scene, law or value, never inside of a table or a curtain."
    )
    tables = table("", rows, forms), table("Tables of 190 loads, r1/r2 from 5 to 20, side by side", swept, form, note)
    return Section("Curtains of growing size", text, tables)


def side_by_side() -> list[Row]:
    """Sweeps of few and of many tables by each way of running them, in seconds of wall time."""
    rows = []
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        ways: dict[str, Any] = {"one process": {}, "two processes": {"jobs": 2}}
        for name, way in (ways | {"two Dask workers": {"cluster": cluster.scheduler_address}}).items():
            few, many = (_swept(count, way) for count in (FEW, MANY))
            workers = 1 if not way else 2
            each = (many - few) * workers / (MANY - FEW)
            row: Row = {"workers": name, f"{FEW} tables, s": few, f"{MANY} tables, s": many, "s a table": each}
            rows.append(row | {"start, s": few - math.ceil(FEW / workers) * each})
    return rows


def _swept(count: int, way: dict[str, Any]) -> float:
    wires = ",".join(f"{wire:.4f}" for wire in 5.0 / np.geomspace(5.0, 20.0, count))
    with TemporaryDirectory() as folder:
        items = table_items(Path(folder), {"r1": "5", "r2": wires}, ["4-in-1"], "y", [])
        began = time.perf_counter()
        assert not any(how.code for how in sweep(items, Path(folder), **way))
        return time.perf_counter() - began


def thousand(rows: list[Row]) -> str:
    """What a thousand tables take, estimated from the last way of running them."""
    last = rows[-1]
    times = {place: last["start, s"] + math.ceil(1000 / count) * last["s a table"] for place, count in PLACES.items()}
    return "; ".join(f"{place} workers, {seconds:.0f} s" for place, seconds in times.items())


def _solved(cells: int) -> Row:
    scene, law = read_scene(square(cells)), default_law()
    began = time.process_time()
    found = solve_membrane(scene, law).solution
    problem = found.problem
    row: Row = {"triangles": len(problem.disc.cell_dofs), "unknowns": problem.fem.n, "status": str(found.status)}
    row |= {"iterations": found.iterations, "mean height, mm": found.mean_height()}
    return row | {"s": time.process_time() - began, "MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}
