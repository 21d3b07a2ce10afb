"""Inertia, damping and constraints in a static run of rings, and supports normal to the plane."""

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.optimize import nnls

from benchmarks.frame import Section, table
from benchmarks.measure import Row, least_seconds
from benchmarks.omissions.compare import trial, trial_table, verdict
from benchmarks.problems import Array, loads
from rve import Cell, DirectOptions, SimulationOptions
from rve.geometry import cauchy_line_load
from rve.locking import Equations, Equilibrium, solve_equilibrium, unit_loads
from rve.locking.limits import polish, touching
from rve.simulation import simulate

LIGHT = 1e-6
"""Share of the mass that is left in a motion without inertia."""
TOUCHING = 1e-4
"""Gap in r1 below which a contact that presses at the end of the motion is closed."""
SLIPPERY = 1e-6
"""Coefficient of friction that holds nothing back."""
RESTS = 1e-5
"""Of strains at rest in the scheme, which ends where its rings are slow."""
SLOW = (45.0, 0.0)
"""The slowest case of the paper, besides the loads in `loads(15.0, 15.0)`."""
ACROSS = "unbalanced force, s r1"
TOLERANCE = 1e-9
"""Of lengths in r1: gaps of closed contacts end at mu_end / force, 1e-13 over forces of 1e-4 and more."""


def measure(full: bool) -> Section:
    """The section."""
    given = loads(15.0, 15.0)
    if full:
        given = np.append(given[0], SLOW[0]), np.append(given[1], SLOW[1])
    trials = [*(moved(term, given) for term in ("damping", "inertia")), with_friction(loads(45.0, 30.0))]
    text = (
        "A locked state has no velocities. Here inertia and damping move the rings from the slack pose into it as in "
        f"the paper, with compliant contacts; then Newton's method closes these, for {len(given[0])} loads, alpha "
        f"0:45:15 and beta 15:90:15{', and (45, 0), the slowest' if full else ''}. "
        "`friction`: contacts of the paper's scheme have next to none, and all its unknowns. r1/r2 = 10."
    )
    damped, heavy = (row["_steps"] for row in trials[:2])
    conclusion = (
        f"{verdict(trials)} Within the paper's scheme the motion takes {heavy} steps, and {damped} without inertia: "
        "damping determines it, and inertia is kept only because the paper has it."
    )
    across_note = (
        "Rings keep their centres in the plane, as in the paper. At every locked state contact forces exist that "
        "balance the load without supports along z: the states are locked with the third coordinate free, too."
    )
    across = [support_across(ratio) for ratio in (5.0, 10.0, 20.0)]
    tables = (
        trial_table("Motion switched on", trials),
        table("The third coordinate of the rings", across, {ACROSS: "at_most 1e-14"}, across_note),
    )
    return Section("Motion in static runs", text, tables, (), conclusion)


def moved(term: str, given: tuple[Array, Array]) -> Row:
    """A term and those it needs, against the direct solver; the longer run is made once."""
    s, equations = unit_loads(cauchy_line_load(*given)), Equations.of(Cell().weave, Cell().wire)
    plain, without = least_seconds(partial(solve_equilibrium, s, equations))
    found, with_it = least_seconds(partial(locked_by_motion, given, equations, term), repeats=1)
    change, count = float(np.abs(found.pose.lattice - plain.pose.lattice).max()), len(s)
    ok = bool((found.status == "converged").all() and (plain.status == "converged").all())
    scene = f"{count} load{'s' * (count > 1)}"
    row = trial(term, scene, (without, with_it), change, TOLERANCE, "r1", ok=ok)
    return row | {"_steps": int(found.iterations.sum())}


def with_friction(given: tuple[Array, Array]) -> Row:
    """Friction too small to hold anything back in the paper's scheme, against none."""
    options = SimulationOptions(), SimulationOptions(friction=SLIPPERY)
    calls = (partial(simulate, Cell(), given, one) for one in options)
    (plain, found), seconds = zip(*(least_seconds(call, repeats=1) for call in calls), strict=True)
    ok = bool((np.append(plain.status, found.status) == "converged").all())
    change = float(np.abs(found.E - plain.E).max())
    return trial("friction", f"scheme, {len(found.E)} loads", seconds, change, RESTS, ok=ok)


def locked_by_motion(given: tuple[Array, Array], equations: Equations, term: str) -> Equilibrium:
    """Locked states under the loads (alpha, beta), (n,) each, at the end of motions; iterations are time steps."""
    density = Cell().density
    rest = simulate(Cell(density=LIGHT * density if term == "damping" else density), given).rest
    s, steps, at_rest = rest.s, rest.steps, rest.status == "converged"
    found = polish(rest.pose, equations, s, TOUCHING)
    is_locked = (DirectOptions.tolerance > found.R) & (found.contacts.min_gap > -1e-10) & found.contacts.links_intact
    return replace(found, iterations=steps, status=np.where(at_rest & is_locked, "converged", "stalled"))


def support_across(ratio: float) -> Row:
    """Whether contact forces exist that balance the load and need no support along z, the third coordinate.

    Forces at a locked state are not unique; these balance the load and the third coordinate best.
    """
    cell, options = Cell(5.0, 5.0 / ratio), DirectOptions()
    s = unit_loads(cauchy_line_load(*loads(15.0, 15.0)))
    equations = Equations.of(cell.weave, cell.wire)
    found = solve_equilibrium(s, equations, options)
    good = np.flatnonzero(found.status == "converged")
    force = max(unbalanced_across(found.take(good[[i]]), s[good[[i]]], equations) for i in range(len(good)))
    return {"cell": f"r1/r2 = {ratio:g}", "loads": len(good), ACROSS: force}


def unbalanced_across(found: Equilibrium, s: Array, equations: Equations) -> float:
    """What is left of the load and of the force along z on ring class 0 with the best contact forces >= 0, in s r1."""
    system = equations.assemble(found.pose, found.contacts, np.zeros(found.lam.shape), s)
    pairs = equations.weave.pairs
    kinds = (pairs[:, 0] == 0).astype(float) - (pairs[:, 1] == 0).astype(float)
    across = (kinds[:, None] * found.contacts.normal[0, ..., 2]).ravel()
    active = touching(found.contacts, 1e-8).ravel()
    rows = np.column_stack([system.G[0][active], across[active]])
    return float(nnls(rows.T, -np.append(system.f[0], 0.0))[1])
