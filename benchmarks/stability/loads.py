"""Random load directions, and directions at the boundary of the tensile cone and outside: how their solves end."""

from functools import partial

import numpy as np

from benchmarks.problems import normality
from benchmarks.report.measure import Row, outcomes, refusal
from benchmarks.report.records import Section, table
from benchmarks.stability.cells import NOISE
from rve.common.errors import SENTENCES
from rve.geometry.cell import Cell
from rve.solve import solve_table
from rve.table import StrainTable

R1 = 5.0
LEAST, MOST = 4.0, 100.0
GROUPS = 10
NAMED = tuple(SENTENCES)


def row(name: str, tables: list[StrainTable]) -> Row:
    """One line for the loads of several tables; rows contradict each other where S_i:(E_i - E_j) < -1e-8."""
    status = np.concatenate([t.status for t in tables])
    iterations = np.concatenate([t.iterations for t in tables])
    return {
        "r1/r2": name,
        "loads": len(status),
        "outcome": outcomes(status),
        "strain free": sum((~t.unique & t.converged).sum() for t in tables),
        "iterations, median": float(np.median(iterations)),
        "most": iterations.max(),
        "R": max(np.nanmax(t.R) for t in tables),
        "overlap, mm": max(0.0, *(-np.nanmin(t.min_gap_mm) for t in tables)),
        "contradicting rows": sum((normality(t) < -1e-8).sum() for t in tables),
        "s": sum(t.provenance["wall_s"] for t in tables),
    }


def random_tables(count: int, each: int) -> list[tuple[float, StrainTable]]:
    """`count` random loads, `each` of them for one random ratio, log-uniform; sorted by ratio."""
    rng = np.random.default_rng(20261120)
    ratios = np.sort(np.exp(rng.uniform(np.log(LEAST), np.log(MOST), count // each)))
    out = []
    for ratio in ratios:
        alpha, beta = rng.uniform(-180.0, 180.0, each), rng.uniform(0.0, 90.0, each)
        out.append((float(ratio), solve_table(Cell(R1, R1 / ratio), (alpha, beta))))
    return out


CIRCLE = np.arange(-180.0, 180.0, 7.5)
SMALL = 10.0 ** np.linspace(-6.0, 0.0, len(CIRCLE))
RIMS = {
    "uniaxial, beta = 0": 0.0 * CIRCLE,
    "uniaxial, beta = 90": 0.0 * CIRCLE + 90.0,
    "nearly uniaxial, beta = 1e-6 to 1": SMALL,
    "nearly uniaxial, 90 - beta = 1e-6 to 1": 90.0 - SMALL,
    "equibiaxial, beta = 45": 0.0 * CIRCLE + 45.0,
    "nearly equibiaxial, beta - 45 = 1e-6 to 1": 45.0 + SMALL,
}
"""beta for alpha over the full circle, at and near the boundary of the tensile cone."""


def outside_rows() -> list[Row]:
    """Compressive loads, and angles that are not numbers."""
    rows = []
    for beta in (-1e-9, -0.01, -1.0, 90.0 + 1e-9, 90.01, 91.0, 180.0, 269.0):
        table = solve_table(Cell(), ([20.0], [beta]))
        status = str(table.status[0])
        given = np.isfinite(table.E).any()
        rows.append(
            {"beta, degrees": f"{beta:.12g}", "status": status, "message": SENTENCES[status], "any number given": given}
        )
    for value in (np.nan, np.inf):
        message = refusal(partial(solve_table, Cell(), ([20.0], [value])))
        rows.append({"beta, degrees": str(value), "status": "refused", "message": message, "any number given": False})
    return rows


def measure(full: bool) -> Section:
    """Random loads, the boundary of the tensile cone, and loads outside it."""
    found = random_tables(40_000 if full else 10_000, 250)
    size = len(found) // GROUPS
    parts = [found[first : first + size] for first in range(0, len(found), size)]
    rows = [row(f"{part[0][0]:.1f} to {part[-1][0]:.1f}", [table for _, table in part]) for part in parts]
    rims = [
        {"loads of": kind} | row(f"{ratio:g}", [solve_table(Cell(R1, R1 / ratio), (CIRCLE, beta))])
        for kind, beta in RIMS.items()
        for ratio in (5.0, 10.0, 20.0, 50.0)
    ]
    outside = outside_rows()
    status = np.concatenate([table.status for _, table in found])
    text = (
        f"{len(status):,} loads with alpha uniform over the full circle, beta uniform in (0, 90) degrees and r1/r2 "
        f"log-uniform in ({LEAST:g}, {MOST:g}), seeded. Contradicting rows: S_i:(E_i - E_j) < -1e-8 for some row j of "
        "the same rings. `strain free`: rows whose load does not determine the strain; they hold the limit from "
        "inside the cone."
    )
    forms = NOISE | {"s": ".1f timed"}
    tables = (
        table("Random loads", rows, forms),
        table("The boundary of the tensile cone, alpha over the full circle", rims, forms),
        table("Just outside: compressive loads (alpha = 20, r1/r2 = 10)", outside),
    )
    return Section("Loads: random, at the boundary, outside", text, tables, (), conclusion(status, rims, outside))


def conclusion(status: np.ndarray, rims: list[Row], outside: list[Row]) -> str:
    """What the numbers say; ValueError for a status without a name."""
    if not np.isin(status, NAMED).all():
        raise ValueError(f"a status without a name: {np.unique(status)}")
    good = int((status == "converged").sum())
    rest = [
        f"{row['loads of']} at {row['r1/r2']}: {row['outcome']}"
        for row in rims
        if row["outcome"] != f"{row['loads']} converged"
    ]
    return (
        f"{good:,} of {len(status):,} random loads converge, {100.0 * good / len(status):.2f} %; the others: "
        f"{outcomes(status[status != 'converged']) or 'none'}. Of {sum(row['loads'] for row in rims):,} loads at the "
        f"boundary all converge except: {'; '.join(rest) or 'none'}. Compressive loads get a status, a sentence and "
        f"{sum(row['any number given'] for row in outside)} numbers."
    )
