"""Cells from the jamming limit to thin wire, and starts from nearly closed, nearly open and random poses."""

from __future__ import annotations

import numpy as np

from benchmarks.pages.measuring import at_most
from benchmarks.pages.model import Column, Section, Table, Value
from benchmarks.stability.words import GAP_NOISE, R_NOISE, outcomes, refusal
from rve.cell import Pose, find_contacts, moved, start_pose
from rve.equilibrium import DirectOptions, Equilibrium, solve_equilibrium
from rve.load import cauchy_line_load
from rve.ranges import grid
from rve.sweep import Cell, solve_table
from rve.system import Equations
from rve.table import StrainTable
from rve.weave import FOUR_IN_ONE, SIX_IN_ONE, Weave

R1 = 5.0
RATIOS = {
    FOUR_IN_ONE.name: (3.98093, 3.9811, 3.99, 4.0, 4.5, 5.0, 7.0, 10.0, 20.0, 30.0, 50.0, 70.0, 100.0),
    SIX_IN_ONE.name: (5.9432, 5.9433, 5.95, 6.0, 7.0, 10.0, 20.0, 30.0, 50.0, 100.0),
}
ALPHA, BETA = np.array([0.0, 15.0, 30.0, 45.0]), np.array([0.0, 5.0, 20.0, 45.0, 70.0, 85.0, 90.0])
WIRE = 0.1
# Loads whose strain is unique at r1/r2 = 10, one of them the kink (0, 0).
UNIQUE = np.array([[0.0, 0.0], [0.0, 45.0], [10.0, 10.0], [20.0, 30.0], [45.0, 0.0], [45.0, 90.0], [30.0, 70.0]])
TURN = np.radians(8.0)


def least_work(table: StrainTable) -> float:
    """Least S_i:(E_i - E_j) over all pairs of converged rows: not below round-off where the rows are normal."""
    S, E = table.S[table.converged], table.E[table.converged]
    return float(np.einsum("ik,ijk->ij", S * [1, 2, 1], E[:, None] - E[None]).min())


def ratio_row(weave: Weave, ratio: float) -> tuple[Value, ...]:
    """28 loads at one ratio of radii."""
    if ratio <= weave.jamming_ratio:
        return (weave.name, ratio, refusal(lambda: Cell(R1, R1 / ratio, weave)), None, "-", "-", "-")
    table = solve_table(*grid(ALPHA, BETA), Cell(R1, R1 / ratio, weave))
    worst = float(np.nanmin(table.min_gap_mm))
    work = least_work(table)
    return (
        weave.name,
        ratio,
        outcomes(table.status),
        float(np.median(table.iterations)),
        at_most(max(R_NOISE, float(np.nanmax(table.R)))),
        at_most(max(GAP_NOISE, -worst)),
        "yes" if work > -1e-8 else f"no, {work:.0e}",
    )


def admissible(pose: Pose, wire: float) -> np.ndarray:
    """Which poses keep all links and every gap positive, (n,)."""
    contacts = find_contacts(pose, FOUR_IN_ONE, wire, 0.6)
    return contacts.links_intact & (contacts.min_gap > 0.0)


def squeezed(sense: float, gap: float, wire: float) -> Pose:
    """The slack cell closed (sense -1) or opened (+1) evenly in its plane until its least gap is `gap` r1."""
    low, high = 0.0, 1.0
    slack = start_pose(FOUR_IN_ONE, 1)
    for _ in range(80):
        middle = 0.5 * (low + high)
        f = 1.0 + sense * middle
        pose = Pose(slack.lattice * [f, f, 1.0], slack.centres * f, slack.normals)
        contacts = find_contacts(pose, FOUR_IN_ONE, wire, 0.6)
        is_in = bool(contacts.links_intact[0]) and contacts.min_gap[0] > gap
        low, high = (middle, high) if is_in else (low, middle)
    f = 1.0 + sense * low
    return Pose(slack.lattice * [f, f, 1.0], slack.centres * f, slack.normals)


def random_starts(count: int, seed: int, wire: float) -> Pose:
    """Admissible poses, sides and centres moved by up to 0.3 r1 and rings tilted by up to 0.3."""
    rng = np.random.default_rng(seed)
    parts: list[Pose] = []
    while sum(len(part.lattice) for part in parts) < count:
        many = start_pose(FOUR_IN_ONE, 2 * count)
        shift = 0.3 * rng.uniform(-1.0, 1.0, (2 * count, 4 * FOUR_IN_ONE.classes + 1))
        pose = moved(many, shift)
        parts.append(pose.take(admissible(pose, wire)))
    columns = [np.concatenate([getattr(p, name) for p in parts])[:count] for name in ("lattice", "centres", "normals")]
    return Pose(*columns)


def start_row(name: str, start: Pose, loads: np.ndarray) -> tuple[Value, ...]:
    """Starts, as many for each load in turn: how far the locked lattices of one load lie apart, in r1."""
    n = len(start.lattice) // len(loads)
    s = np.repeat(cauchy_line_load(*loads.T), n, axis=0)
    equations = Equations.of(FOUR_IN_ONE, WIRE)
    found = solve_equilibrium(s, equations, DirectOptions(), start)
    truth = solve_equilibrium(cauchy_line_load(*loads.T), equations)
    good = found.status == "converged"
    apart = np.abs(found.pose.lattice - np.repeat(truth.pose.lattice, n, axis=0)).max(axis=1)
    gap = find_contacts(start, FOUR_IN_ONE, WIRE, 0.6).min_gap
    return (
        name,
        at_most(gap.min()),
        len(s),
        outcomes(found.status),
        _attempts(found),
        float(np.median(found.iterations)),
        at_most(max(1e-10, float(apart[good].max()))),
        int((apart[good] > 1e-6).sum()),
    )


def _attempts(found: Equilibrium) -> int:
    return int((found.attempts > 1).sum())


def measure(full: bool) -> Section:
    """Ratios of radii, and starts."""
    ratios = [ratio_row(weave, ratio) for weave in (FOUR_IN_ONE, SIX_IN_ONE) for ratio in RATIOS[weave.name]]
    starts = [
        start_row(
            f"{name}, least gap {gap:.0e} r1", squeezed(sense, gap, WIRE).take(np.zeros(len(UNIQUE), int)), UNIQUE
        )
        for name, sense in (("nearly closed", -1.0), ("nearly open", 1.0))
        for gap in (1e-2, 1e-4, 1e-6, 1e-9, 1e-12)
    ]
    count = (1500 if full else 150) * len(UNIQUE)
    starts.append(start_row(f"{count:,} random poses", random_starts(count, 7, WIRE), UNIQUE))
    ratio_columns = (
        Column("weave"),
        Column("r1/r2", ".6g"),
        Column("outcome of 28 loads"),
        Column("iterations, median", ".0f"),
        Column("R"),
        Column("overlap, mm"),
        Column("rows normal"),
    )
    start_columns = (
        Column("start"),
        Column("least gap, r1"),
        Column("solves"),
        Column("outcome"),
        Column("more than one attempt"),
        Column("iterations, median", ".0f"),
        Column("lattices apart, r1"),
        Column("apart by more than 1e-6"),
    )
    tables = (
        Table("Radii from the jamming limit to thin wire", ratio_columns, tuple(ratios)),
        Table("Starts, r1/r2 = 10", start_columns, tuple(starts)),
    )
    return Section(
        "cells",
        "Cells: jamming, thin wire, odd starts",
        f"alpha = {', '.join(f'{a:g}' for a in ALPHA)} and beta = {', '.join(f'{b:g}' for b in BETA)} degrees, r1 "
        "= 5 mm. "
        "`rows normal`: S_i:(E_i - E_j) >= -1e-8 for all rows i, j. The lower table starts from poses that are "
        "all but "
        f"jammed, and from random ones, under {len(UNIQUE)} loads whose strain is unique; `lattices apart` "
        "compares with "
        "the default start, floor 1e-10.",
        tables,
        conclusion=conclusion(ratios, starts),
    )


def conclusion(ratios: list[tuple[Value, ...]], starts: list[tuple[Value, ...]]) -> str:
    """What the numbers say."""
    solved = [row for row in ratios if row[3] is not None]
    all_good = [row for row in solved if row[2] == "28 converged"]
    thin = [f"{row[0]} at {row[1]:g}" for row in solved if str(row[6]).startswith("no")]
    tried = sum(int(row[2] or 0) for row in starts)
    apart = sum(int(row[7] or 0) for row in starts)
    stalled = sum(row[3] != f"{row[2]} converged" for row in starts)
    return (
        f"All 28 loads converge at {len(all_good)} of {len(solved)} ratios, and wire that jams is refused in a "
        "sentence. Rows "
        f"contradict each other (two locked states coexist) for {', '.join(thin) or 'no ratio'}. Of {tried} "
        "solves from odd "
        f"starts {apart} end in another strain, and {stalled} of {len(starts)} rows have solves that do not converge."
    )
