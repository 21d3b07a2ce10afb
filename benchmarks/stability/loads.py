"""Load directions at random and at the rim: what converges, and what the others are called."""

from __future__ import annotations

from functools import partial

import numpy as np

from benchmarks.pages.measuring import at_most
from benchmarks.pages.model import Column, Section, Table, Value
from benchmarks.stability.words import GAP_NOISE, R_NOISE, outcomes, refusal
from rve.errors import SENTENCES
from rve.sweep import Cell, solve_table
from rve.table import StrainTable

R1 = 5.0
LEAST, MOST = 4.0, 100.0
GROUPS = 10
NAMED = tuple(SENTENCES)

COLUMNS = (
    Column("r1/r2"),
    Column("loads"),
    Column("outcome"),
    Column("strain free"),
    Column("iterations, median", ".0f"),
    Column("most"),
    Column("R"),
    Column("overlap, mm"),
    Column("contradicting rows"),
    Column("s", ".1f", timed=True),
)


def contradicting(table: StrainTable) -> int:
    """Rows with S_i:(E_i - E_j) < -1e-8 for some row j of the same rings."""
    S, E = table.S[table.converged], table.E[table.converged]
    return int((np.einsum("ik,ijk->ij", S * [1, 2, 1], E[:, None] - E[None]).min(axis=1) < -1e-8).sum())


def row(name: str, tables: list[StrainTable]) -> tuple[Value, ...]:
    """One line for the loads of several tables."""
    status = np.concatenate([t.status for t in tables])
    iterations = np.concatenate([t.iterations for t in tables])
    gap = min(float(np.nanmin(t.min_gap_mm)) for t in tables)
    return (
        name,
        len(status),
        outcomes(status),
        int(sum((~t.unique & t.converged).sum() for t in tables)),
        float(np.median(iterations)),
        int(iterations.max()),
        at_most(max([R_NOISE, *(float(np.nanmax(t.R)) for t in tables)])),
        at_most(max(GAP_NOISE, -gap)),
        sum(contradicting(t) for t in tables),
        sum(float(t.provenance["wall_s"]) for t in tables),
    )


def random_tables(count: int, each: int) -> list[tuple[float, StrainTable]]:
    """`count` random loads, `each` of them for one random ratio, log-uniform; sorted by ratio."""
    rng = np.random.default_rng(20261120)
    ratios = np.sort(np.exp(rng.uniform(np.log(LEAST), np.log(MOST), count // each)))
    out = []
    for ratio in ratios:
        alpha, beta = rng.uniform(-180.0, 180.0, each), rng.uniform(0.0, 90.0, each)
        out.append((float(ratio), solve_table(alpha, beta, Cell(R1, R1 / ratio))))
    return out


def rim_loads(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Directions (alpha, beta) of one kind of rim."""
    circle = np.arange(-180.0, 180.0, 7.5)
    small = 10.0 ** np.linspace(-6.0, 0.0, len(circle))
    return {
        "uniaxial, beta = 0": (circle, np.zeros_like(circle)),
        "uniaxial, beta = 90": (circle, np.full_like(circle, 90.0)),
        "nearly uniaxial, beta = 1e-6 to 1": (circle, small),
        "nearly uniaxial, 90 - beta = 1e-6 to 1": (circle, 90.0 - small),
        "equibiaxial, beta = 45": (circle, np.full_like(circle, 45.0)),
        "nearly equibiaxial, beta - 45 = 1e-6 to 1": (circle, 45.0 + small),
    }[kind]


RIMS = (
    "uniaxial, beta = 0",
    "uniaxial, beta = 90",
    "nearly uniaxial, beta = 1e-6 to 1",
    "nearly uniaxial, 90 - beta = 1e-6 to 1",
    "equibiaxial, beta = 45",
    "nearly equibiaxial, beta - 45 = 1e-6 to 1",
)


def outside_rows() -> list[tuple[Value, ...]]:
    """Loads that push, and angles that are none."""
    rows: list[tuple[Value, ...]] = []
    for beta in (-1e-9, -0.01, -1.0, 90.0 + 1e-9, 90.01, 91.0, 180.0, 269.0):
        table = solve_table([20.0], [beta])
        status = str(table.status[0])
        rows.append((f"{beta:.12g}", status, SENTENCES[status], "yes" if np.isfinite(table.E).any() else "no"))
    for text, value in (("nan", np.nan), ("inf", np.inf)):
        said = refusal(partial(solve_table, [20.0], [value]))
        rows.append((text, "refused", said, "no"))
    return rows


def measure(full: bool) -> Section:
    """Random loads, the rim of the tensile cone, and what lies outside."""
    found = random_tables(40_000 if full else 10_000, 250)
    size = len(found) // GROUPS
    rows = []
    for first in range(0, len(found), size):
        part = found[first : first + size]
        rows.append(row(f"{part[0][0]:.1f} to {part[-1][0]:.1f}", [table for _, table in part]))
    rims = []
    for kind in RIMS:
        for ratio in (5.0, 10.0, 20.0, 50.0):
            rims.append((kind, *row(f"{ratio:g}", [solve_table(*rim_loads(kind), Cell(R1, R1 / ratio))])))
    outside = tuple(outside_rows())
    names = (Column("beta, degrees"), Column("status"), Column("what is said"), Column("any number given"))
    status = np.concatenate([table.status for _, table in found])
    return Section(
        "loads",
        "Loads: random, at the rim, outside",
        f"{len(status):,} loads with alpha uniform over the full circle, beta uniform in (0, 90) degrees and r1/r2 "
        f"log-uniform in ({LEAST:g}, {MOST:g}), seeded. Contradicting rows: S_i:(E_i - E_j) < -1e-8 for some row "
        "j of the "
        "same rings. `strain free`: rows whose load leaves the strain free; they hold the limit from inside the cone.",
        (
            Table("Random loads", COLUMNS, tuple(rows)),
            Table(
                "The rim of the tensile cone, alpha over the full circle", (Column("loads of"), *COLUMNS), tuple(rims)
            ),
            Table("Just outside: loads that push (alpha = 20, r1/r2 = 10)", names, outside),
        ),
        conclusion=conclusion(status, rims, outside),
    )


def conclusion(status: np.ndarray, rims: list[tuple[Value, ...]], outside: tuple[tuple[Value, ...], ...]) -> str:
    """What the numbers say; ValueError for a status without a name."""
    if not np.isin(status, NAMED).all():
        raise ValueError(f"a status without a name: {np.unique(status)}")
    good = int((status == "converged").sum())
    rim = sum(int(r[2] or 0) for r in rims)
    rest = [f"{r[0]} at {r[1]}: {r[3]}" for r in rims if r[3] != f"{r[2]} converged"]
    given = sum(r[3] == "yes" for r in outside)
    return (
        f"{good:,} of {len(status):,} random loads converge, {100.0 * good / len(status):.2f} %; the others: "
        f"{outcomes(status[status != 'converged']) or 'none'}. Of {rim:,} loads at the rim all converge but for: "
        f"{'; '.join(rest) or 'none'}. Loads that push get a name, a sentence and {given} numbers."
    )
