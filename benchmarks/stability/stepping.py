"""The paper's time stepping at extreme stiffness, mass, damping, time steps and loads."""

from dataclasses import replace

import numpy as np

from benchmarks.report.measure import Row, count_of, outcomes
from benchmarks.report.records import Section, table
from rve.equilibrium.compliance import soften
from rve.equilibrium.interior_point import solve_equilibrium
from rve.equilibrium.system import Equations
from rve.geometry.kinematics import cauchy_line_load
from rve.geometry.weave import FOUR_IN_ONE
from rve.paper.stewart_trinkle import ROUND_OFF, Settled, StewartTrinkleOptions, solve

ALPHA = np.array([0.0, 20.0, 10.0, 45.0, 45.0, 0.0])
BETA = np.array([45.0, 30.0, 10.0, 0.0, 90.0, 0.0])
WIRE = 0.1
PAPER = StewartTrinkleOptions()
KNOWN = ("converged", "step-limit", "time-step")

OUTCOME, DEEPEST = "outcome of 6 loads", "deepest overlap, mm"
TOGETHER = "s_hat with k, both dampings and mass in proportion"


def ladders() -> list[tuple[str, float, dict[str, float]]]:
    """Name, value and options of every run: k over ten decades, damping and mass over six, and so on."""
    rows = [("contact stiffness k, kg/s2", 10.0**e, {"stiffness": 10.0**e}) for e in range(2, 13, 2)]
    sixfold = [10.0**e for e in (-3, -2, -1, 1, 2, 3)]
    rows += [("both dampings, times", f, {"damping": f, "rotational_damping": 100.0 * f}) for f in sixfold]
    rows += [("mass, times", f, {"density": PAPER.density * f}) for f in sixfold]
    rows += [("h_max, s", 10.0**e, {"h_max": 10.0**e}) for e in range(-4, 4)]
    factors = [10.0**e for e in range(-4, 5, 2)]
    rows += [("line load s_hat, N/m, at k = 1e6", 2.5 * f, {"load": 2.5 * f}) for f in factors]
    scaled = ("stiffness", "damping", "rotational_damping", "density")
    return rows + [
        (TOGETHER, 2.5 * f, {"load": 2.5 * f} | {name: getattr(PAPER, name) * f for name in scaled}) for f in factors
    ]


def run(changes: dict[str, float], steps: int) -> Settled:
    """The six loads with these options changed."""
    options = replace(PAPER, max_steps=steps, **changes)  # type: ignore[arg-type]
    s = cauchy_line_load(ALPHA, BETA)
    return solve(s, Equations.of(FOUR_IN_ONE, WIRE), options, history=True)


def row(name: str, value: float, found: Settled) -> Row:
    """One line of the table."""
    assert found.history is not None
    deepest = float(found.contacts.min_gap.min())
    return {
        "what is varied": name,
        "value": value,
        OUTCOME: outcomes(found.status),
        "steps, median": float(np.median(found.steps)),
        "largest R": float(found.R.max()),
        DEEPEST: 5.0 * max(0.0, -deepest) if np.isfinite(deepest) else 0.0,
        "energy never rises": found.history.rise.max() <= ROUND_OFF,
        "links intact": found.contacts.links_intact.all(),
        "_status": found.status.tolist(),
        "_steps": found.steps.tolist(),
    }


def soft_row(exponent: int) -> Row:
    """The soft Newton method of `rve table --compliance` at the ratio k/s_hat = 10^exponent."""
    equations = Equations.of(FOUR_IN_ONE, WIRE)
    s = cauchy_line_load(ALPHA, BETA)
    with np.errstate(all="ignore"):  # at 10 the overlap of the rings is meaningless, and the status says so
        soft = soften(solve_equilibrium(s, equations), s, equations, 10.0**exponent, (2.2, 2.53))
    good = soft.status == "converged"
    answer = (
        {"largest R": float(soft.R[good].max()), DEEPEST: -5.0 * soft.contacts.min_gap[good].min()}
        if good.any()
        else {}
    )
    return {"k/s_hat": 10.0**exponent, OUTCOME: outcomes(soft.status), "largest R": None, DEEPEST: None} | answer


def measure(full: bool) -> Section:
    """Every ladder of the paper's scheme, and the soft equilibrium by Newton's method."""
    most = 4000 if full else 500
    rows = [row(name, value, run(kw, most)) for name, value, kw in [("the paper's", 1.0, {}), *ladders()]]
    soft = [soft_row(exponent) for exponent in (range(1, 13) if full else range(2, 13, 2))]
    loads = ", ".join(f"({a:g}, {b:g})" for a, b in zip(ALPHA, BETA, strict=True))
    text = (
        f"The paper's damped motion from rest under six loads, (alpha, beta) = {loads} degrees at r1/r2 = 10; one "
        f"parameter is varied at a time. `step-limit`: not at rest after {most} accepted steps; the row gives R there. "
        "`time-step`: no step above h_min lowers the energy."
    )
    forms = {"value": ".1e", "steps, median": ".0f", "largest R": ".0e", DEEPEST: ".1e"}
    tables = (
        table("Stewart and Trinkle's scheme", rows, forms),
        table(
            "Soft contact by Newton's method", soft, {"k/s_hat": ".0e", "largest R": "at_most 1e-11", DEEPEST: ".1e"}
        ),
    )
    return Section("Time stepping: stiffness, damping, mass, step, load", text, tables, (), conclusion(rows, soft))


def conclusion(rows: list[Row], soft: list[Row]) -> str:
    """What the numbers say; ValueError for a status without a name."""
    status = [one for row in rows for one in row["_status"]]
    if not {*status} <= {*KNOWN}:
        raise ValueError(f"a status without a name: {np.unique(status)}")
    slow = [f"{row['what is varied']} {row['value']:g}" for row in rows if "converged" not in row["_status"]]
    ends = {str([row["_status"], row["_steps"]]) for row in rows if row["what is varied"] == TOGETHER}
    same = "give the same outcome and the same steps" if len(ends) == 1 else "DIFFER"
    return (
        f"{status.count('converged')} of {len(status)} motions come to rest; the others have a named status. The "
        f"energy never rises in {count_of([row['energy never rises'] for row in rows])} runs, and links stay intact in "
        f"{count_of([row['links intact'] for row in rows])}. Eight decades of s_hat with all parameters in proportion "
        f"{same}: the scheme works in units of s_hat. Nothing comes to rest within the step limit at: "
        f"{'; '.join(slow)}. There use the direct solver, or Newton's method on soft contact (all six loads at "
        f"{count_of([row[OUTCOME] == '6 converged' for row in soft])} stiffnesses)."
    )
