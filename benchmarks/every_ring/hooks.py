"""Rings next to hooks: their largest stress by the contact forces of every ring, against that of the disk."""

from functools import cache
from typing import Any

import numpy as np

from benchmarks.every_ring.brute import frames
from benchmarks.every_ring.cases import AREAL_MASS, Array
from benchmarks.frame import Section, table
from benchmarks.measure import Row
from homogenize import Law, default_law, fit
from macro_fem import read_scene, solve
from macro_fem.rings import ring_scene
from rve import Cell, solve_table, with_rings
from rve.finite import FiniteSolution
from rve.wire import Ring, peak_stress

NEAR = 2.0
"""Rings next to a hook: within this many sides of the reference cell of a held one."""
CELLS = 24
"""Of the disk's mesh across."""
CORNERS = {"kind": "corners", "gather": 0.9}
SCENES: tuple[tuple[str, str, float, tuple[int, int], Any, Any], ...] = (
    ("corners", "4-in-1", 0.0, (8, 6), CORNERS, {}),
    ("corners", "4-in-1", 0.0, (12, 6), CORNERS, {}),
    ("hooks", "4-in-1", 0.0, (8, 6), 2, {}),
    ("hooks", "4-in-1", 0.0, (8, 6), 4, {}),
    ("hooks", "4-in-1", 0.0, (16, 6), 4, {}),
    ("hooks, bar", "4-in-1", 0.0, (8, 6), 4, {"bar": {"mass": 0.1}}),
    ("hooks, wind", "4-in-1", 0.0, (8, 6), 4, {"wind": {"direction": [0, 0, 1], "pressure": 14.0}}),
    ("hooks", "4-in-1", 90.0, (8, 6), 4, {}),
    ("corners", "6-in-1", 0.0, (8, 6), CORNERS, {}),
    ("hooks", "6-in-1", 0.0, (8, 6), 4, {}),
)
"""Name, weave, its angle in degrees, cells across and down, support or cells from hook to hook, further loads."""
ALL, BESIDE, HOOK = "largest, rings / disk", "beside the held ring / mesh", "held ring / ring at hook"


@cache
def law_of(weave: str) -> Law:
    """The law of r1/r2 = 10 with the strength of its rings; of 6-in-1 from a grid of 10 degrees."""
    if weave == "4-in-1":
        return default_law()
    cell, step = Cell(weave=weave), np.arange(0.0, 91.0, 10.0)
    loads = np.repeat(np.arange(-45.0, 45.0, 10.0), len(step)), np.tile(step, 9)
    return fit(with_rings(solve_table(cell, loads), cell)).law


def measure(full: bool) -> Section:
    """The section."""
    rows = [compared(*one) for one in (SCENES if full else SCENES[2:4])]
    good = [row for row in rows if row["status"] == "converged"]
    text = (
        "Rings of r1/r2 = 10, in space, of the default steel. A ring's utilisation: the largest von Mises stress by "
        "its contact forces (`rve.wire.strength`) over the yield stress; the force at a hook acts where the ring's "
        "wire meets its line. The rings are rigid: where they leave forces open, these are one choice of many. `disk`: "
        f"the utilisation of the summary, {CELLS} columns of finite elements. `{HOOK}`: against two opposed forces. "
        f"`{BESIDE}`: rings within {NEAR:g} cells of a held one against the larger of averages and point forces. Hooks "
        "are 90 % of their pitch apart."
    )
    ratios = ((head, np.array([row[head] for row in good])) for head in (ALL, HOOK, BESIDE))
    told = [f"{head}: {x.mean():.2f} on average, {x.min():.2f} to {x.max():.2f}" for head, x in ratios]
    conclusion = f"{len(good)} of {len(rows)} scenes converged. " + "; ".join(told) + "."
    forms = dict.fromkeys((ALL, BESIDE, HOOK), ".2f")
    return Section("Rings next to a hook", text, (table("Utilisation, rings over disk", rows, forms),), (), conclusion)


def compared(name: str, weave: str, angle: float, cells: tuple[int, int], support: Any, load: Any) -> Row:
    """Rings of a scene against its disk."""
    law = law_of(weave)
    assert law.cell is not None
    info, strength = law.cell, law.strength
    across, down = (info.b_y_mm, info.b_x_mm) if angle else (info.b_x_mm, info.b_y_mm)
    if not isinstance(support, dict):
        support = {"kind": "hooks", "pitch": support * across, "gather": 0.9}
    curtain = {"width": cells[0] * across, "height": cells[1] * down, "weave_angle": angle, "areal_mass": AREAL_MASS}
    scene = read_scene({"curtain": curtain, "mesh": {"cells": CELLS}, "support": support, "load": load})
    told = solve(scene, law).summary
    rings = ring_scene(scene, law)
    found = rings.solve(space=True)
    held = np.flatnonzero(rings.held[:, 1])
    away = np.linalg.norm(rings.mesh.X[:, None] - rings.mesh.X[held], axis=2).min(axis=1)
    ring = Ring(info.r1_mm, info.r2_mm, strength.material.young_N_per_mm2, strength.material.poisson)
    near = np.flatnonzero(away <= NEAR * max(across, down))
    used, is_held = np.array([peak(found, i, ring) for i in near]) / strength.yield_stress(), np.isin(near, held)
    mesh = max(told["utilisation_of_averages_max"], told["utilisation_of_point_forces_max"])
    row = {"scene": name, "weave": f"{weave}, {'across' if angle else 'along'}", "cells": f"{cells[0]} x {cells[1]}"}
    row |= {"rings": len(found.centre), "status": found.status, "disk": told["utilisation_max"]}
    row[ALL] = used.max() / told["utilisation_max"]
    row[HOOK] = used[is_held].max() / told["utilisation_of_hook_rings_max"]
    return row | {BESIDE: used[~is_held].max() / mesh}


def peak(found: FiniteSolution, i: int, ring: Ring) -> float:
    """The largest von Mises stress in N/mm2 of ring i under its contacts and the force of its support."""
    contacts, N = found.contacts, found.normal[i]
    on = np.flatnonzero((contacts.pairs == i).any(axis=1) & (contacts.force > 0.0))
    rho = [contact_point(found, k, ring)[list(contacts.pairs[k]).index(i)] for k in on]
    push = [contacts.force[k] * contacts.normal[k] * (1.0 if contacts.pairs[k, 1] == i else -1.0) for k in on]
    hook = found.reaction[i] - (found.reaction[i] @ N) * N  # in the ring's plane: its centre is what is held
    if np.linalg.norm(hook) > 0.0:
        rho, push = [*rho, hook / np.linalg.norm(hook)], [*push, hook]
    at, F, (e1, e2) = np.array(rho), np.array(push), frames(N[None])
    phi = np.arctan2(at @ e2[0], at @ e1[0])
    forces = np.stack([(F * at).sum(axis=1), (F * np.cross(N, at)).sum(axis=1), F @ N], axis=1)
    return float(peak_stress(phi[None], forces[None], ring)[0][0])


def contact_point(found: FiniteSolution, k: int, ring: Ring) -> tuple[Array, Array]:
    """Directions from the centres of both rings to the points of their centre circles next to contact k: along its
    normal within the plane of each, on the side from which the normal leads from one to the other."""
    contacts = found.contacts
    n, two = contacts.normal[k], contacts.pairs[k]
    flat = [n - (n @ found.normal[i]) * found.normal[i] for i in two]
    a, b = (x / np.linalg.norm(x) for x in flat)
    way = found.centre[two[1]] - found.centre[two[0]] - (2.0 * ring.r2 + contacts.gap[k]) * n
    sides = [(s * a, t * b) for s in (1.0, -1.0) for t in (1.0, -1.0)]
    return min(sides, key=lambda x: float(np.linalg.norm(ring.r1 * (x[0] - x[1]) - way)))
