"""The paper's time stepping at extreme stiffness, mass, damping, time steps and loads."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.pages.measuring import at_most
from benchmarks.pages.model import Column, Section, Table, Value
from benchmarks.stability.words import outcomes
from rve.compliance import soften
from rve.equilibrium import solve_equilibrium
from rve.load import cauchy_line_load
from rve.stewart_trinkle import ROUND_OFF, Settled, StewartTrinkleOptions, solve
from rve.system import Equations
from rve.weave import FOUR_IN_ONE

ALPHA = np.array([0.0, 20.0, 10.0, 45.0, 45.0, 0.0])
BETA = np.array([45.0, 30.0, 10.0, 0.0, 90.0, 0.0])
WIRE = 0.1
PAPER = StewartTrinkleOptions()
KNOWN = ("converged", "step-limit", "time-step")

COLUMNS = (
    Column("what is varied"),
    Column("value", ".1e"),
    Column("outcome of 6 loads"),
    Column("steps, median", ".0f"),
    Column("largest R", ".0e"),
    Column("deepest overlap, mm", ".1e"),
    Column("energy never rises"),
    Column("links intact"),
)
STEPS = (
    "`step-limit`: not at rest after {most} accepted steps, and the row says how far R is; `time-step`: no step above "
    "h_min lets the energy fall."
)


def ladders() -> list[tuple[str, float, dict[str, float]]]:
    """Name, value and options of every run: k over ten decades, damping and mass over six, and so on."""
    rows: list[tuple[str, float, dict[str, float]]] = []
    rows += [("contact stiffness k, kg/s2", 10.0**e, {"stiffness": 10.0**e}) for e in range(2, 13, 2)]
    for e in (-3, -2, -1, 1, 2, 3):
        both = {"damping": 10.0**e, "rotational_damping": 100.0 * 10.0**e}
        rows.append(("both dampings, times", 10.0**e, both))
    rows += [("mass, times", 10.0**e, {"density": PAPER.density * 10.0**e}) for e in (-3, -2, -1, 1, 2, 3)]
    rows += [("h_max, s", 10.0**e, {"h_max": 10.0**e}) for e in range(-4, 4)]
    rows += [("line load s_hat, N/m, at k = 1e6", 2.5 * 10.0**e, {"load": 2.5 * 10.0**e}) for e in range(-4, 5, 2)]
    scaled = [(2.5 * 10.0**e, 10.0**e) for e in range(-4, 5, 2)]
    rows += [
        (
            "s_hat with k, both dampings and mass in proportion",
            size,
            {
                "load": size,
                "stiffness": PAPER.stiffness * f,
                "damping": PAPER.damping * f,
                "rotational_damping": PAPER.rotational_damping * f,
                "density": PAPER.density * f,
            },
        )
        for size, f in scaled
    ]
    return rows


def run(changes: dict[str, float], steps: int) -> Settled:
    """The six loads with these options changed."""
    options = replace(PAPER, max_steps=steps, **changes)  # type: ignore[arg-type]
    s = cauchy_line_load(ALPHA, BETA)
    return solve(s, Equations.of(FOUR_IN_ONE, WIRE), options, history=True)


def row(name: str, value: float, found: Settled) -> tuple[Value, ...]:
    """One line of the table."""
    assert found.history is not None
    deepest = float(found.contacts.min_gap.min())
    return (
        name,
        value,
        outcomes(found.status),
        float(np.median(found.steps)),
        float(found.R.max()),
        5.0 * max(0.0, -deepest) if np.isfinite(deepest) else 0.0,
        "yes" if found.history.rise.max() <= ROUND_OFF else "NO",
        "yes" if found.contacts.links_intact.all() else "NO",
    )


def soft_rows(full: bool) -> list[tuple[Value, ...]]:
    """The soft Newton method of `rve table --compliance` over the ratio k/s_hat."""
    equations = Equations.of(FOUR_IN_ONE, WIRE)
    s = cauchy_line_load(ALPHA, BETA)
    rigid = solve_equilibrium(s, equations)
    out: list[tuple[Value, ...]] = []
    for e in range(1, 13) if full else range(2, 13, 2):
        with np.errstate(all="ignore"):  # at 10 the rings overlap beyond any meaning; the status says so
            soft = soften(rigid, s, equations, 10.0**e, (2.2, 2.53))
        good = soft.status == "converged"
        left = float(soft.R[good].max()) if good.any() else None
        deepest = float(-5.0 * soft.contacts.min_gap[good].min()) if good.any() else None
        out.append((10.0**e, outcomes(soft.status), "-" if left is None else at_most(max(left, 1e-11)), deepest))
    return out


def measure(full: bool) -> Section:
    """Every ladder of the paper's scheme, and the soft equilibrium by Newton's method."""
    most = 4000 if full else 500
    found: list[tuple[str, float, Settled]] = [(name, value, run(kw, most)) for name, value, kw in ladders()]
    rows = [row("the paper's", 1.0, run({}, most))] + [row(*one) for one in found]
    columns = ("k/s_hat", ".0e"), ("outcome of 6 loads", ""), ("largest R", ""), ("deepest overlap, mm", ".1e")
    soft = Table("Soft contact by Newton's method", tuple(Column(*c) for c in columns), tuple(soft_rows(full)))
    return Section(
        "stepping",
        "Time stepping: stiffness, damping, mass, step, load",
        "The paper's damped motion from rest under six loads, (alpha, beta) = "
        + ", ".join(f"({a:g}, {b:g})" for a, b in zip(ALPHA, BETA, strict=True))
        + " degrees at r1/r2 = 10; one thing is varied at a time. "
        + STEPS.format(most=most),
        (Table("Stewart and Trinkle's scheme", COLUMNS, tuple(rows)), soft),
        conclusion=conclusion(rows, found, soft),
    )


def conclusion(rows: list[tuple[Value, ...]], found: list[tuple[str, float, Settled]], soft: Table) -> str:
    """What the numbers say."""
    status = np.concatenate([one.status for _, _, one in found])
    if not np.isin(status, KNOWN).all():
        raise ValueError(f"a status without a name: {np.unique(status)}")
    energy = sum(r[6] == "yes" for r in rows)
    links = sum(r[7] == "yes" for r in rows)
    slow = [f"{name} {value:g}" for name, value, one in found if not (one.status == "converged").any()]
    scaled = {outcomes(one.status) for name, _, one in found if name.startswith("s_hat with")}
    steps = {tuple(one.steps.tolist()) for name, _, one in found if name.startswith("s_hat with")}
    same = "give the same outcome and the same steps" if len(scaled) == len(steps) == 1 else "DIFFER"
    good: Any = [r for r in soft.rows if r[1] == "6 converged"]
    return (
        f"Of {len(status)} motions {int((status == 'converged').sum())} come to rest; the others are named. The "
        "energy never "
        f"rises in {energy} and links stay intact in {links} of {len(rows)} runs. Eight decades of s_hat with "
        "everything in "
        f"proportion {same}: the scheme works in units of s_hat. Nothing comes to rest within the step limit at: "
        f"{'; '.join(slow)}. There the direct solver, or Newton's method on soft contact (all six loads at "
        f"{len(good)} of {len(soft.rows)} stiffnesses), is the way."
    )
