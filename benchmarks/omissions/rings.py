"""Pairs of rings that cannot touch, in the direct solver."""

from functools import partial
from unittest.mock import patch

import numpy as np

from benchmarks.frame import Section, table
from benchmarks.measure import Row, least_seconds
from benchmarks.omissions.compare import LEFT_OUT, USED, trial, trial_table, verdict
from benchmarks.omissions.motion import TOLERANCE
from benchmarks.problems import Array, loads
from rve.equilibrium.interior_point import DirectOptions, Equilibrium, solve_equilibrium
from rve.equilibrium.system import Equations
from rve.geometry import contacts
from rve.geometry.cell import Cell
from rve.geometry.kinematics import cauchy_line_load
from rve.geometry.pose import pair_geometry
from rve.geometry.weave import SIX_IN_ONE

FORCED = ("far-pairs", "unlisted-pairs")
CELLS = {
    "4-in-1, r1/r2 = 4.2": Cell(5.0, 5.0 / 4.2),
    "4-in-1, r1/r2 = 10": Cell(5.0, 0.5),
    "6-in-1, r1/r2 = 8": Cell(5.0, 0.625, SIX_IN_ONE),
}
GAP = "gap of unlisted pairs, r1"


def measure(full: bool) -> Section:
    """The section."""
    cells = CELLS | ({"4-in-1, r1/r2 = 30": Cell(5.0, 5.0 / 30.0)} if full else {})
    given = loads(first_beta=5.0)
    s = cauchy_line_load(*given)
    plain = {name: least_seconds(partial(solved, cell, s), long=3.0) for name, cell in cells.items()}
    trials = [forced(feature, name, cell, plain[name], s) for feature in FORCED for name, cell in cells.items()]
    text = (
        f"Locked states of {len(given[0])} loads (alpha 0:45:5, beta 5:90:5). `far-pairs`: listed pairs whose centres "
        "are too far apart to touch are not sampled. `unlisted-pairs`: pairs up to four cells apart that the weave "
        "does not list; the solver reports their distance and lists them where they would overlap."
    )
    met = [met_row(name, cells[name], found) for name, (found, _) in plain.items()]
    met_note = "The last column is a lower bound where centres are too far apart to touch."
    tables = (
        trial_table("Features switched on in the direct solver", trials),
        table("What the solver met", met, {GAP: ".3f"}, met_note),
    )
    return Section("Pairs of rings", text, tables, (), verdict(trials))


def solved(cell: Cell, s: Array, feature: str = "") -> Equilibrium:
    """Locked states under the line loads s (n, 3), with one feature switched on."""
    weave = contacts.widened(cell.weave) if feature == "unlisted-pairs" else cell.weave
    touch = (lambda d, limit: np.full(d.shape[:-1], True)) if feature == "far-pairs" else contacts.can_touch
    with patch.object(contacts, "can_touch", touch):
        return solve_equilibrium(s, Equations.of(weave, cell.wire), DirectOptions())


def forced(feature: str, name: str, cell: Cell, plain: tuple[Equilibrium, float], s: Array) -> Row:
    """One feature in one cell, against the default."""
    found, seconds = least_seconds(partial(solved, cell, s, feature), long=3.0)
    good, was_good = found.status == "converged", plain[0].status == "converged"
    change = float(np.abs(found.pose.lattice - plain[0].pose.lattice)[good & was_good].max())
    overlap = contacts.unlisted_gap(plain[0].pose, cell.weave, cell.wire).min() < 0.0
    default = USED if feature == "unlisted-pairs" and overlap else LEFT_OUT
    times, ok = (plain[1], seconds), bool((good == was_good).all())
    return trial(feature, name, times, change, TOLERANCE, "r1", default=default, ok=ok)


def met_row(name: str, cell: Cell, found: Equilibrium) -> Row:
    """What the solver met: pairs in reach, distance of unlisted pairs."""
    offset, reach = pair_geometry(found.pose, cell.weave)[0], DirectOptions().reach
    near = contacts.can_touch(offset, 2.0 * cell.wire + reach).sum(axis=1)
    row = {"cell": name, "converged": (found.status == "converged").sum()}
    row |= {"listed pairs in reach": f"{near.min()} to {near.max()} of {len(cell.weave.pairs)}"}
    return row | {GAP: contacts.unlisted_gap(found.pose, cell.weave, cell.wire).min()}
