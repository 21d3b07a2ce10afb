"""Cells from the jamming limit to thin wire, and starts from nearly closed, nearly open and random poses."""

import numpy as np

from benchmarks.problems import normality
from benchmarks.report.measure import Row, count_of, outcomes, refusal
from benchmarks.report.records import Section, table
from rve.directions import product
from rve.equilibrium.interior_point import DirectOptions, solve_equilibrium
from rve.equilibrium.system import Equations
from rve.geometry.cell import Cell
from rve.geometry.contacts import find_contacts
from rve.geometry.kinematics import cauchy_line_load
from rve.geometry.pose import Pose, moved, start_pose
from rve.geometry.weave import FOUR_IN_ONE, SIX_IN_ONE, Weave
from rve.solve import solve_table

R1 = 5.0
RATIOS = {
    FOUR_IN_ONE.name: (3.98093, 3.9811, 3.99, 4.0, 4.5, 5.0, 7.0, 10.0, 20.0, 30.0, 50.0, 70.0, 100.0),
    SIX_IN_ONE.name: (5.9432, 5.9433, 5.95, 6.0, 7.0, 10.0, 20.0, 30.0, 50.0, 100.0),
}
ALPHA, BETA = np.array([0.0, 15.0, 30.0, 45.0]), np.array([0.0, 5.0, 20.0, 45.0, 70.0, 85.0, 90.0])
WIRE = 0.1
# Loads whose strain is unique at r1/r2 = 10, one of them the kink (0, 0).
UNIQUE = np.array([[0.0, 0.0], [0.0, 45.0], [10.0, 10.0], [20.0, 30.0], [45.0, 0.0], [45.0, 90.0], [30.0, 70.0]])
OUTCOME, APART = "outcome of 28 loads", "apart by more than 1e-6"
NOISE = {"R": "at_most 1e-11", "overlap, mm": "at_most 1e-12", "iterations, median": ".0f"}
"""Weighted residual, and overlap in mm, below which digits are round-off."""


def ratio_row(weave: Weave, ratio: float) -> Row:
    """28 loads at one ratio of radii, or the sentence with which the cell is refused."""
    row: Row = {"weave": weave.name, "r1/r2": ratio}
    if ratio <= weave.jamming_ratio:
        return row | {OUTCOME: refusal(lambda: Cell(R1, R1 / ratio, weave))}
    table = solve_table(Cell(R1, R1 / ratio, weave), product(ALPHA, BETA))
    work = normality(table).min()
    return row | {
        OUTCOME: outcomes(table.status),
        "iterations, median": float(np.median(table.iterations)),
        "R": np.nanmax(table.R),
        "overlap, mm": max(0.0, -np.nanmin(table.min_gap_mm)),
        "rows normal": "yes" if work > -1e-8 else f"no, {work:.0e}",
    }


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


def start_row(name: str, start: Pose, loads: np.ndarray) -> Row:
    """Starts, as many for each load in turn, and the differences of their locked lattices from the default's, in r1."""
    n = len(start.lattice) // len(loads)
    s, equations = cauchy_line_load(*loads.T), Equations.of(FOUR_IN_ONE, WIRE)
    found = solve_equilibrium(np.repeat(s, n, axis=0), equations, DirectOptions(), start)
    truth = np.repeat(solve_equilibrium(s, equations).pose.lattice, n, axis=0)
    apart = np.abs(found.pose.lattice - truth).max(axis=1)[found.status == "converged"]
    return {
        "start": name,
        "least gap, r1": find_contacts(start, FOUR_IN_ONE, WIRE, 0.6).min_gap.min(),
        "solves": len(start.lattice),
        "outcome": outcomes(found.status),
        "more than one attempt": (found.attempts > 1).sum(),
        "iterations, median": float(np.median(found.iterations)),
        "difference of lattices, r1": apart.max(),
        APART: (apart > 1e-6).sum(),
        "_good": len(apart) == len(start.lattice),
    }


def measure(full: bool) -> Section:
    """Ratios of radii, and starts."""
    ratios = [ratio_row(weave, ratio) for weave in (FOUR_IN_ONE, SIX_IN_ONE) for ratio in RATIOS[weave.name]]
    each = np.zeros(len(UNIQUE), int)
    starts = [
        start_row(f"{name}, least gap {gap:.0e} r1", squeezed(sense, gap, WIRE).take(each), UNIQUE)
        for name, sense in (("nearly closed", -1.0), ("nearly open", 1.0))
        for gap in (1e-2, 1e-4, 1e-6, 1e-9, 1e-12)
    ]
    count = (1500 if full else 150) * len(UNIQUE)
    starts.append(start_row(f"{count:,} random poses", random_starts(count, 7, WIRE), UNIQUE))
    start_forms = {
        "least gap, r1": "at_most",
        "iterations, median": ".0f",
        "difference of lattices, r1": "at_most 1e-10",
    }
    tables = (
        table("Radii from the jamming limit to thin wire", ratios, NOISE | {"r1/r2": ".6g"}),
        table("Starts, r1/r2 = 10", starts, start_forms),
    )
    text = (
        f"alpha = {', '.join(f'{a:g}' for a in ALPHA)} and beta = {', '.join(f'{b:g}' for b in BETA)} degrees, r1 = 5 "
        "mm. `rows normal`: S_i:(E_i - E_j) >= -1e-8 for all rows i, j. The second table starts from nearly jammed "
        f"and from random poses, under {len(UNIQUE)} loads whose strain is unique, and compares the lattices with "
        "those from the default start; the floor is 1e-10."
    )
    return Section("Cells: jamming, thin wire, unusual starts", text, tables, (), conclusion(ratios, starts))


def conclusion(ratios: list[Row], starts: list[Row]) -> str:
    """What the numbers say."""
    solved = [row for row in ratios if "R" in row]
    thin = [f"{row['weave']} at {row['r1/r2']:g}" for row in solved if row["rows normal"] != "yes"]
    return (
        f"All 28 loads converge at {count_of([row[OUTCOME] == '28 converged' for row in solved])} ratios, and jamming "
        "wire is refused in a sentence. Rows contradict each other (two locked states coexist) for "
        f"{', '.join(thin) or 'no ratio'}. Of {sum(row['solves'] for row in starts)} solves from unusual starts "
        f"{sum(row[APART] for row in starts)} end in another strain, and "
        f"{count_of([not row['_good'] for row in starts])} rows have solves that do not converge."
    )
