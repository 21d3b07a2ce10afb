"""Pairs of rings that cannot touch, asymmetric motions, and contact curvature, in whole strain tables."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.omissions.compare import LEFT_OUT, NOISE, USED, Trial, bars, table, verdict
from benchmarks.omissions.motion import TOLERANCE
from benchmarks.pages.measuring import at_most, least_seconds
from benchmarks.pages.model import Column, Section, Table
from rve.equilibrium import DirectOptions, solve_equilibrium
from rve.load import cauchy_line_load
from rve.ranges import grid
from rve.sweep import Cell, solve_table
from rve.system import Equations
from rve.table import StrainTable
from rve.weave import FOUR_IN_ONE, SIX_IN_ONE

FORCED = ("asymmetry", "far-pairs", "unlisted-pairs", "idle-curvature")
CELLS = {
    "4-in-1, r1/r2 = 4.2": Cell(5.0, 5.0 / 4.2),
    "4-in-1, r1/r2 = 10": Cell(5.0, 0.5),
    "6-in-1, r1/r2 = 8": Cell(5.0, 0.625, SIX_IN_ONE),
}
THIN = {"4-in-1, r1/r2 = 30": Cell(5.0, 5.0 / 30.0)}
BELOW = (1.0, 1e-2, 1e-3)


def measure(full: bool) -> Section:
    """The section."""
    cells = CELLS | (THIN if full else {})
    loads = grid(np.arange(0.0, 46.0, 5.0), np.arange(5.0, 91.0, 5.0))
    plain = {name: least_seconds(partial(solve_table, *loads, cell), long=3.0) for name, cell in cells.items()}
    trials = [forced(feature, name, cell, plain[name], loads) for feature in FORCED for name, cell in cells.items()]
    text = (
        f"Tables of {len(loads[0])} loads (alpha 0:45:5, beta 5:90:5) with `rve table --force FEATURE`. `asymmetry`: "
        "the locked states of both weaves have two symmetries, so 5 coordinates and half of the pairs are enough; a "
        "state counts when it obeys all equations and gives way to no asymmetric motion, other cases are solved with "
        "all coordinates. `far-pairs`: listed pairs whose centres are too far apart to touch are not sampled. "
        "`unlisted-pairs`: those up to four cells apart that the weave does not list; the table tells how far they "
        "stay apart and lists them where they would overlap. `idle-curvature`: contacts without force have no "
        "curvature in the Jacobian."
    )
    bent, iterations = curvature_from_the_start()
    conclusion = (
        f"{verdict(trials)} Contact curvature far from equilibrium is not left out: without it above mu = "
        f"{BELOW[1]:g} and {BELOW[2]:g} the solver takes {iterations[BELOW[1]] / iterations[BELOW[0]]:.2f} and "
        f"{iterations[BELOW[2]] / iterations[BELOW[0]]:.2f} times the iterations."
    )
    tables = (table("Features forced into the direct solver", trials), met({k: v[0] for k, v in plain.items()}), bent)
    return Section(
        "rings",
        "Pairs, symmetry and curvature of rings",
        text,
        tables,
        (bars("rings", "Features that locked rings do without", trials),),
        conclusion,
    )


def forced(
    feature: str, name: str, cell: Cell, plain: tuple[StrainTable, float], loads: tuple[np.ndarray, np.ndarray]
) -> Trial:
    """One feature in one cell, against the table that decides by itself."""
    found, seconds = least_seconds(lambda: solve_table(*loads, cell, DirectOptions(force=(feature,))), long=3.0)
    both = found.converged & plain[0].converged
    change = float(np.abs(found.E - plain[0].E)[both].max())
    ok = bool((found.converged == plain[0].converged).all())
    work = plain[0].provenance["work"]
    alone = LEFT_OUT
    if feature == "asymmetry" and work["symmetric"] < work["cases"]:
        alone = f"{LEFT_OUT} in {work['symmetric']} of {work['cases']}"
    if feature == "unlisted-pairs" and work["widened"]:
        alone = USED
    return Trial(feature, name, alone, plain[1], seconds, change, TOLERANCE, ok=ok)


def met(tables: dict[str, StrainTable]) -> Table:
    """What the tables met: symmetric states, pairs in reach, unlisted pairs."""
    rows = []
    for name, found in tables.items():
        work = found.provenance["work"]
        near = f"{work['least_near']} to {work['most_near']} of {work['listed']}"
        rows.append((name, int(found.converged.sum()), work["symmetric"], near, work["unlisted_gap"]))
    columns = (
        Column("cell"),
        Column("converged"),
        Column("in symmetric coordinates"),
        Column("listed pairs in reach"),
        Column("unlisted pairs stay apart by, r1", ".3f"),
    )
    note = "The last column is a lower bound where centres are too far apart to touch."
    return Table("What the tables met", columns, tuple(rows), note)


def curvature_from_the_start() -> tuple[Table, dict[float, int]]:
    """Contact curvature in the Jacobian only below some mu: iterations and time; and the iterations of each."""
    loads = grid(np.arange(0.0, 46.0, 5.0), np.arange(5.0, 91.0, 5.0))
    s = cauchy_line_load(*loads)
    equations = Equations.of(FOUR_IN_ONE, 0.1)
    rows, iterations, first = [], {}, None
    for below in BELOW:
        options = replace(DirectOptions(), curvature_below=below)
        found, seconds = least_seconds(partial(solve_equilibrium, s, equations, options), long=3.0)
        first = found if first is None else first
        good = (found.status == "converged") & (first.status == "converged")
        change = float(np.abs(found.pose.lattice - first.pose.lattice)[good].max())
        iterations[below] = int(found.iterations.sum())
        rows.append((below, int(good.sum()), iterations[below], seconds, at_most(change, NOISE)))
    columns = (
        Column("curvature below mu", "g"),
        Column("converged"),
        Column("iterations"),
        Column("s", ".3f", timed=True),
        Column("change of the lattice, r1"),
    )
    note = (
        f"{len(s)} loads with beta > 0, r1/r2 = 10, all coordinates. mu falls from 0.03 to 1e-13: 1 is from the start."
    )
    return Table("Contact curvature far from equilibrium", columns, tuple(rows), note), iterations
