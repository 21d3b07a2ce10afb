"""What was tried at the extremes and what happened. `tests/test_benchmarks/test_extremes.py` asserts the same rows."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.frame import Section, table
from benchmarks.measure import Row, count_of, outcomes
from benchmarks.problems import normality, square
from homogenize import MembraneLaw, default_law, ring_net
from homogenize.laws import PolyhedralLaw
from macro_fem import read_scene
from macro_fem.bounds import curtain_limit
from macro_fem.curtain import make_problem, solve_problem
from macro_fem.fem import HungLaw
from macro_fem.scene.meshing.mesh import build_mesh
from rve import WEAVES, Cell, InputError, StrainTable, solve_table
from rve.directions import product
from rve.geometry import FOUR_IN_ONE, SIX_IN_ONE, Weave
from rve.simulation import ROUND_OFF, SimulationOptions, simulate

R1, WIRE = 5.0, 0.1
RATIOS = (
    (FOUR_IN_ONE, (3.98093, 3.9811, 3.99, 4.0, 5.0, 7.0, 10.0, 20.0, 50.0, 100.0)),
    (SIX_IN_ONE, (5.9433, 5.95, 6.0, 7.0, 10.0, 20.0, 50.0, 100.0)),
)
THINNER = (1.0001, 1.03)
"""r1/r2 of the other weaves, some of rings of two sizes, over that at which they jam. At 1.5 the 28 loads take 12 s in
8-in-1, 16 s in king's and more than five minutes in japanese-6-in-1; thinner wire is tested before a release."""
LOADS = product(np.array([0.0, 15.0, 30.0, 45.0]), np.array([0.0, 5.0, 20.0, 45.0, 70.0, 85.0, 90.0]))
UNIQUE = np.array([[0.0, 0.0], [0.0, 45.0], [10.0, 10.0], [20.0, 30.0], [45.0, 0.0], [45.0, 90.0], [30.0, 70.0]])
"""Loads whose strain is unique at r1/r2 = 10, one of them the kink (0, 0)."""
CIRCLE = np.arange(-180.0, 180.0, 7.5)
SMALL = 10.0 ** np.linspace(-6.0, 0.0, len(CIRCLE))
RIMS = {
    "uniaxial, beta = 0": 0.0 * CIRCLE,
    "nearly uniaxial, beta = 1e-6 to 1": SMALL,
    "nearly uniaxial, 90 - beta = 1e-6 to 1": 90.0 - SMALL,
    "nearly equibiaxial, beta - 45 = 1e-6 to 1": 45.0 + SMALL,
}
"""beta for alpha over the full circle, at and near the boundary of the tensile cone."""
OUTCOME, RISES = "outcome", "energy never rises"
STATUS, HEIGHT = "status or message", "mean height, mm"
FAR = 1e6
KINDS = ("rigid", "elastic", "plastic")
NOISE = {"R": "at_most 1e-11", "overlap, mm": "at_most 1e-12", "iterations, median": ".0f"}


def table_row(name: str, found: StrainTable) -> Row:
    """How the loads of a table end; rows contradict each other where S_i:(E_i - E_j) < -1e-8 for some j."""
    row: Row = {"loads": name, OUTCOME: outcomes(found.status)}
    row |= {"iterations, median": float(np.median(found.quality.iterations)), "R": np.nanmax(found.quality.R)}
    row["overlap, mm"] = max(0.0, -np.nanmin(found.quality.min_gap_mm))
    return row | {"contradicting rows": int((normality(found) < -1e-8).sum())}


def ratio_row(weave: Weave, ratio: float) -> Row:
    """28 loads of one cell between the jamming limit and thin wire."""
    return table_row(f"28, {weave.name} at r1/r2 = {ratio:g}", solve_table(Cell(R1, R1 / ratio, weave), LOADS))


def rim_row(name: str, ratio: float) -> Row:
    """Loads at the boundary of the tensile cone."""
    return table_row(f"48, {name}, r1/r2 = {ratio:g}", solve_table(Cell(R1, R1 / ratio), (CIRCLE, RIMS[name])))


def random_rows(groups: int, each: int = 250) -> list[Row]:
    """Random loads, `each` for one random ratio of radii, log-uniform from 4 to 100."""
    rng = np.random.default_rng(20261120)
    rows = []
    for ratio in np.sort(np.exp(rng.uniform(np.log(4.0), np.log(100.0), groups))):
        angles = rng.uniform(-180.0, 180.0, each), rng.uniform(0.0, 90.0, each)
        rows.append(table_row(f"{each} at random, r1/r2 = {ratio:.1f}", solve_table(Cell(R1, R1 / ratio), angles)))
    return rows


def ladders() -> Iterator[tuple[str, dict[str, float]]]:
    """Name and options of the paper's scheme: k over ten decades, damping and mass over six, load over eight."""
    paper = SimulationOptions()
    scaled = ("stiffness", "damping")
    for e in range(2, 13, 2):
        yield f"contact stiffness 1e{e} kg/s2", {"stiffness": 10.0**e}
    for e in (-3, -2, -1, 1, 2, 3):
        f = 10.0**e
        yield f"both dampings times 1e{e}", {"damping": f}
        yield f"mass times 1e{e}", {"density": Cell().density * f}
    for e in range(-4, 4):
        yield f"h_max 1e{e} s", {"h_max": 10.0**e}
    for friction in (0.01, 0.1, 0.3, 1.0):
        yield f"friction {friction:g}", {"friction": friction}
    for e in range(-4, 5, 2):
        load = {"load": 2.5 * 10.0**e}
        yield f"line load times 1e{e}", load
        together = {name: getattr(paper, name) * 10.0**e for name in scaled} | {"density": Cell().density * 10.0**e}
        yield f"line load, k, both dampings and mass times 1e{e}", load | together


def motion_row(name: str, changes: dict[str, float], steps: int) -> Row:
    """Six loads in the paper's scheme with these options changed."""
    cell = Cell(R1, WIRE * R1, density=changes.pop("density", Cell().density))
    found = simulate(cell, (UNIQUE[:6, 0], UNIQUE[:6, 1]), SimulationOptions(max_steps=steps, **changes))
    rest = found.rest
    row: Row = {"what is varied": name, OUTCOME: outcomes(found.status), "steps, median": float(np.median(rest.steps))}
    intact = rest.contacts.links_intact.all()
    return row | {"largest R": rest.R.max(), RISES: found.history.rise.max() <= ROUND_OFF, "links intact": intact}


def law_kinds() -> dict[str, MembraneLaw]:
    """One law of every kind."""
    rings = default_law()
    assert rings.cell is not None
    return {"polyhedral": rings, "polyhedral, turned": HungLaw.at(rings, 30.0), "net": ring_net(rings.cell)}


def law_row(name: str, law: MembraneLaw) -> Row:
    """Whether answers at vertices, on edges and far outside are finite, and E - E* = A S there."""
    rng = np.random.default_rng(9)
    far = FAR * np.concatenate([rng.normal(size=(200, 3)), np.eye(3), -np.eye(3)])
    source: Any = getattr(law, "law", law)
    corners = source.vertices[:400] if isinstance(source, PolyhedralLaw) else source.response(far).E_star
    corners = corners @ law.to_curtain.T if isinstance(law, HungLaw) else corners
    middles = 0.5 * (corners + np.roll(corners, 1, axis=0))
    E = np.concatenate([corners, corners + 1e-15, corners + 1e-9, middles, far])
    answer, cut = law.response(E), law.cut(E)
    parts = answer.energy, answer.S, answer.C, answer.E_star, cut.S, cut.h, cut.violation
    metric = np.abs(E - answer.E_star - answer.S @ law.compliance.T).max(axis=1) / (1.0 + np.abs(E).max(axis=1))
    finite = all(np.isfinite(part).all() for part in parts)
    return {"law": name, "strains": len(E), "all finite": finite, "E - E* = A S": metric.max()}


def curtain_tables() -> dict[str, dict[str, Any]]:
    """Tables of scenes of extreme shape, support and load, by name; each is a square of 100 mm unless it says so."""
    still, held = {"load": {"gravity": 0.0}}, {"support": {"kind": "top"}}
    thin, flat = ({"curtain": {"width": w, "height": h}} for w, h in ((1.0, 1000.0), (1000.0, 1.0)))
    made: dict[str, dict[str, Any]] = {
        "ribbon 1 : 1000, hanging": thin | held | {"mesh": {"cells": 1}},
        "ribbon 1000 : 1, held along its top": flat | held | {"mesh": {"cells": 400}},
        "one cell": {"mesh": {"cells": 1}},
        "gathered to 2 %": {"support": {"kind": "top", "gather": 0.02}},
        "no gravity, no load": still,
        "no gravity, drawn by supports": still | {"support": {"kind": "corners", "gather": 1.3}},
    }
    for gather in (1.5, 1.58, 1.6, 3.0):
        made[f"corners drawn apart to {gather:g}"] = {"support": {"kind": "corners", "gather": gather}}
    for force in (1e-6, 1.0, 1e6):
        made[f"a point load of {force:g} N"] = {"load": {"point": [{"at": [50.0, 0.0], "force": [0.0, -force]}]}}
    return made


def curtain_row(name: str, tables: dict[str, Any], law: MembraneLaw, kind: str) -> Row:
    """One curtain: its answer, or the sentence that says why there is none."""
    whole = square(12, {"kind": "corners", "gather": 0.9}, 100.0, solver={"kind": kind}) | tables
    row: Row = {"curtain": name, "solver": kind}
    try:
        scene = read_scene(whole)
        problem = make_problem(scene, law, build_mesh(scene, law.cell))  # of sides below a ring's, too
        limit = curtain_limit(problem) if kind == "plastic" else None
        if limit is not None and limit.is_passed:
            return row | {STATUS: f"collapsed at {limit.factor:.2g} of the loads"}
        found = solve_problem(problem)
    except InputError as error:
        return row | {STATUS: str(error)}
    if found.status != "converged":
        return row | {STATUS: f"{found.status}: {found.message}"}
    row |= {STATUS: str(found.status), "iterations": found.iterations, "unbalanced": found.residual}
    return row | {HEIGHT: found.mean_height()}


def curtain_rows() -> list[Row]:
    """All extremes by every solver, and nine decades of stiffness."""
    law = default_law()
    rows = [curtain_row(*one, law, kind) for kind in KINDS for one in curtain_tables().items()]
    for size in 10.0 ** np.arange(10):
        stiff = replace(law, stiffness=size * np.eye(3), strength=None)
        rows.append(curtain_row(f"rings of {size:.0e} N/mm", {}, stiff, "elastic"))
    return rows


def measure(full: bool) -> Section:
    """All of it; `full` has four times as many random loads."""
    more = 4 if full else 1
    others = [weave for weave in WEAVES.values() if weave not in (FOUR_IN_ONE, SIX_IN_ONE)]
    loads = [ratio_row(weave, ratio) for weave, ratios in RATIOS for ratio in ratios]
    loads += [ratio_row(weave, thinner * weave.jamming_ratio) for weave in others for thinner in THINNER]
    loads += [rim_row(name, ratio) for name in RIMS for ratio in (5.0, 10.0, 50.0)] + random_rows(6 * more)
    curtains = curtain_rows()
    motions = [motion_row(*one, steps=200 * more) for one in ladders()]
    laws = [law_row(*one) for one in law_kinds().items()]
    text = (
        "A row says how many cases `converged`, or the status of the failure, or the sentence that refuses the input. "
        "Round-off is given by the power of ten that bounds it. Curtains are squares of 100 mm hung by two corners at "
        "90 % of the width unless the row says otherwise."
    )
    missed = [row["loads"] for row in loads if len(row[OUTCOME].split()) > 2]
    good = count_of([row[STATUS] == "converged" for row in curtains])
    conclusion = f"Loads that end otherwise than `converged`: {'; '.join(missed) or 'none'}. {good} curtains converge."
    tables = (
        table("Loads of cells", loads, NOISE),
        table("The paper's scheme, 6 loads", motions, {"largest R": ".0e", "steps, median": ".0f"}),
        table("Laws", laws, {"E - E* = A S": "at_most 1e-14"}),
        table("Curtains", curtains, {"unbalanced": "at_most 1e-12", HEIGHT: ".5g"}),
    )
    return Section("Extremes", text, tables, (), conclusion)
