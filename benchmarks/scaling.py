"""How time and memory of a rigid curtain grow with its mesh: a square metre hung by two corners."""

import resource
import time
from functools import partial

from benchmarks.every_ring.growth import alone
from benchmarks.frame import Section, table
from benchmarks.measure import Row
from benchmarks.problems import square
from homogenize import default_law
from macro_fem import read_scene
from macro_fem.job import solve_membrane

QUICK, FULL = (16, 28, 50, 90), (16, 28, 50, 90, 160)
"""Cells along the width."""


def measure(full: bool) -> Section:
    """The section; `full` has 1e5 triangles."""
    rows = [alone(partial(_solved, cells)) for cells in (FULL if full else QUICK)]
    text = "The default law, on one thread, each in a process of its own. `MB`: the most that it held, with imports."
    forms = {"mean height, mm": ".4f", "s": ".1f", "MB": ".0f"}
    return Section("Curtains of growing size", text, (table("", rows, forms),))


def _solved(cells: int) -> Row:
    scene, law = read_scene(square(cells)), default_law()
    began = time.process_time()
    found = solve_membrane(scene, law).solution
    problem = found.problem
    row: Row = {"triangles": len(problem.disc.cell_dofs), "unknowns": problem.fem.n, "status": str(found.status)}
    row |= {"iterations": found.iterations, "mean height, mm": found.mean_height()}
    return row | {"s": time.process_time() - began, "MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}
