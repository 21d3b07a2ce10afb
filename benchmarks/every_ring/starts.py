"""Random admissible starts: how far apart the potentials end, and whether any ring passed through another."""

import numpy as np

from benchmarks.every_ring.brute import least_gap, linked_pairs
from benchmarks.every_ring.cases import SHEETS
from benchmarks.frame import Section, table
from benchmarks.measure import Row, outcomes
from macro_fem.rings import RingScene, ring_scene
from rve.finite import FiniteOptions
from rve.finite.contacts import MeshPose, find_mesh_contacts, links_intact
from rve.finite.problem import Problem
from rve.finite.solve import solve_rings

SWEEPS, STRIDE = 40, 0.08
"""Rounds of random motion that make a start, and the largest motion of a round in r1 and radians."""


def measure(full: bool) -> Section:
    """The section."""
    # sheet, k, number of starts, whether in space
    plan = ((0, 1, 35, False), (0, 1, 35, True), (2, 1, 20, True), (0, 2, 10, True)) if full else ((0, 1, 3, True),)
    rows = [_row(*one) for one in plan]
    text = (
        f"Scenes as in the first section. A start is the slack weave after {SWEEPS} rounds in which every ring moves "
        f"and tilts at random by up to {STRIDE} r1 and {STRIDE} rad, and goes back where it would overlap another. At "
        "the end links are found by Gauss's integral and the least gap by sampling (`brute.py`), independently of the "
        "solver. The potential is over the weight times the height; its spread is that of the converged runs."
    )
    kept_links, runs = sum(row["links as woven"] for row in rows), sum(row["starts"] for row in rows)
    conclusion = (
        f"Links are as woven in {kept_links} of {runs} runs. Potentials of one scene spread by up to "
        f"{max(row['spread, %'] for row in rows):.2g} % of weight times height; the solver's own start (the slack "
        f"weave) ends at most {max(row['own start above the best, %'] for row in rows):.2g} % above the best of them."
    )
    percent = dict.fromkeys(("best, %", "spread, %", "standard deviation, %", "own start above the best, %"), ".3f")
    forms = percent | {"least gap, r1": "at_most 1e-9"}
    return Section("Random starts", text, (table("Random admissible starts", rows, forms),), (), conclusion)


def _row(sheet: int, k: int, count: int, space: bool) -> Row:
    rings = ring_scene(SHEETS[sheet].scene(k, 8))
    scale = float(np.abs(rings.force).sum()) * float(np.ptp(rings.mesh.X[:, 1]))
    woven = {(int(a), int(b)) for a, b in rings.mesh.linked}
    r1, wire = rings.mesh.cell.r1, rings.mesh.cell.wire
    problem, X = problem_of(rings, space).scaled(), np.pad(rings.mesh.X, ((0, 0), (0, 1)))
    status, potential, intact, gaps = [], [], 0, []
    for seed in range(count):
        found = solve_rings(problem, random_start(rings, space, seed), FiniteOptions())
        pose = found.contacts.pose
        status.append(found.status)
        potential.append(float((rings.force * (X - r1 * pose.x)).sum()) / scale)
        intact += linked_pairs(pose.x, pose.normal, 1.0) == woven
        gaps.append(least_gap(pose.x, pose.normal, 1.0, wire))
    own = rings.solve(space=space)
    good = np.array(potential)[np.array(status) == "converged"]
    row = {"scene": SHEETS[sheet].key, "rings": len(rings.mesh.X), "centres": "space" if space else "plane"}
    row |= {"starts": count, "status": outcomes(status), "links as woven": intact, "least gap, r1": min(0.0, *gaps)}
    row |= {"best, %": 100.0 * good.min(), "spread, %": 100.0 * np.ptp(good)}
    above = 100.0 * (own.potential / scale - good.min())
    return row | {"standard deviation, %": 100.0 * good.std(), "own start above the best, %": above}


def problem_of(rings: RingScene, space: bool) -> Problem:
    """What the solver is asked for."""
    return Problem(rings.mesh, rings.force, rings.held, rings.at, space)


def random_start(rings: RingScene, space: bool, seed: int) -> MeshPose:
    """An admissible placement far from the slack weave."""
    rng = np.random.default_rng(seed)
    mesh, wire = rings.mesh, rings.mesh.cell.wire
    keys = mesh.linked[:, 0] * len(mesh.X) + mesh.linked[:, 1]
    pose = problem_of(rings, space).start(FiniteOptions(disturbance=0.0))
    for _ in range(SWEEPS):
        q = STRIDE * rng.uniform(-1.0, 1.0, (len(mesh.X), 5))
        if not space:
            q[:, 2] = 0.0
        for _ in range(30):
            trial = pose.moved(q)
            con = find_mesh_contacts(trial, mesh.linked, wire, 0.1, guard_points=False)
            bad = con.deepest < 0.01
            if not bad.any():
                break
            q[con.a[bad]] = q[con.b[bad]] = 0.0
        if not bad.any() and links_intact(con, keys):
            pose = trial
    return pose
