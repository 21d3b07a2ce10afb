"""Pairs of rings that cannot touch, asymmetric motions, and contact curvature, in the direct solver."""

from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.omissions.compare import LEFT_OUT, USED, bars, trial, trial_table, verdict
from benchmarks.omissions.motion import CHANGE, TOLERANCE
from benchmarks.problems import Array, loads
from benchmarks.report.measure import Row, least_seconds
from benchmarks.report.records import Section, table
from rve.equilibrium.interior_point import DirectOptions, Equilibrium, solve_equilibrium
from rve.equilibrium.symmetry import solve_equilibrium_symmetric
from rve.equilibrium.system import Equations
from rve.geometry.cell import Cell
from rve.geometry.kinematics import cauchy_line_load
from rve.geometry.pairs import pairs_in_reach, unlisted_gap, widened
from rve.geometry.weave import FOUR_IN_ONE, SIX_IN_ONE

FORCED = ("asymmetry", "far-pairs", "unlisted-pairs", "idle-curvature")
CELLS = {
    "4-in-1, r1/r2 = 4.2": Cell(5.0, 5.0 / 4.2),
    "4-in-1, r1/r2 = 10": Cell(5.0, 0.5),
    "6-in-1, r1/r2 = 8": Cell(5.0, 0.625, SIX_IN_ONE),
}
THIN = {"4-in-1, r1/r2 = 30": Cell(5.0, 5.0 / 30.0)}
BELOW = (1.0, 1e-2, 1e-3)
GAP = "gap of unlisted pairs, r1"


def measure(full: bool) -> Section:
    """The section."""
    cells = CELLS | (THIN if full else {})
    given = loads(first_beta=5.0)
    s = cauchy_line_load(*given)
    plain = {name: least_seconds(partial(solved, cell, s), long=3.0) for name, cell in cells.items()}
    trials = [forced(feature, name, cell, plain[name], s) for feature in FORCED for name, cell in cells.items()]
    text = (
        f"Locked states of {len(given[0])} loads (alpha 0:45:5, beta 5:90:5). `asymmetry`: all coordinates from the "
        "start, instead of the 5 symmetric ones. `far-pairs`: listed pairs whose centres are too far apart to touch "
        "are not sampled. `unlisted-pairs`: pairs up to four cells apart that the weave does not list; the solver "
        "reports their distance and lists them where they would overlap. `idle-curvature`: contacts without force "
        "have no curvature in the Jacobian."
    )
    bent = curvature_rows(s)
    first, *later = (row["iterations"] for row in bent)
    conclusion = (
        f"{verdict(trials)} Contact curvature far from equilibrium is not left out: without it above mu = {BELOW[1]:g} "
        f"and {BELOW[2]:g} the solver takes {later[0] / first:.2f} and {later[1] / first:.2f} times the iterations."
    )
    met = [met_row(name, cells[name], found) for name, (found, _) in plain.items()]
    met_note = "The last column is a lower bound where centres are too far apart to touch."
    bent_note = f"{len(given[0])} loads with beta > 0, r1/r2 = 10, all coordinates. mu falls from 0.03 to 1e-13."
    small = {"curvature below mu": "g", "s": ".3f timed", CHANGE: "at_most 1e-14"}
    tables = (
        trial_table("Features switched on in the direct solver", trials),
        table("What the solver met", met, {GAP: ".3f"}, met_note),
        table("Contact curvature far from equilibrium", bent, small, bent_note),
    )
    diagram = bars("rings", "Features that locked rings leave out", trials)
    return Section("Pairs, symmetry and curvature of rings", text, tables, (diagram,), conclusion)


def solved(cell: Cell, s: Array, feature: str = "") -> Equilibrium:
    """Locked states under the line loads s (n, 3), with one feature switched on."""
    weave = widened(cell.weave) if feature == "unlisted-pairs" else cell.weave
    equations = Equations.of(weave, cell.wire)
    far, idle = feature == "far-pairs", feature == "idle-curvature"
    varied = replace(equations, far_pairs=far, idle_curvature=idle)
    if feature == "asymmetry":
        return solve_equilibrium(s, varied)
    return solve_equilibrium_symmetric(s, varied, DirectOptions())[0]


def forced(feature: str, name: str, cell: Cell, plain: tuple[Equilibrium, float], s: Array) -> Row:
    """One feature in one cell, against the default."""
    found, seconds = least_seconds(partial(solved, cell, s, feature), long=3.0)
    good, was_good = found.status == "converged", plain[0].status == "converged"
    change = float(np.abs(found.pose.lattice - plain[0].pose.lattice)[good & was_good].max())
    overlap = unlisted_gap(plain[0].pose, cell.weave, cell.wire).min() < 0.0
    default = USED if feature == "unlisted-pairs" and overlap else LEFT_OUT
    times, ok = (plain[1], seconds), bool((good == was_good).all())
    return trial(feature, name, times, change, TOLERANCE, "r1", default=default, ok=ok)


def met_row(name: str, cell: Cell, found: Equilibrium) -> Row:
    """What the solver met: pairs in reach, distance of unlisted pairs."""
    near = pairs_in_reach(found.pose, cell.weave, cell.wire, DirectOptions().reach)
    row = {"cell": name, "converged": (found.status == "converged").sum()}
    row |= {"listed pairs in reach": f"{near.min()} to {near.max()} of {len(cell.weave.pairs)}"}
    return row | {GAP: unlisted_gap(found.pose, cell.weave, cell.wire).min()}


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
