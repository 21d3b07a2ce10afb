"""Pairs of tori whose distance is degenerate, against closed forms and denser samples."""

import numpy as np

from benchmarks.report.measure import Row, count_of
from benchmarks.report.records import Section, table
from rve.geometry.circles import are_linked, distance_gradient, distance_hessian, local_minima
from rve.geometry.contacts import find_contacts
from rve.geometry.pose import start_pose
from rve.geometry.weave import FOUR_IN_ONE, SIX_IN_ONE, Weave

Z = np.array([0.0, 0.0, 1.0])
Y = np.array([0.0, 1.0, 0.0])
TILT = np.array([0.0, np.sin(1e-8), np.cos(1e-8)])
Pair = tuple[str, tuple[float, float, float], np.ndarray, float, str]
# Name, centre of B, normal of B (A at the origin, normal z, r1 = 1), least distance, contact points.
PAIRS: tuple[Pair, ...] = (
    ("coaxial", (0.0, 0.0, 0.7), Z, 0.7, "a whole circle"),
    ("coplanar and concentric: the same circle", (0.0, 0.0, 0.0), Z, 0.0, "a whole circle"),
    ("the same circle, turned by 1e-8", (0.0, 0.0, 0.0), TILT, 0.0, "two crossings"),
    ("coplanar, apart", (2.5, 0.0, 0.0), Z, 0.5, "one"),
    ("coplanar, crossing", (1.0, 0.0, 0.0), Z, 0.0, "two crossings"),
    ("parallel planes, crossing projections", (1.0, 0.0, 0.3), Z, 0.3, "two"),
    ("nearly parallel planes, 1e-8", (1.0, 0.0, 0.3), TILT, 0.3, "two"),
    ("perpendicular through the centre", (0.0, 0.0, 0.0), Y, 0.0, "two crossings"),
    ("perpendicular, circle A about a point of B", (1.0, 0.0, 0.0), Y, 1.0, "a whole circle"),
    ("perpendicular, taut", (1.8, 0.0, 0.0), Y, 0.2, "one"),
    ("far apart", (1e6, 0.0, 0.0), Y, 1e6 - 2.0, "one"),
)
MISSED = 20_000
ERROR, SWAPPED = "error of the distance", "the same, A and B swapped"


def pair_row(name: str, centre: tuple[float, float, float], normal: np.ndarray, expected: float, what: str) -> Row:
    """Least distance found against the closed form, and whether the derivatives are finite."""
    d, n_a, n_b = np.array([centre]), Z[None], normal[None]
    found, swapped = local_minima(d, n_a, n_b, 1.0), local_minima(-d, n_b, n_a, 1.0)
    hessian = distance_hessian(found, n_a[found.pair], n_b[found.pair], 1.0)
    parts = (found.normal, distance_gradient(found), hessian)
    return {
        "pair": name,
        "touch in": what,
        "minima found": len(found.distance),
        ERROR: abs(found.distance.min() - expected) / max(1.0, expected),
        SWAPPED: abs(swapped.distance.min() - expected) / max(1.0, expected),
        "derivatives finite": all(np.isfinite(part).all() for part in parts),
        "linked": are_linked(d, n_a, n_b, 1.0)[0],
    }


def jammed_row(weave: Weave) -> Row:
    """A cell at jamming: all gaps between touching rings are zero at once."""
    contacts = find_contacts(start_pose(weave, 1), weave, 1.0 / weave.jamming_ratio, 0.05)
    gap = contacts.gap[contacts.present]
    touching = gap[np.abs(gap) < 1e-6]
    cell, links = f"{weave.name} at r1/r2 = {weave.jamming_ratio:.5f}", contacts.links_intact[0]
    return {"cell": cell, "contacts at once": len(touching), "largest gap, r1": touching.max(), "links intact": links}


def random_pairs(count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres within 1.8 r1 along each axis and normals in all directions."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(2, count, 3))
    normals /= np.linalg.norm(normals, axis=2)[..., None]
    return rng.uniform(-1.8, 1.8, (count, 3)), normals[0], normals[1]


def missed_row(count: int, reach: float) -> Row:
    """Minima closer than `reach` that 48 samples with refinement miss against 1536 samples."""
    pairs = random_pairs(count, 3)
    found = (local_minima(*pairs, 1.0, reach=reach, samples=n).pair for n in (48, 1536))
    ours, many = (np.bincount(pair, minlength=count) for pair in found)
    missed, twice = np.maximum(many - ours, 0).sum(), np.maximum(ours - many, 0).sum()
    return {"distance below, r1": reach, "minima": many.sum(), "missed": missed, "counted twice": twice}


def measure(full: bool) -> Section:
    """Named pairs, jammed cells, random pairs."""
    named = [pair_row(*one) for one in PAIRS]
    missed = [missed_row(MISSED * (10 if full else 1), reach) for reach in (0.2, 0.4, 0.6)]
    near, far = missed[0], missed[-1]
    text = (
        "Ring A at the origin in the plane z = 0, r1 = 1; distances of centre circles. Where circles touch along a "
        "whole circle, any point of it is an answer; where they cross, the distance is zero and has no direction."
    )
    tables = (
        table("Pairs by name", named, {ERROR: "at_most 1e-15", SWAPPED: "at_most 1e-15"}),
        table(
            "Cells at jamming",
            [jammed_row(weave) for weave in (FOUR_IN_ONE, SIX_IN_ONE)],
            {"largest gap, r1": "at_most"},
        ),
        table("Random pairs against 1,536 samples each", missed, {"distance below, r1": "g"}),
    )
    conclusion = (
        f"Derivatives are finite in {count_of([row['derivatives finite'] for row in named])} named pairs. Of "
        f"{near['minima']:,} minima closer than {near['distance below, r1']:g} r1 in random pairs {near['missed']} are "
        f"missed and {near['counted twice']} counted twice; of {far['minima']:,} closer than "
        f"{far['distance below, r1']:g} r1, {far['missed']} are missed."
    )
    return Section("Degenerate pairs of tori", text, tables, (), conclusion)
