"""Every kind of law at vertices, at edges, far outside, and at input that is not finite."""

from functools import partial
from typing import Any

import numpy as np

from benchmarks.report.measure import Row, at_most, count_of, refusal
from benchmarks.report.records import Section, table
from homogenize.io import default_law
from homogenize.laws.net import ring_net
from homogenize.laws.polyhedral import PolyhedralLaw
from homogenize.laws.protocol import MembraneLaw
from macro_fem.fem.rotated import rotated
from rve.common.tensor import WEIGHT, eigenvalues
from rve.common.types import Array

FAR = 1e6
METRIC = "E - E* = A S"
NOT_NUMBERS = (np.nan, np.inf, -np.inf)


def kinds() -> dict[str, MembraneLaw]:
    """One law of every kind."""
    rings = default_law()
    assert rings.cell is not None
    return {
        "polyhedral, of the rings": rings,
        "the same, rotated by 30 degrees": rotated(rings, 30.0),
        "net, of the rings": ring_net(rings.cell),
    }


def places(law: MembraneLaw) -> dict[str, Array]:
    """Strains (n, 3): the surface at its vertices and edges, and far away in 200 directions and along the axes."""
    source: Any = getattr(law, "law", law)
    to_law = law.to_curtain.T if hasattr(law, "to_curtain") else np.eye(3)
    rng = np.random.default_rng(9)
    directions = rng.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    corners = source.vertices if isinstance(source, PolyhedralLaw) else source.response(directions).E_star
    corners = corners[:400]
    far = np.concatenate([FAR * directions, FAR * np.eye(3), -FAR * np.eye(3)])
    middles = 0.5 * (corners + np.roll(corners, 1, axis=0))
    return {
        "at vertices": corners @ to_law,
        "1e-15 beyond vertices": corners @ to_law + 1e-15,
        "between two vertices (edges, chords)": middles @ to_law,
        "just beyond, 1e-9": (corners + 1e-9) @ to_law,
        "far outside, 1e6": far @ to_law,
    }


def row(name: str, place: str, law: MembraneLaw, E: Array) -> Row:
    """Whether the answers are finite and obey the identities of every law."""
    answer, cut = law.response(E), law.cut(E)
    numbers = [answer.energy, answer.S, answer.C, answer.E_star, cut.S, cut.h, cut.violation]
    size = 1.0 + np.abs(E).max(axis=1)
    stress = np.abs(answer.S).max(axis=1) + 1e-300
    metric = np.abs(E - answer.E_star - answer.S @ law.compliance.T).max(axis=1) / size
    energy = 0.5 * (answer.S * WEIGHT * (E - answer.E_star)).sum(axis=1)
    balance = np.abs(energy - answer.energy) / (1e-300 + np.maximum(np.abs(energy), size * stress * 1e-3))
    return {
        "law": name,
        "strains": place,
        "points": len(E),
        "all finite": all(np.isfinite(part).all() for part in numbers),
        "push / pull": max(0.0, -(eigenvalues(answer.S)[0] / stress).min()),
        METRIC: metric.max(),
        "E* outside": max(0.0, (law.cut(answer.E_star).violation / size).max()),
        "energy = S:(E - E*)/2": balance.max(),
    }


def refused_row(name: str, law: MembraneLaw, function: str) -> Row:
    """The answer of a function of a law to strains or loads that are not finite."""
    said = [refusal(partial(getattr(law, function), np.array([[v, 0.0, 0.1]]))) for v in NOT_NUMBERS]
    refused = sum(text != "accepted" for text in said)
    return {"law": name, "function": function, "refused of nan, inf, -inf": refused, "message for nan": said[0]}


def measure(full: bool) -> Section:
    """All laws at all places."""
    laws = kinds()
    rows = [row(name, place, law, E) for name, law in laws.items() for place, E in places(law).items()]
    functions = ("response", "cut", "support")
    refused = [refused_row(name, law, function) for name, law in laws.items() for function in functions]
    worst = max(rows, key=lambda row: row[METRIC])
    noise = "at_most 1e-14"
    forms = {"push / pull": noise, METRIC: noise, "E* outside": noise, "energy = S:(E - E*)/2": "at_most 1e-12"}
    told = count_of([row["refused of nan, inf, -inf"] == len(NOT_NUMBERS) for row in refused])
    text = (
        "`push / pull`: most negative principal line load over the largest. Errors of the closest point E* and its "
        "metric are relative to 1 + |E|. Law and tangent must be finite everywhere; input that is not finite must be "
        "refused in a sentence."
    )
    conclusion = (
        f"All answers are finite in {count_of([row['all finite'] for row in rows])} rows; the error of the metric of "
        f"the closest point is {at_most(worst[METRIC], 1e-14)}. NaN and infinity are refused in a sentence by {told} "
        "functions."
    )
    tables = (table("Answers", rows, forms), table("Input that is not finite", refused))
    return Section("Laws at vertices, edges, far outside and at NaN", text, tables, (), conclusion)
