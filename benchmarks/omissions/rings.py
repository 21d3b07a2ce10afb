"""Pairs of rings that cannot touch, asymmetric motions, and contact curvature, in whole strain tables."""

from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.omissions.compare import LEFT_OUT, USED, bars, trial, trial_table, verdict
from benchmarks.omissions.motion import CHANGE, TOLERANCE
from benchmarks.problems import Array, loads
from benchmarks.report.measure import Row, least_seconds
from benchmarks.report.records import Section, table
from rve.equilibrium.interior_point import DirectOptions, solve_equilibrium
from rve.equilibrium.system import Equations
from rve.geometry.cell import Cell
from rve.geometry.kinematics import cauchy_line_load
from rve.geometry.weave import FOUR_IN_ONE, SIX_IN_ONE
from rve.solve import solve_table
from rve.table import StrainTable

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
    given = loads(first_beta=5.0)
    plain = {name: least_seconds(partial(solve_table, cell, given), long=3.0) for name, cell in cells.items()}
    trials = [forced(feature, name, cell, plain[name], given) for feature in FORCED for name, cell in cells.items()]
    text = (
        f"Tables of {len(given[0])} loads (alpha 0:45:5, beta 5:90:5) with `rve table --force FEATURE`. `asymmetry`: "
        "the locked states of both weaves have two symmetries, so 5 coordinates and half of the pairs are enough. "
        "Such a state counts if it satisfies all equations and is stable against asymmetric motions; other cases are "
        "solved with all coordinates. `far-pairs`: listed pairs whose centres are too far apart to touch are not "
        "sampled. `unlisted-pairs`: pairs up to four cells apart that the weave does not list; the table gives their "
        "distance and lists them where they would overlap. `idle-curvature`: contacts without force have no curvature "
        "in the Jacobian."
    )
    bent = curvature_rows(cauchy_line_load(*given))
    first, *later = (row["iterations"] for row in bent)
    conclusion = (
        f"{verdict(trials)} Contact curvature far from equilibrium is not left out: without it above mu = {BELOW[1]:g} "
        f"and {BELOW[2]:g} the solver takes {later[0] / first:.2f} and {later[1] / first:.2f} times the iterations."
    )
    gap, small = "gap of unlisted pairs, r1", {"curvature below mu": "g", "s": ".3f timed", CHANGE: "at_most 1e-14"}
    met = [met_row(name, found, gap) for name, (found, _) in plain.items()]
    bent_note = f"{len(given[0])} loads with beta > 0, r1/r2 = 10, all coordinates. mu falls from 0.03 to 1e-13."
    tables = (
        trial_table("Features switched on in the direct solver", trials),
        table(
            "What the tables met",
            met,
            {gap: ".3f"},
            "The last column is a lower bound where centres are too far apart to touch.",
        ),
        table("Contact curvature far from equilibrium", bent, small, bent_note),
    )
    diagram = bars("rings", "Features that locked rings leave out", trials)
    return Section("Pairs, symmetry and curvature of rings", text, tables, (diagram,), conclusion)


def forced(feature: str, name: str, cell: Cell, plain: tuple[StrainTable, float], given: tuple[Array, Array]) -> Row:
    """One feature in one cell, against the default table."""
    found, seconds = least_seconds(lambda: solve_table(cell, given, DirectOptions(force=(feature,))), long=3.0)
    both = found.converged & plain[0].converged
    change = float(np.abs(found.E - plain[0].E)[both].max())
    ok = bool((found.converged == plain[0].converged).all())
    work = plain[0].provenance["work"]
    default = USED if feature == "unlisted-pairs" and work["widened"] else LEFT_OUT
    if feature == "asymmetry" and work["symmetric"] < work["cases"]:
        default += f" in {work['symmetric']} of {work['cases']}"
    return trial(feature, name, (plain[1], seconds), change, TOLERANCE, default=default, ok=ok)


def met_row(name: str, found: StrainTable, gap: str) -> Row:
    """What the solver met: symmetric states, pairs in reach, distance of unlisted pairs."""
    work = found.provenance["work"]
    near = f"{work['least_near']} to {work['most_near']} of {work['listed']}"
    row = {"cell": name, "converged": found.converged.sum(), "in symmetric coordinates": work["symmetric"]}
    return row | {"listed pairs in reach": near, gap: work["unlisted_gap"]}


def curvature_rows(s: Array) -> list[Row]:
    """Contact curvature in the Jacobian only below some mu: iterations and time."""
    equations, rows, first = Equations.of(FOUR_IN_ONE, 0.1), [], None
    for below in BELOW:
        options = replace(DirectOptions(), curvature_below=below)
        found, seconds = least_seconds(partial(solve_equilibrium, s, equations, options), long=3.0)
        first = first or found
        good = (found.status == "converged") & (first.status == "converged")
        change = np.abs(found.pose.lattice - first.pose.lattice)[good].max()
        row = {"curvature below mu": below, "converged": good.sum(), "iterations": int(found.iterations.sum())}
        rows.append(row | {"s": seconds, CHANGE: change})
    return rows
