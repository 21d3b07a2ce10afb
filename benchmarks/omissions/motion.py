"""Inertia, damping, gyroscopic torques and constraints in a static run of rings, and the support across the plane."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.omissions.compare import LEFT_OUT, NOISE, Trial, bars, table, verdict
from benchmarks.pages.measuring import at_most, least_seconds
from benchmarks.pages.model import Column, Section, Table
from rve.equilibrium import DirectOptions, Equilibrium
from rve.explain import motion_terms
from rve.load import cauchy_line_load
from rve.motion import TERMS
from rve.ranges import grid
from rve.stewart_trinkle import StewartTrinkleOptions, solve
from rve.sweep import Cell, solve_table
from rve.symmetry import solve_equilibrium_symmetric
from rve.system import Equations
from rve.table import StrainTable

LOADS = tuple((float(alpha), float(beta)) for alpha in range(0, 46, 15) for beta in range(15, 91, 15))
# The slowest of all in the paper, beside the vertices of the grid above.
SLOW = (45.0, 0.0)
ONE = (0.0, 45.0)
TOLERANCE = 1e-9
"""Of a strain: gaps of working contacts end at mu_end / force, 1e-13 over forces of 1e-4 and more."""


def measure(full: bool) -> Section:
    """The section."""
    loads = (*LOADS, SLOW) if full else LOADS
    trials = [forced(term, loads if term != "constraints" else (ONE,)) for term in TERMS]
    text = (
        "A locked state has no speeds, so the direct solver solves its equations without inertia, damping and "
        "gyroscopic torques. Forced on (`rve case --force inertia`), the terms carry the rings from the slack pose "
        "into the locked one as in the paper, and Newton's method then closes the contacts, compliant on the way. "
        "`constraints` writes out all ten rings, 60 velocities with their bilateral constraints, for the equibiaxial "
        f"load alone; the others for {len(loads)} loads, alpha 0:45:15 and beta 15:90:15"
        f"{', and (45, 0), the slowest' if full else ''}. r1/r2 = 10."
    )
    moving, steps = inside_the_motion(loads)
    across = support_across()
    diagram = bars("motion", "A motion where a state is asked for", trials)
    conclusion = (
        f"{verdict(trials)} Within the paper's scheme the gyroscopic torques vanish: the steps are the same "
        f"({steps['all terms']} with them, {steps['as in the paper']} without). Without inertia the motion takes "
        f"{steps['no inertia']} steps: its damping rules, and inertia is kept only because the paper has it."
    )
    return Section(
        "motion",
        "Motion in static runs",
        text,
        (table("Motion forced on", trials), moving, across),
        (diagram,),
        conclusion,
    )


def table_of(loads: tuple[tuple[float, float], ...], force: tuple[str, ...] = ()) -> StrainTable:
    """The strain table of these loads."""
    alpha, beta = np.array(loads).T
    return solve_table(alpha, beta, Cell(), DirectOptions(force=force))


def forced(term: str, loads: tuple[tuple[float, float], ...]) -> Trial:
    """A term and those it needs, against the direct solver; the longer run is made once."""
    plain, without = least_seconds(lambda: table_of(loads))
    moved, with_it = least_seconds(lambda: table_of(loads, motion_terms((term,))), repeats=1)
    change = float(np.abs(moved.E - plain.E).max())
    ok = bool(moved.converged.all() and plain.converged.all())
    return Trial(
        term, f"{len(loads)} load{'s' if len(loads) > 1 else ''}", LEFT_OUT, without, with_it, change, TOLERANCE, ok=ok
    )


def inside_the_motion(loads: tuple[tuple[float, float], ...]) -> tuple[Table, dict[str, int]]:
    """The paper's scheme with more and fewer terms: steps, time, where it ends; and the steps of each."""
    s = cauchy_line_load(*np.array(loads).T)
    equations, paper = Equations.of(Cell().weave, Cell().wire), StewartTrinkleOptions()
    ways = {
        "as in the paper": paper,
        "all terms": replace(paper, gyroscopic=True),
        "no inertia": replace(paper, inertia=False),
    }
    rows, steps = [], {}
    first = None
    for name, options in ways.items():
        rest, seconds = least_seconds(partial(solve, s, equations, options))
        first = rest if first is None else first
        change = float(np.abs(rest.pose.lattice - first.pose.lattice).max())
        steps[name] = int(rest.steps.sum())
        good = int((rest.status == "converged").sum())
        rows.append((name, good, steps[name], seconds, at_most(change, NOISE)))
    columns = (
        Column("motion"),
        Column("at rest"),
        Column("steps"),
        Column("s", ".3f", timed=True),
        Column("change of the lattice, r1"),
    )
    note = "The motion ends at R < 1e-9 on its own path, with compliant contacts."
    return Table("The paper's scheme with more and fewer terms", columns, tuple(rows), note), steps


def support_across() -> Table:
    """Forces of the supports along z, the third coordinate of the centres that the cell does without."""
    loads = grid(np.arange(0.0, 46.0, 15.0), np.arange(15.0, 91.0, 15.0))
    rows = []
    for ratio in (5.0, 10.0, 20.0):
        cell = Cell(5.0, 5.0 / ratio)
        equations = Equations.of(cell.weave, cell.wire)
        found, _ = solve_equilibrium_symmetric(cauchy_line_load(*loads), equations, DirectOptions())
        good = found.status == "converged"
        rows.append(
            (f"r1/r2 = {ratio:g}", int(good.sum()), at_most(np.abs(force_across(found, cell))[good].max(), NOISE))
        )
    columns = (Column("cell"), Column("loads"), Column("largest force along z, s r1"))
    note = (
        "Rings keep their centres in the plane, as in the paper. In symmetric states the supports that do this carry "
        "nothing: they are locked states with the third coordinate free, too. It cannot be forced on."
    )
    return Table("The third coordinate of the rings", columns, tuple(rows), note)


def force_across(found: Equilibrium, cell: Cell) -> np.ndarray:
    """Force along z of all contacts on the rings of class 0, (n,), in s r1."""
    pairs = cell.weave.pairs
    kinds = (pairs[:, 0] == 0).astype(float) - (pairs[:, 1] == 0).astype(float)
    along = np.zeros(found.contacts.gap.shape)
    along[found.contacts.present] = found.contacts.minima.normal[:, 2]
    return np.einsum("p,npk,npk->n", kinds, found.lam, along)
