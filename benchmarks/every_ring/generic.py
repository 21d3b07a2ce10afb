"""A mesh of 2 x 2 cells in IPOPT: the same potential from a generic nonlinear solver with gaps of its own.

A ring has its centre and two tilts as unknowns. A constraint is a fixed direction, projected into the plane of ring a,
whose point keeps its distance from circle b, in closed form; CasADi differentiates it. Directions are evenly spaced,
and those of all local minima of this round and the ones before. Boxes, smaller than the wire, shrink in every round.
"""

import importlib.util
import time
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.every_ring.brute import Array, frames, least_gap, linked_pairs, minima_of, near_pairs, to_circle
from benchmarks.every_ring.cases import GRAVITY
from benchmarks.frame import Section, table
from benchmarks.measure import Row
from rve import Cell, FiniteMesh
from rve.finite import FiniteSolution

BOX = 0.06
"""Largest change of any unknown in a round, lengths in r1."""
PROXIMITY = 1e-3
"""Cost of a step squared, in weight times r1, so that loose rings stay where they are; it vanishes with the step."""
SHRINK = 0.8
ROUNDS = 120
EVEN = 16
SEEDS = (5, 6, 7)
"""Of the random starts."""
DIFFERENCE = "difference of the potential over weight times r1"


class Peer(NamedTuple):
    """Centres and normals (n, 3) in r1, potential over the sum of the loads, rounds, least gap by brute force."""

    centre: Array
    normal: Array
    potential: float
    rounds: int
    least_gap: float


Cut = tuple[int, int, Array]
"""A constraint: two rings, and the direction on the first."""


def solve_generic(start: tuple[Array, Array], force: Array, fixed: NDArray[np.bool_], wire: float) -> Peer:
    """IPOPT from a start (centres, normals) with its links right; `fixed` (n, 3) coordinates stay where they are."""
    centre, normal = (np.array(part) for part in start)
    scale = float(np.abs(force).sum())
    old: list[list[Cut]] = []
    potential = np.inf
    for count in range(1, ROUNDS + 1):
        even, fresh = _cuts(centre, normal, wire)
        old = [*old[-5:], fresh]
        cuts = [*even, *chain.from_iterable(old)]
        before = np.concatenate([centre, normal])
        centre, normal = _round(centre, normal, force / scale, fixed, wire, cuts, BOX * SHRINK**count)
        new = -float((force * centre).sum()) / scale
        moved = float(np.abs(np.concatenate([centre, normal]) - before).max())
        done = abs(new - potential) < 3e-8 and least_gap(centre, normal, 1.0, wire) > -1e-7
        potential = new
        if done or moved < 1e-9:
            break
    return Peer(centre, normal, potential, count, least_gap(centre, normal, 1.0, wire))


def _cuts(centre: Array, normal: Array, wire: float) -> tuple[list[Cut], list[Cut]]:
    """Points of a ring that come near another: evenly spaced ones of both rings of a pair, and all minima of pairs."""
    e1, e2 = frames(normal)
    t, reach = 2.0 * np.pi / EVEN * np.arange(EVEN), 2.0 * wire + 4.0 * BOX
    pairs, even = near_pairs(centre, 2.0 + reach), list[Cut]()
    for a, b in np.stack([pairs, pairs[:, ::-1]], axis=1).reshape(-1, 2):
        rho = np.cos(t)[:, None] * e1[a] + np.sin(t)[:, None] * e2[a]
        near = to_circle(centre[a] + rho, centre[b], normal[b], 1.0) < reach
        even += [(a, b, direction) for direction in rho[near]]
    row, s, distance = (part[..., None] for part in minima_of(centre, normal, pairs))
    a, b = pairs[row[:, 0]].T
    touching = zip(a, b, np.cos(s) * e1[a] + np.sin(s) * e2[a], strict=True)
    return even, [cut for cut, way in zip(touching, distance, strict=True) if way < reach]


def _round(
    centre: Array, normal: Array, force: Array, fixed: NDArray[np.bool_], wire: float, cuts: list[Cut], width: float
) -> tuple[Array, Array]:
    """Centres and normals of the least potential under the cuts, within the box."""
    import casadi as ca

    n = len(centre)
    z = ca.SX.sym("z", 5 * n)
    e1, e2 = frames(normal)
    x = [centre[k] + z[3 * k : 3 * k + 3] for k in range(n)]
    tilts = [z[3 * n + 2 * k : 3 * n + 2 * k + 2] for k in range(n)]
    m = [(normal[k] + u[0] * e1[k] + u[1] * e2[k]) / ca.sqrt(1.0 + ca.sumsqr(u)) for k, u in enumerate(tilts)]
    gaps = []
    for a, b, v in cuts:
        flat = v - ca.dot(v, m[a]) * m[a]
        w = x[a] + flat / ca.norm_2(flat) - x[b]
        height = ca.dot(w, m[b])
        gaps.append((ca.sqrt(ca.sumsqr(w) - height**2) - 1.0) ** 2 + height**2)
    f = -sum(float(p) * x[k][i] for k, row in enumerate(force) for i, p in enumerate(row) if p)
    f += PROXIMITY * ca.sumsqr(z)
    quiet = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.tol": 1e-11}
    quiet |= {"ipopt.max_iter": 200, "ipopt.bound_relax_factor": 0.0, "show_eval_warnings": False}
    solver = ca.nlpsol("rings", "ipopt", {"x": z, "f": f, "g": ca.vertcat(*gaps)}, quiet)
    box = np.concatenate([np.where(fixed, 0.0, width).ravel(), np.full(2 * n, width)])
    solved = solver(x0=np.zeros(5 * n), lbx=-box, ubx=box, lbg=(2.0 * wire) ** 2, ubg=np.inf)
    q = np.array(solved["x"]).ravel()
    u = q[3 * n :].reshape(n, 2)
    turned = normal + u[:, :1] * e1 + u[:, 1:] * e2
    return centre + q[: 3 * n].reshape(n, 3), turned / np.linalg.norm(turned, axis=1)[:, None]


TITLE = "A generic nonlinear solver"
CASES = (("corners", False), ("corners", True), ("top", False))
"""Support, and whether in space."""


def measure(full: bool) -> Section:
    """The section; without CasADi, one that says so."""
    if importlib.util.find_spec("casadi") is None:
        return Section(TITLE, "CasADi is not installed (`pip install casadi`): nothing was compared.", ())
    rows = [compared(*case) for case in (CASES if full else CASES[:1])]
    text = (
        "A mesh of 2 x 2 reference cells, 13 rings, r1/r2 = 10, under its weight, hung by its upper corners at 90 % "
        "of their distance or by its whole top edge. IPOPT (through CasADi) has gaps and derivatives of its own "
        "(`generic.py`). It starts from our answer with all rings moved and tilted by up to 0.01 at random and looks "
        f"for a local minimum in boxes that shrink from {BOX} r1. The lowest of {len(SEEDS)} starts is compared with "
        "`rve.FiniteMesh`."
    )
    near = [row for row in rows if abs(row[DIFFERENCE]) < 1e-6]
    conclusion = f"IPOPT's potential is ours to 1e-6 of weight times r1 in {len(near)} of {len(rows)} rows."
    forms = {DIFFERENCE: "signed 1e-9 2", "least gap of IPOPT, r1": "at_most 1e-12", "s of IPOPT": ".0f"}
    return Section(TITLE, text, (table("2 x 2 cells in IPOPT", rows, forms),), (), conclusion)


def _disturbed(ours: FiniteSolution, fixed: NDArray[np.bool_], seed: int) -> tuple[Array, Array]:
    """Our centres in r1 and normals, moved and tilted at random."""
    rng = np.random.default_rng(seed)
    centre = ours.centre / ours.mesh.cell.r1 + np.where(fixed, 0.0, 0.01 * rng.uniform(-1.0, 1.0, ours.centre.shape))
    normal = ours.normal + 0.01 * rng.uniform(-1.0, 1.0, ours.normal.shape)
    return centre, normal / np.linalg.norm(normal, axis=1)[:, None]


def compared(hung: str, space: bool) -> Row:
    """Our answer, and that of IPOPT from starts near ours."""
    mesh = FiniteMesh.rectangle(Cell(), 2, 2)
    n, r1, wire = len(mesh.X), mesh.cell.r1, mesh.cell.wire
    force = np.zeros((n, 3))
    force[:, 1] = -GRAVITY * mesh.mass
    top = np.isclose(mesh.X[:, 1], mesh.X[:, 1].max())
    at = np.column_stack([mesh.X, np.zeros(n)])
    if hung == "corners":
        middle = mesh.X[:, 0].mean()
        top &= np.isclose(np.abs(mesh.X[:, 0] - middle), np.ptp(mesh.X[:, 0]) / 2.0)
        at[:, 0] = middle + 0.9 * (at[:, 0] - middle)
    held = np.repeat(top[:, None], 3, axis=1)
    ours = mesh.solve(force, held, at, space=space)
    fixed = held | np.array([False, False, not space])
    potential = -float((force * ours.centre).sum()) / np.abs(force).sum() / r1
    began = time.process_time()
    peers = [solve_generic(_disturbed(ours, fixed, seed), force, fixed, wire) for seed in SEEDS]
    peer = min(peers, key=lambda one: (one.least_gap < -1e-7, one.potential))
    seconds = time.process_time() - began
    intact = linked_pairs(peer.centre, peer.normal, 1.0) == {(int(a), int(b)) for a, b in mesh.linked}
    row = {"hung by": hung, "centres": "space" if space else "plane", "ours": ours.status}
    row |= {DIFFERENCE: peer.potential - potential, "least gap of IPOPT, r1": peer.least_gap}
    return row | {"links of IPOPT intact": intact, "rounds": peer.rounds, "s of IPOPT": seconds}
