"""Section `rve`: error of the locked strain against processor time, by every method on the same cell and loads."""

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.frame import Curve, Diagram, Section, Table, curves, table
from benchmarks.measure import Row, decade, ladder
from benchmarks.problems import loads as paper_loads
from benchmarks.work_precision.generic import Programme, slsqp
from rve import Cell, DirectOptions
from rve.geometry import Pose, cauchy_line_load, deformation, second_pk, strain_of
from rve.locking import Equations, Equilibrium, solve_equilibrium
from rve.locking.limits import strain_is_unique
from rve.simulation import SimulationOptions, simulate
from rve.solve import reference_sides

Array = NDArray[np.float64]

CASES = ((0.0, 90.0), (0.0, 45.0), (20.0, 30.0), (30.0, 60.0), (45.0, 0.0), (45.0, 90.0))
OTHERS = (("4-in-1", 5.0), ("6-in-1", 7.0), ("6-in-1", 20.0))
FOUND = 0.1
"""A strain farther from the reference belongs to another state: the case does not count as solved."""
REFERENCE = DirectOptions(tolerance=1e-12, mu_end=1e-15)
PUBLISHED = SimulationOptions()
ERROR = "largest error of E"


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

    def strain(self, pose: Pose) -> Array:
        """E (n, 3) of poses."""
        return strain_of(pose, self.sides)


class Answer(NamedTuple):
    """Strains E (n, 3) of a method, whether it says that they converged (n,), and the work of all cases.

    Work counts what does not depend on the machine: iterations, steps, or evaluations of all gaps.
    """

    E: Array
    good: NDArray[np.bool_]
    work: int


Solve = Callable[[Problem, Any], Answer]


def problem(loads: Iterable[tuple[float, float]] = CASES, cell: Cell | None = None) -> Problem:
    """The cell r1/r2 = 10 under these load directions (alpha, beta) in degrees, with the reference solved."""
    cell = cell or Cell()
    loads = tuple(loads)
    equations = Equations.of(cell.weave, cell.wire)
    b_x, b_y = (side / cell.r1 for side in reference_sides(cell, DirectOptions()))
    s = cauchy_line_load(*np.array(loads).T)
    found = solve_equilibrium(s, equations, REFERENCE)
    return Problem(cell, equations, (b_x, b_y), loads, s, found, strain_is_unique(equations, found, s))


def runs(
    given: Problem,
    method: str,
    unit: str,
    solve: Solve,
    settings: Mapping[str, Any],
    repeats: int = 3,
    long: float = 0.0,
) -> list[Row]:
    """A row for each setting of a method; where a load leaves the strain free, any strain is right."""

    def judge(answer: Answer, seconds: float) -> Row:
        errors = np.where(given.unique, np.abs(answer.E - given.E).max(axis=1), 0.0)
        good, n = answer.good & (errors < FOUND), len(errors)
        largest = errors[good].max() if good.any() else np.nan
        row: Row = {"solved": f"{good.sum()} of {n}", ERROR: largest}
        row |= {"ms per case": 1e3 * seconds / n, "s for 190 cases": 190.0 * seconds / n}
        return row | {"work per case": answer.work / n, "unit": unit, "_share": good.mean(), "_s": seconds / n}

    return ladder(method, {name: partial(solve, given, one) for name, one in settings.items()}, judge, repeats, long)


def direct(given: Problem, mu: float) -> Answer:
    """The direct solver, all cases in one batch, to this complementarity."""
    found = solve_equilibrium(given.s, given.equations, DirectOptions(tolerance=100.0 * mu, mu_end=mu))
    return Answer(given.strain(found.pose), found.status == "converged", int(found.iterations.sum()))


def direct_alone(given: Problem, mu: float) -> Answer:
    """The direct solver, one case at a time."""
    found = [direct(replace(given, s=s[None]), mu) for s in given.s]
    E, good = np.concatenate([one.E for one in found]), np.concatenate([one.good for one in found])
    return Answer(E, good, sum(one.work for one in found))


def scheme(given: Problem, options: SimulationOptions) -> Answer:
    """The paper's scheme, all cases in one batch."""
    rest = simulate(given.cell, tuple(np.array(given.loads).T), options).rest
    return Answer(given.strain(rest.pose), rest.status == "converged", int((rest.steps + rest.rejected).sum()))


def extrapolated(given: Problem, k: float) -> Answer:
    """The paper's scheme at two stiffnesses k and 10 k, extrapolated to rigid contact: its error is of order 1/k.

    The scheme shares only the contact search with the direct solver: the agreement of both confirms the reference.
    """
    soft, stiff = (scheme(given, replace(PUBLISHED, stiffness=f * k, tolerance=1e-11)) for f in (1.0, 10.0))
    return Answer((10.0 * stiff.E - soft.E) / 9.0, soft.good & stiff.good, soft.work + stiff.work)


def generic(given: Problem, tolerance: float, start: str) -> Answer:
    """SLSQP from the slack pose or from near the answer; its own status is ignored."""
    S = second_pk(deformation(given.found.pose, given.sides), given.s) * given.sides[0] * given.sides[1]
    rng, E, calls = np.random.default_rng(0), np.zeros_like(S), 0
    for i in range(len(S)):
        programme = Programme(S[i], given.equations, given.sides)
        near = programme.coordinates(given.found.pose, i)
        q0 = np.zeros(9) if start == "slack" else near + rng.uniform(-0.02, 0.02, 9)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # SciPy warns of singular Jacobians: the outcome is measured
            E[i] = programme.strain(slsqp(programme, q0, tolerance))[0]
        calls += programme.calls
    return Answer(E, np.isfinite(E).all(axis=1), calls)


def generic_runs(given: Problem, full: bool) -> list[Row]:
    """SLSQP from both starts."""
    rows: list[Row] = []
    for start in ("near", "slack"):
        settings = {f"tolerance {t:.0e}": t for t in ((1e-6, 1e-10, 1e-14) if full or start == "near" else (1e-14,))}
        rows += runs(given, f"SLSQP, {start} start", "gap evaluations", partial(generic, start=start), settings)
    return rows


def reference_table(given: Problem, other: Row) -> Table:
    """Reference strains, and their difference from an independent method."""
    names = ("E11", "E12", "E22")
    rows = [
        {"alpha, beta [deg]": f"{a:g}, {b:g}"} | dict(zip(names, E + 0.0, strict=True))
        for (a, b), E in zip(given.loads, np.round(given.E, 8), strict=True)
    ]
    note = (
        f"Direct solver at mu = {REFERENCE.mu_end:.0e}. The largest difference from the paper's scheme, extrapolated "
        f"to rigid contact ({other['setting']} kg/s2), is {decade(other[ERROR], 1e-9)}. Both share only the contact "
        "search."
    )
    return table("Reference", rows, dict.fromkeys(names, "+.8f"), note)


FORMS = {ERROR: "decade", "ms per case": ".3g", "s for 190 cases": ".3g", "work per case": ".0f"}


def curves_of(rows: Sequence[Row]) -> tuple[Curve, ...]:
    """Error and seconds per case of every method that solves something, in the order of its ladder; failures named."""
    found = []
    for curve in curves(rows, "method", ERROR, "_s"):
        fewest = min((row for row in rows if row["method"] == curve.label), key=lambda row: row["_share"])
        label = curve.label if fewest["_share"] == 1.0 else f"{curve.label} ({fewest['solved']})"
        found += [replace(curve, label=label)] * bool(np.isfinite(curve.x).any())
    return tuple(found)


def scheme_runs(given: Problem, full: bool) -> list[Row]:
    """The paper's scheme over time step, damping, contact stiffness, and extrapolated."""
    factors, ks = (0.1, 3.0) + (10.0,) * full, (1e4, 1e5, 1e6, 1e7) + (1e8, 1e9) * full
    varied: dict[str, dict[str, Any]] = {
        "h_max": {f"h_max {h:g} s": {"h_max": h} for h in (100.0, 10.0, 1.0) + (0.3, 0.1) * full},
        "damping": {f"damping x {f:g}": {"damping": f} for f in factors},
        "k": {f"k {k:.0e} kg/s2": {"stiffness": k} for k in ks},
    }
    rows: list[Row] = []
    for name, settings in varied.items():
        options = {setting: replace(PUBLISHED, **changes) for setting, changes in settings.items()}
        rows += runs(given, f"scheme, {name}", "steps", scheme, options)
    pairs = {f"k {k:.0e} and {10 * k:.0e}": k for k in (1e4, 1e5, 1e6)}
    return rows + runs(given, "scheme, extrapolated to rigid", "steps", extrapolated, pairs)


def other_cells(repeats: int = 3) -> list[Row]:
    """Both methods on other weaves and wires, over contact stiffness and complementarity."""
    rows: list[Row] = []
    for weave, ratio in OTHERS:
        given, name = problem(cell=Cell(5.0, 5.0 / ratio, weave)), f"{weave}, r1/r2 = {ratio:g}"
        rows += runs(
            given, f"direct, {name}", "iterations", direct, {f"mu {mu:.0e}": mu for mu in (1e-7, 1e-11)}, repeats
        )
        ks = {f"k {k:.0e} kg/s2": replace(PUBLISHED, stiffness=k) for k in (1e5, 1e6, 1e7)}
        rows += runs(given, f"scheme, {name}", "steps", scheme, ks, repeats)
    return rows


def measure(full: bool) -> Section:
    """The section: reference, ladders of every method on six loads, the 190-case table, generic solvers."""
    given, paper = problem(), problem(zip(*paper_loads(), strict=True))
    mus = {f"mu {mu:.0e}": mu for mu in (1e-3, 1e-5, 1e-7, 1e-9, 1e-11, 1e-13)}
    alone = runs(given, "direct, one case alone", "iterations", direct_alone, mus, long=5.0)
    damped = scheme_runs(given, full)
    others = generic_runs(given, full)
    fine_mus = dict([*mus.items()][1:])
    batch = runs(paper, "direct, batch of 190", "iterations", direct, fine_mus, repeats=2, long=5.0)
    longest = {"h_max 100 s": replace(PUBLISHED, h_max=100.0)} if full else {}
    moved = runs(paper, "scheme, 190 cases", "steps", scheme, longest | {"h_max 1 s, as published": PUBLISHED})
    tables = (
        reference_table(given, damped[-1]),
        table("Six loads: direct, and the scheme of the paper", [*alone, *damped], FORMS),
        table("190 loads in one batch", [*batch, *moved], FORMS, NOT_UNIQUE),
        table("Six loads, other cells: direct, and the scheme", other_cells(), FORMS),
        table("Six loads: solvers of nonlinear programmes", others, FORMS),
    )
    every = curves_of([*alone, *batch, *moved, *damped, *others])
    title = "Locked strain: error against time, one load case"
    diagram = Diagram("rve", title, "largest error of a strain component", "processor time per case [s]", every)
    follows = [about_scheme(alone[-1], batch, damped, moved[-1]), about_others(others)]
    return Section("Locked strains", TEXT, tables, (diagram,), "\n\n".join(follows))


NOT_UNIQUE = "Uniaxial loads at alpha = 15 to 40 degrees leave the strain free: every admissible strain is right."
TEXT = f"""4-in-1, r1 = 5 mm, r2 = 0.5 mm; loads by (alpha, beta). The error is the largest component of the difference
of E from the reference, over the solved cases: those that converge, within {FOUND} of the reference (of SLSQP only the
error counts).

* **direct**: our interior-point method over the complementarity mu = force times gap at which it stops.
* **scheme**: the paper's damped motion to R < 1e-9, over time step, damping and contact stiffness k. Its error is of
  order 1/k; two stiffnesses extrapolate to rigid contact.
* **SLSQP**: maximises S:E with all gaps >= 0, with exact first derivatives and the load S of the
  answer, from the slack pose, or from the answer moved by up to 0.02 in each coordinate."""


def about_scheme(alone: Row, batch: Sequence[Row], damped: Sequence[Row], published: Row) -> str:
    """What follows for the direct solver and the paper's scheme, in numbers of this run."""
    fine, rigid = batch[-1], damped[-1]
    return (
        f"The direct solver is the default: {alone['solved']} and {fine['solved']} loads, error {decade(fine[ERROR])}, "
        f"{fine['ms per case']:.1f} ms per case in a batch and {alone['ms per case']:.0f} ms alone. The scheme takes "
        f"{published['_s'] / fine['_s']:.0f} times as long for the 190 loads ({published['solved']} solved); its error "
        f"of {decade(published[ERROR])} comes from its contact stiffness. Extrapolated to rigid contact the error is "
        f"{decade(rigid[ERROR], 1e-9)} at {rigid['_s'] / alone['_s']:.0f} times the time of the direct solver alone."
    )


def about_others(others: Sequence[Row]) -> str:
    """What follows for SLSQP."""
    most = {row["method"]: row["solved"] for row in sorted(others, key=lambda row: row["_share"])}
    counts = ", ".join(f"{solved} ({name})" for name, solved in most.items())
    return f"{counts}: steps of a generic solver pass through the wire into inadmissible states."
