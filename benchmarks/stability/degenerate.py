"""Pairs of tori whose distance is degenerate, against closed forms and brute force."""

from __future__ import annotations

import numpy as np

from benchmarks.pages.measuring import at_most
from benchmarks.pages.model import Column, Section, Table, Value
from rve.cell import find_contacts, start_pose
from rve.contact import Minima, are_linked, distance_gradient, distance_hessian, local_minima
from rve.weave import FOUR_IN_ONE, SIX_IN_ONE

Z = np.array([0.0, 0.0, 1.0])
TILT = np.array([0.0, np.sin(1e-8), np.cos(1e-8)])
Pair = tuple[str, tuple[float, float, float], np.ndarray, tuple[float, ...], str]
# Name, centre of B, normal of B (A at the origin, normal z, r1 = 1), distances of all local minima, contact points.
PAIRS: tuple[Pair, ...] = (
    ("coaxial", (0.0, 0.0, 0.7), Z, (0.7,), "a whole circle"),
    ("coplanar and concentric: the same circle", (0.0, 0.0, 0.0), Z, (0.0,), "a whole circle"),
    ("the same circle, turned by 1e-8", (0.0, 0.0, 0.0), TILT, (0.0, 0.0), "two crossings"),
    ("coplanar, apart", (2.5, 0.0, 0.0), Z, (0.5,), "one"),
    ("coplanar, crossing", (1.0, 0.0, 0.0), Z, (0.0, 0.0), "two crossings"),
    ("parallel planes, crossing projections", (1.0, 0.0, 0.3), Z, (0.3, 0.3), "two"),
    ("nearly parallel planes, 1e-8", (1.0, 0.0, 0.3), TILT, (0.3, 0.3), "two"),
    ("perpendicular through the centre", (0.0, 0.0, 0.0), np.array([0.0, 1.0, 0.0]), (0.0, 0.0), "two crossings"),
    (
        "perpendicular, circle A about a point of B",
        (1.0, 0.0, 0.0),
        np.array([0.0, 1.0, 0.0]),
        (1.0,),
        "a whole circle",
    ),
    ("perpendicular, taut", (1.8, 0.0, 0.0), np.array([0.0, 1.0, 0.0]), (0.2,), "one"),
    ("far apart", (1e6, 0.0, 0.0), np.array([0.0, 1.0, 0.0]), (1e6 - 2.0,), "one"),
)
MISSED = 20_000


def pair_row(
    name: str, centre: tuple[float, float, float], normal: np.ndarray, expected: tuple[float, ...], what: str
) -> tuple[Value, ...]:
    """Distances found against the closed form, and whether the derivatives are numbers."""
    d, n_a, n_b = np.array([centre]), Z[None], normal[None]
    found = local_minima(d, n_a, n_b, 1.0)
    swapped = local_minima(-d, n_b, n_a, 1.0)
    least = abs(found.distance.min() - min(expected)) / max(1.0, min(expected))
    other = abs(swapped.distance.min() - min(expected)) / max(1.0, min(expected))
    return (
        name,
        what,
        len(found.distance),
        at_most(max(1e-15, least)),
        at_most(max(1e-15, other)),
        "yes" if _finite(found, n_a, n_b) else "NO",
        "yes" if are_linked(d, n_a, n_b, 1.0)[0] else "no",
    )


def _finite(found: Minima, n_a: np.ndarray, n_b: np.ndarray) -> bool:
    normals = n_a[found.pair], n_b[found.pair]
    parts = (found.normal, distance_gradient(found), distance_hessian(found, *normals, 1.0))
    return all(bool(np.isfinite(part).all()) for part in parts)


def jammed_rows() -> list[tuple[Value, ...]]:
    """Interlocked at jamming: gaps of the jammed cell are all zero at once."""
    rows: list[tuple[Value, ...]] = []
    for weave in (FOUR_IN_ONE, SIX_IN_ONE):
        contacts = find_contacts(start_pose(weave, 1), weave, 1.0 / weave.jamming_ratio, 0.05)
        gap = contacts.gap[contacts.present]
        touching = gap[np.abs(gap) < 1e-6]
        links = "yes" if contacts.links_intact[0] else "NO"
        rows.append(
            (f"{weave.name} at r1/r2 = {weave.jamming_ratio:.5f}", len(touching), at_most(touching.max()), links)
        )
    return rows


def random_pairs(count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres within 1.8 r1 along each axis and normals in all directions."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(2, count, 3))
    normals /= np.linalg.norm(normals, axis=2)[..., None]
    return rng.uniform(-1.8, 1.8, (count, 3)), normals[0], normals[1]


def missed_rows(count: int) -> list[tuple[Value, ...]]:
    """Minima that 48 samples with refinement miss against 1536 samples, by how near they are."""
    pairs = random_pairs(count, 3)
    rows: list[tuple[Value, ...]] = []
    for reach in (0.2, 0.4, 0.6):
        ours, many = (
            np.bincount(local_minima(*pairs, 1.0, reach=reach, samples=n).pair, minlength=count) for n in (48, 1536)
        )
        rows.append(
            (reach, int(many.sum()), int(np.maximum(many - ours, 0).sum()), int(np.maximum(ours - many, 0).sum()))
        )
    return rows


def measure(full: bool) -> Section:
    """Named pairs, jammed cells, random pairs."""
    named = tuple(pair_row(*one) for one in PAIRS)
    pair_columns = (
        Column("pair"),
        Column("touch in"),
        Column("minima found"),
        Column("error of the distance"),
        Column("the same, A and B swapped"),
        Column("derivatives finite"),
        Column("linked"),
    )
    missed = tuple(missed_rows(MISSED * (10 if full else 1)))
    missed_columns = (Column("distance below, r1", "g"), Column("minima"), Column("missed"), Column("counted twice"))
    jam_columns = (Column("cell"), Column("contacts at once"), Column("largest gap, r1"), Column("links intact"))
    finite = sum(row[5] == "yes" for row in named)
    near = missed[0]
    return Section(
        "pairs",
        "Degenerate pairs of tori",
        "Ring A at the origin in the plane z = 0, r1 = 1; distances of centre circles. Where circles touch along "
        "a whole "
        "circle any point of it is an answer; where they cross the distance is zero and has no direction.",
        (
            Table("Pairs by name", pair_columns, named),
            Table("Interlocked at jamming", jam_columns, tuple(jammed_rows())),
            Table("Random pairs against 1,536 samples each", missed_columns, missed),
        ),
        conclusion=(
            f"Derivatives are numbers in {finite} of {len(named)} named pairs. Of {near[1]:,} minima nearer than "
            f"{near[0]:g} r1 "
            f"in random pairs {near[2]} are missed and {near[3]} counted twice; of {missed[-1][1]:,} nearer than "
            f"{missed[-1][0]:g} r1, {missed[-1][2]} are missed."
        ),
    )
