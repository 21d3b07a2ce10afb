"""Pairs of rings that cannot touch, in the direct solver."""

from functools import partial
from unittest.mock import patch

import numpy as np

from benchmarks.frame import Section, table
from benchmarks.measure import Row, least_seconds
from benchmarks.omissions.compare import LEFT_OUT, trial, trial_table, verdict
from benchmarks.omissions.motion import TOLERANCE
from benchmarks.problems import Array, loads
from rve import Cell, DirectOptions
from rve.geometry import SIX_IN_ONE, cauchy_line_load, contacts, pair_geometry
from rve.locking import Equations, Equilibrium, solve_equilibrium
from rve.locking.system import REACH

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
    trials = [forced(name, cell, plain[name], s) for name, cell in cells.items()]
    text = (
        f"Locked states of {len(given[0])} loads (alpha 0:45:5, beta 5:90:5). `far-pairs`: listed pairs whose centres "
        "are too far apart to touch are not sampled. Pairs up to four cells apart that the weave does not list have "
        "no forces; where they overlap a row has the status `unlisted`."
    )
    met = [met_row(name, cells[name], found) for name, (found, _) in plain.items()]
    met_note = "The last column is a lower bound where centres are too far apart to touch."
    tables = (
        trial_table("Features switched on in the direct solver", trials),
        table("What the solver met", met, {GAP: ".3f"}, met_note),
    )
    return Section("Pairs of rings", text, tables, (), verdict(trials))


def solved(cell: Cell, s: Array, *, far_pairs: bool = False) -> Equilibrium:
    """Locked states under the line loads s (n, 3)."""
    touch = (lambda d, limit: np.full(d.shape[:-1], True)) if far_pairs else contacts.can_touch
    with patch.object(contacts, "can_touch", touch):
        return solve_equilibrium(s, Equations.of(cell.weave, cell.wire), DirectOptions())


def forced(name: str, cell: Cell, plain: tuple[Equilibrium, float], s: Array) -> Row:
    """Far pairs in one cell, against the default."""
    found, seconds = least_seconds(partial(solved, cell, s, far_pairs=True), long=3.0)
    good, was_good = found.status == "converged", plain[0].status == "converged"
    change = float(np.abs(found.pose.lattice - plain[0].pose.lattice)[good & was_good].max())
    times, ok = (plain[1], seconds), bool((good == was_good).all())
    return trial("far-pairs", name, times, change, TOLERANCE, "r1", default=LEFT_OUT, ok=ok)


def met_row(name: str, cell: Cell, found: Equilibrium) -> Row:
    """What the solver met: pairs in reach, distance of unlisted pairs."""
    offset = pair_geometry(found.pose, cell.weave)[0]
    near = contacts.can_touch(offset, 2.0 + 2.0 * cell.wire + REACH).sum(axis=1)
    row = {"cell": name, "converged": (found.status == "converged").sum()}
    row |= {"listed pairs in reach": f"{near.min()} to {near.max()} of {len(cell.weave.pairs)}"}
    return row | {GAP: contacts.unlisted_gap(found.pose, cell.weave, cell.wire).min()}
