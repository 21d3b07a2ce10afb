"""Section `rve`: error of the locked strain against processor time, by every method on the same cell and loads."""

from __future__ import annotations

import importlib.util
import tempfile
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.pages.measuring import decade, least_seconds
from benchmarks.pages.model import Column, Curve, Diagram, Section, Table, Value
from benchmarks.work_precision import peers
from benchmarks.work_precision.generic import SOLVERS, Programme
from rve import stewart_trinkle as st
from rve.cell import Pose
from rve.equilibrium import DirectOptions, Equilibrium, solve_equilibrium
from rve.load import cauchy_line_load, green_lagrange, second_pk
from rve.ranges import grid, parse_angles
from rve.sweep import Cell, reference_sides
from rve.system import Equations
from rve.uniqueness import strain_is_unique

Array = NDArray[np.float64]

CASES = ((0.0, 90.0), (0.0, 45.0), (20.0, 30.0), (30.0, 60.0), (45.0, 0.0), (45.0, 90.0))
PEER_CASE = (0.0, 45.0)
FOUND = 0.1
"""A strain farther from the reference is that of another state, or of none: the case does not count as solved."""
REFERENCE = DirectOptions(tolerance=1e-12, mu_end=1e-15)
PUBLISHED = st.StewartTrinkleOptions()


@dataclass(frozen=True)
class Problem:
    """The cell with its equations, loads s (n, 3), and the reference strains E (n, 3) under them.

    `sides` of the reference cell in units of r1; `unique` (n,) is false where the load leaves the strain free.
    """

    cell: Cell
    equations: Equations
    sides: tuple[float, float]
    loads: tuple[tuple[float, float], ...]
    s: Array
    found: Equilibrium
    unique: NDArray[np.bool_]

    @property
    def E(self) -> Array:
        """Reference strains, (n, 3)."""
        return self.strain(self.found.pose)

    def deformation(self, pose: Pose) -> Array:
        """F (n, 2, 2) of poses."""
        return np.stack([pose.a1 / self.sides[0], pose.a2 / self.sides[1]], axis=2)

    def strain(self, pose: Pose) -> Array:
        """E (n, 3) of poses."""
        return green_lagrange(self.deformation(pose))

    def errors(self, pose: Pose) -> Array:
        """Largest component error of E, (n,); 0 where the load leaves the strain free: there every one is right."""
        return np.asarray(np.where(self.unique, np.abs(self.strain(pose) - self.E).max(axis=1), 0.0))


@dataclass(frozen=True)
class Run:
    """One method at one setting: solved of `cases`, largest error of E among these, processor seconds per case.

    `work` counts what does not depend on the machine (iterations, steps, or evaluations of all gaps).
    """

    method: str
    setting: str
    cases: int
    solved: int
    error: float
    seconds: float
    work: int
    unit: str


def problem(loads: Iterable[tuple[float, float]] = CASES, cell: Cell | None = None) -> Problem:
    """The cell r1/r2 = 10 under these load directions (alpha, beta) in degrees, with the reference solved."""
    cell = cell or Cell()
    loads = tuple(loads)
    equations = Equations.of(cell.weave, cell.wire)
    b_x, b_y = (side / cell.r1 for side in reference_sides(cell, DirectOptions()))
    s = cauchy_line_load(*np.array(loads).T)
    found = solve_equilibrium(s, equations, REFERENCE)
    return Problem(cell, equations, (b_x, b_y), loads, s, found, strain_is_unique(equations, found, s))


def run_of(
    label: tuple[str, str], errors: Array, converged: NDArray[np.bool_], seconds: float, work: tuple[int, str]
) -> Run:
    """A run from the error (n,) and the status (n,) of every case, seconds of all cases, and the work with its unit."""
    good = converged & (errors < FOUND)
    error = float(errors[good].max()) if good.any() else float("nan")
    return Run(*label, len(errors), int(good.sum()), error, seconds / len(errors), *work)


def direct_options(mu: float) -> DirectOptions:
    """The rung of the direct solver's ladder that stops at this complementarity, residual to match."""
    return DirectOptions(tolerance=100.0 * mu, mu_end=mu)


def direct_alone(given: Problem, ladder: Sequence[float]) -> list[Run]:
    """The direct solver, one case at a time."""
    runs = []
    for mu in ladder:
        options, errors, good, seconds, work = direct_options(mu), [], [], 0.0, 0
        for i in range(len(given.s)):
            one, took = least_seconds(partial(solve_equilibrium, given.s[i : i + 1], given.equations, options))
            errors.append(np.abs(given.strain(one.pose)[0] - given.E[i]).max())
            good.append(one.status[0] == "converged")
            seconds, work = seconds + took, work + int(one.iterations[0])
        label = "direct, one case alone", f"mu {mu:.0e}"
        runs.append(run_of(label, np.array(errors), np.array(good), seconds, (work, "iterations")))
    return runs


def direct_batch(given: Problem, ladder: Sequence[float]) -> list[Run]:
    """The direct solver, all cases in one batch."""
    runs = []
    for mu in ladder:
        found, seconds = least_seconds(
            partial(solve_equilibrium, given.s, given.equations, direct_options(mu)), repeats=2, long=5.0
        )
        label = f"direct, batch of {len(given.s)}", f"mu {mu:.0e}"
        good = found.status == "converged"
        work = int(found.iterations.sum()), "iterations"
        runs.append(run_of(label, given.errors(found.pose), good, seconds, work))
    return runs


def scheme(given: Problem, name: str, ladder: Sequence[tuple[str, st.StewartTrinkleOptions]]) -> list[Run]:
    """The paper's scheme, all cases in one batch, over a ladder of options."""
    runs = []
    for setting, options in ladder:
        rest, seconds = least_seconds(partial(st.solve, given.s, given.equations, options), long=0.0)
        good = rest.status == "converged"
        work = int(rest.steps.sum() + rest.rejected.sum()), "steps"
        runs.append(run_of((f"scheme, {name}", setting), given.errors(rest.pose), good, seconds, work))
    return runs


def extrapolated(given: Problem, stiffnesses: Sequence[float]) -> list[Run]:
    """The paper's scheme at two stiffnesses k and 10 k each, extrapolated to rigid contact: the error is of order 1/k.

    Nothing is shared with the direct solver but the contact search: its agreement with the last rung is the proof of
    the reference.
    """
    found = {}
    for k in sorted({factor * k for k in stiffnesses for factor in (1.0, 10.0)}):
        options = replace(PUBLISHED, stiffness=k, tolerance=1e-11)
        found[k] = least_seconds(partial(st.solve, given.s, given.equations, options), long=0.0)
    runs = []
    for k in stiffnesses:
        (soft, t_soft), (stiff, t_stiff) = found[k], found[10.0 * k]
        E = (10.0 * given.strain(stiff.pose) - given.strain(soft.pose)) / 9.0
        good = (soft.status == "converged") & (stiff.status == "converged")
        steps = int(soft.steps.sum() + soft.rejected.sum() + stiff.steps.sum() + stiff.rejected.sum())
        label = "scheme, extrapolated to rigid", f"k {k:.0e} and {10 * k:.0e}"
        errors = np.abs(E - given.E).max(axis=1)
        runs.append(run_of(label, errors, good, t_soft + t_stiff, (steps, "steps")))
    return runs


def generic(given: Problem, name: str, start: str, ladder: Sequence[float]) -> list[Run]:
    """A solver of nonlinear programmes from the slack pose or from near the answer, over its tolerances."""
    F = given.deformation(given.found.pose)
    S = second_pk(F, given.s) * given.sides[0] * given.sides[1]
    solve, runs = SOLVERS[name], []
    for tolerance in ladder:
        rng = np.random.default_rng(0)
        errors, seconds, calls = np.zeros(len(S)), 0.0, 0
        for i in range(len(S)):
            near = Programme(S[i], given.equations, given.sides).coordinates(given.found.pose, i)
            q0 = np.zeros(9) if start == "slack" else near + rng.uniform(-0.02, 0.02, 9)
            programme = Programme(S[i], given.equations, given.sides)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # SciPy's own about singular Jacobians: the outcome is measured
                q, took = least_seconds(partial(solve, programme, q0, tolerance), long=0.0)
            errors[i] = np.abs(programme.strain(q)[0] - given.E[i]).max()
            seconds, calls = seconds + took, calls + programme.calls
        good = np.isfinite(errors)  # what they say of themselves is not believed: the error decides
        label = f"{name}, {start} start", f"tolerance {tolerance:.0e}"
        runs.append(run_of(label, errors, good, seconds, (calls, "gap evaluations")))
    return runs


def peer_runs(given: Problem, full: bool) -> tuple[list[Run], list[str]]:
    """Yade and MuJoCo under `PEER_CASE`, and a sentence for each that is absent. `given` holds that load alone."""
    s1, s2 = float(given.s[0, 0]), float(given.s[0, 2])
    runs, absent = [], []

    def add(method: str, setting: str, answer: peers.PeerAnswer) -> None:
        sides = np.array(given.sides) * given.cell.r1
        F = np.diag(np.array([answer.x2_mm, answer.y3_mm]) / sides)[None]
        error = np.abs(green_lagrange(F) - given.E).max(axis=1)
        setting = setting if answer.status == "converged" else f"{setting} ({answer.status})"
        runs.append(run_of((method, setting), error, np.array([True]), answer.seconds, (answer.steps, "steps")))

    if peers.yade_command() is None:
        absent.append("Yade is not installed (`apt-get install yade`)")
    else:
        with tempfile.TemporaryDirectory() as folder:
            for spheres, tolerance in ((48, 1e-2), (96, 1e-2), (96, 1e-3), (192, 1e-3)) + ((384, 1e-3),) * full:
                answer = peers.run_yade(given.cell, (s1, s2), spheres, tolerance, Path(folder))
                add("Yade, spheres", f"{spheres} spheres, stress to {tolerance:.0e}", answer)
    if peers.mujoco_version() == "absent":
        absent.append("MuJoCo is not installed (`pip install mujoco`)")
    else:
        for capsules in (24, 48, 96, 192) + (384,) * full:
            options = peers.MujocoOptions(capsules, 20_000)
            add("MuJoCo, capsules", f"{capsules} capsules", peers.run_mujoco(given.cell, (s1, s2), options))
        for dt, steps in ((0.05, 1000), (0.02, 2000), (0.01, 4000)) + ((0.005, 16_000),) * full:
            options = peers.MujocoOptions(0, steps, dt)
            answer = peers.run_mujoco(given.cell, (s1, s2), options)
            add("MuJoCo, torus", f"step {dt} s, {steps} steps", answer)
    return runs, absent


def reference_table(given: Problem, other: Run) -> Table:
    """Reference strains, and how far an independent method is from them."""
    columns = (Column("alpha, beta [deg]"), *(Column(name, "+.8f") for name in ("E11", "E12", "E22")))
    rows: tuple[tuple[Value, ...], ...] = tuple(
        (f"{a:g}, {b:g}", *(float(x) + 0.0 for x in np.round(E, 8)))
        for (a, b), E in zip(given.loads, given.E, strict=True)
    )
    note = (
        f"Direct solver at mu = {REFERENCE.mu_end:.0e}. The paper's scheme extrapolated to rigid contact "
        f"({other.setting} kg/s2), which shares only contact search, differs by {decade(other.error, 1e-9)} at most."
    )
    return Table("Reference", columns, rows, note)


def run_table(title: str, runs: Sequence[Run], note: str = "") -> Table:
    """A row for each run."""
    columns = (
        Column("method"),
        Column("setting"),
        Column("solved"),
        Column("largest error of E"),
        Column("ms per case", ".3g", timed=True),
        Column("s for 190 cases", ".3g", timed=True),
        Column("work per case", ".0f"),
        Column("unit"),
    )
    rows = tuple(
        (
            run.method,
            run.setting,
            f"{run.solved} of {run.cases}",
            decade(run.error),
            1e3 * run.seconds,
            190.0 * run.seconds,
            run.work / run.cases,
            run.unit,
        )
        for run in runs
    )
    return Table(title, columns, rows, note)


def curves(runs: Sequence[Run]) -> tuple[Curve, ...]:
    """Error and seconds per case of every method that solves something, in the order of its ladder; failures named."""
    out = []
    for name in dict.fromkeys(run.method for run in runs if run.solved):
        mine = [run for run in runs if run.method == name]
        fewest = min(mine, key=lambda run: run.solved / run.cases)
        label = name if fewest.solved == fewest.cases else f"{name} ({fewest.solved} of {fewest.cases})"
        out.append(Curve(label, tuple(run.error for run in mine), tuple(run.seconds for run in mine)))
    return tuple(out)


def scheme_runs(given: Problem, full: bool) -> list[Run]:
    """The paper's scheme over time step, damping, contact stiffness, and extrapolated."""
    base = PUBLISHED
    steps = (100.0, 10.0, 1.0) + (0.3, 0.1) * full
    damped = (0.1, 1.0, 3.0) + (10.0,) * full
    stiff = (1e4, 1e5, 1e6, 1e7) + (1e8, 1e9) * full
    ladders = {
        "h_max": [(f"h_max {h:g} s", replace(base, h_max=h)) for h in steps],
        "damping": [
            (f"damping x {f:g}", replace(base, damping=f, rotational_damping=100.0 * f)) for f in damped if f != 1.0
        ],
        "k": [(f"k {k:.0e} kg/s2", replace(base, stiffness=k)) for k in stiff],
    }
    runs = [run for name, ladder in ladders.items() for run in scheme(given, name, ladder)]
    return runs + extrapolated(given, (1e4, 1e5, 1e6))


def generic_runs(given: Problem, full: bool) -> tuple[list[Run], list[str]]:
    """All generic solvers that are installed, from both starts."""
    runs: list[Run] = []
    for name, ladder in (("SLSQP", (1e-6, 1e-10, 1e-14)), ("IPOPT", (1e-4, 1e-6, 1e-9)), ("trust-constr", (1e-6,))):
        if name == "IPOPT" and importlib.util.find_spec("casadi") is None:
            continue
        for start in ("near", "slack"):
            runs += generic(given, name, start, ladder if full or start == "near" else ladder[-1:])
    absent = [] if importlib.util.find_spec("casadi") else ["IPOPT is not installed (`pip install casadi`)"]
    return runs, absent


def table_runs(full: bool) -> list[Run]:
    """The paper's 190 cases in one batch."""
    alpha, beta = grid(parse_angles("0:45:5", "alpha"), parse_angles("0:90:5", "beta"))
    whole = problem(zip(alpha, beta, strict=True))
    ladder = [("h_max 100 s", replace(PUBLISHED, h_max=100.0))] * full + [("h_max 1 s, as published", PUBLISHED)]
    return direct_batch(whole, (1e-5, 1e-7, 1e-9, 1e-11, 1e-13)) + scheme(whole, "190 cases", ladder)


def measure(full: bool) -> Section:
    """The section: reference, ladders of every method on six loads, the 190-case table, generic solvers, peers."""
    given = problem()
    alone = direct_alone(given, (1e-3, 1e-5, 1e-7, 1e-9, 1e-11, 1e-13))
    damped = scheme_runs(given, full)
    others, absent = generic_runs(given, full)
    strange, missing = peer_runs(problem([PEER_CASE]), full)
    whole = table_runs(full)
    tables = (
        reference_table(given, damped[-1]),
        run_table("Six loads: direct, and the scheme of the paper", [*alone, *damped]),
        run_table("190 loads in one batch", whole, NOT_UNIQUE),
        run_table("Six loads: solvers of nonlinear programmes", others, " ".join(f"{text}." for text in absent)),
        run_table(f"The load {PEER_CASE}: rings in Yade and MuJoCo", strange, " ".join(f"{text}." for text in missing)),
    )
    diagram = Diagram(
        "rve",
        "Locked strain: error against time, one load case",
        "largest error of a strain component",
        "processor time per case [s]",
        curves([*alone, *whole, *damped, *others, *strange]),
    )
    return Section("rve", "Locked strains", TEXT, tables, (diagram,), conclusion(alone, damped, others, strange, whole))


NOT_UNIQUE = (
    "Where a load leaves the strain free (uniaxial loads at 15 to 40 degrees) every strain it may have is right."
)
TEXT = f"""4-in-1, r1 = 5 mm, r2 = 0.5 mm; loads by (alpha, beta). The error is the largest component of E less the
reference over the solved cases; a case is solved if the method says that it has converged and is within {FOUND} of the
reference (what the generic solvers say of themselves is not believed: only the error counts).

* **direct**: our interior-point method; the ladder stops at the complementarity mu = force times gap, one case at a
  time, or 190 in a batch.
* **scheme**: the paper's damped motion, its cases in a batch, to R < 1e-9, over time step, damping and contact
  stiffness k. At finite k rings give: the error is of order 1/k, and two stiffnesses extrapolate to rigid contact.
* **SLSQP, trust-constr, IPOPT**: maximise S:E with all gaps >= 0, first derivatives exact, and S of the answer given
  away; from the slack pose, and from the answer moved by up to 0.02 in each coordinate.
* **Yade** (eight rings, its periodic cell and stress control, frictionless spheres) and **MuJoCo** (the ten rings of
  the paper tied to two lattice joints; its own torus, or capsules) start from our slack pose under the load
  {PEER_CASE}: compared are the strains of the sides of the cell where they come to rest. Their time is
  the solver's own processor time, start-up left out."""


def conclusion(
    alone: Sequence[Run], damped: Sequence[Run], others: Sequence[Run], strange: Sequence[Run], whole: Sequence[Run]
) -> str:
    """What follows, in numbers of this run."""
    one, batch, table = alone[-1], [run for run in whole if run.unit == "iterations"][-1], whole[-1]
    steps = {run.setting: run for run in damped if run.method == "scheme, h_max"}
    long, published = steps["h_max 100 s"], steps["h_max 1 s"]
    rigid = damped[-1]
    lines = [
        f"The direct solver is the default: {one.solved} of {one.cases} and {batch.solved} of {batch.cases} loads, "
        f"error {decade(batch.error)}, {1e3 * batch.seconds:.1f} ms per case in a batch and {1e3 * one.seconds:.0f} ms "
        f"alone. Tolerance is cheap: from mu = 1e-5 to 1e-13 the error falls from {decade(whole[0].error)} to "
        f"{decade(batch.error)} for {batch.seconds / whole[0].seconds:.1f} times the time.",
        f"The scheme takes {table.seconds / batch.seconds:.0f} times as long for the 190 loads (both in a batch; "
        f"{table.solved} solved), with an error of {decade(table.error)} that belongs to its contact stiffness. On the "
        f"six loads h_max = 100 s takes {long.work / published.work:.2f} of the steps of the published 1 s and ends at "
        f"an error of {decade(long.error)}, as that does ({decade(published.error)}): the way there does not matter. "
        f"Extrapolated to rigid contact the scheme reaches {decade(rigid.error, 1e-9)} at "
        f"{rigid.seconds / one.seconds:.0f} times the time of the direct solver alone.",
    ]
    if others:
        by_name = [
            (name, [run for run in others if run.method == name]) for name in dict.fromkeys(r.method for r in others)
        ]
        lines.append(
            "Generic solvers solve "
            + ", ".join(f"{max(run.solved for run in runs)} of {runs[0].cases} ({name})" for name, runs in by_name)
            + ": without knowing rings they step through the wire into states that are none."
        )
    best = {run.method: run for run in sorted(strange, key=lambda run: -run.error) if run.solved}
    if best:
        lines.append(
            "Best error of the peers: "
            + ", ".join(
                f"{name} {decade(run.error)} at {run.seconds / one.seconds:.0f} times the time"
                for name, run in best.items()
            )
            + " of the direct solver alone, which is at "
            + f"{decade(one.error)}."
        )
    return "\n\n".join(lines)
