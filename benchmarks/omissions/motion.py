"""Inertia, damping, gyroscopic torques and constraints in a static run of rings, and supports normal to the plane."""

from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.omissions.compare import bars, trial, trial_table, verdict
from benchmarks.problems import Array, loads
from benchmarks.report.measure import Row, least_seconds
from benchmarks.report.records import Section, table
from rve.equilibrium.interior_point import DirectOptions, Equilibrium
from rve.equilibrium.symmetry import solve_equilibrium_symmetric
from rve.equilibrium.system import Equations
from rve.explain import motion_terms
from rve.geometry.cell import Cell
from rve.geometry.kinematics import cauchy_line_load
from rve.paper.motion import TERMS
from rve.paper.stewart_trinkle import StewartTrinkleOptions, solve
from rve.solve import solve_table

SLOW = (45.0, 0.0)
"""The slowest case of the paper, besides the loads in `loads(15.0, 15.0)`."""
ONE = (np.array([0.0]), np.array([45.0]))
CHANGE = "change of the lattice, r1"
TOLERANCE = 1e-9
"""Of a strain: gaps of closed contacts end at mu_end / force, 1e-13 over forces of 1e-4 and more."""


def measure(full: bool) -> Section:
    """The section."""
    given = loads(15.0, 15.0)
    if full:
        given = np.append(given[0], SLOW[0]), np.append(given[1], SLOW[1])
    trials = [forced(term, given if term != "constraints" else ONE) for term in TERMS]
    text = (
        "A locked state has no velocities, so the direct solver solves its equations without inertia, damping and "
        "gyroscopic torques. With `rve case --force inertia` the terms move the rings from the slack pose into the "
        "locked one as in the paper, with compliant contacts; then Newton's method closes the contacts. `constraints` "
        "includes all ten rings, 60 velocities with their bilateral constraints, for the equibiaxial load alone; the "
        f"others are measured for {len(given[0])} loads, alpha 0:45:15 and beta "
        f"15:90:15{', and (45, 0), the slowest' if full else ''}. r1/r2 = 10."
    )
    moving = inside_the_motion(given)
    steps = {row["motion"]: row["steps"] for row in moving}
    conclusion = (
        f"{verdict(trials)} Within the paper's scheme the gyroscopic torques vanish: the numbers of steps are equal "
        f"({steps['all terms']} with them, {steps['as in the paper']} without). Without inertia the motion takes "
        f"{steps['no inertia']} steps: damping determines it, and inertia is kept only because the paper has it."
    )
    motion_note = "The motion ends at R < 1e-9 on its own path, with compliant contacts."
    across_note = (
        "Rings keep their centres in the plane, as in the paper. In symmetric states the supports that do this carry "
        "no force: the states are locked with the third coordinate free, too. It cannot be switched on."
    )
    across = [support_across(ratio) for ratio in (5.0, 10.0, 20.0)]
    small = "at_most 1e-14"
    tables = (
        trial_table("Motion switched on", trials),
        table("The paper's scheme with more and fewer terms", moving, {"s": ".3f timed", CHANGE: small}, motion_note),
        table("The third coordinate of the rings", across, {"largest force along z, s r1": small}, across_note),
    )
    return Section(
        "Motion in static runs", text, tables, (bars("motion", "Motion in a static run", trials),), conclusion
    )


def forced(term: str, given: tuple[Array, Array]) -> Row:
    """A term and those it needs, against the direct solver; the longer run is made once."""
    plain, without = least_seconds(partial(solve_table, Cell(), given))
    options = DirectOptions(force=motion_terms((term,)))
    moved, with_it = least_seconds(partial(solve_table, Cell(), given, options), repeats=1)
    change, count = float(np.abs(moved.E - plain.E).max()), len(plain)
    ok = bool(moved.converged.all() and plain.converged.all())
    return trial(term, f"{count} load{'s' * (count > 1)}", (without, with_it), change, TOLERANCE, ok=ok)


def inside_the_motion(given: tuple[Array, Array]) -> list[Row]:
    """The paper's scheme with more and fewer terms: steps, time, and the difference of its answer."""
    s, paper = cauchy_line_load(*given), StewartTrinkleOptions()
    ways = {
        "as in the paper": paper,
        "all terms": replace(paper, gyroscopic=True),
        "no inertia": replace(paper, inertia=False),
    }
    equations, rows, first = Equations.of(Cell().weave, Cell().wire), [], None
    for name, options in ways.items():
        rest, seconds = least_seconds(partial(solve, s, equations, options))
        first = first or rest
        change = np.abs(rest.pose.lattice - first.pose.lattice).max()
        good = (rest.status == "converged").sum()
        rows.append({"motion": name, "at rest": good, "steps": int(rest.steps.sum()), "s": seconds, CHANGE: change})
    return rows


def support_across(ratio: float) -> Row:
    """Forces of the supports along z, the third coordinate of the centres, which the cell does not have."""
    cell = Cell(5.0, 5.0 / ratio)
    s = cauchy_line_load(*loads(15.0, 15.0))
    found, _ = solve_equilibrium_symmetric(s, Equations.of(cell.weave, cell.wire), DirectOptions())
    good = found.status == "converged"
    force = np.abs(force_across(found, cell))[good].max()
    return {"cell": f"r1/r2 = {ratio:g}", "loads": good.sum(), "largest force along z, s r1": force}


def force_across(found: Equilibrium, cell: Cell) -> np.ndarray:
    """Force along z of all contacts on the rings of class 0, (n,), in s r1."""
    pairs = cell.weave.pairs
    kinds = (pairs[:, 0] == 0).astype(float) - (pairs[:, 1] == 0).astype(float)
    along = np.zeros(found.contacts.gap.shape)
    along[found.contacts.present] = found.contacts.minima.normal[:, 2]
    return np.einsum("p,npk,npk->n", kinds, found.lam, along)
