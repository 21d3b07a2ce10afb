"""Every kind of law at vertices, at edges, far outside and at what is no number."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from benchmarks.pages.measuring import at_most
from benchmarks.pages.model import Column, Section, Table, Value
from benchmarks.stability.words import refusal
from homogenize.law import Array, MembraneLaw, default_law, ring_net
from homogenize.polyhedral import PolyhedralLaw
from homogenize.smooth import smooth_law
from homogenize.tensor import WEIGHT, eigenvalues
from macro_fem.turned import turned

FAR = 1e6
NOT_NUMBERS = (np.nan, np.inf, -np.inf)


def kinds() -> dict[str, MembraneLaw]:
    """One law of every kind that ships; the smooth one has seeded parameters, as any real numbers make a law."""
    rings = default_law()
    assert rings.cell is not None
    theta = np.random.default_rng(4).normal(size=(6, 8))
    return {
        "polyhedral, of the rings": rings,
        "the same, turned by 30 degrees": turned(rings, 30.0),
        "net, of the rings": ring_net(rings.cell),
        "smooth": smooth_law(theta),
    }


def places(law: MembraneLaw) -> dict[str, Array]:
    """Strains (n, 3) to ask for: the surface at its vertices and edges, far away in 200 directions, one by one "
    "axis."""
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
        "a rounding beyond vertices": corners @ to_law + 1e-15,
        "between two vertices (edges, chords)": middles @ to_law,
        "just beyond, 1e-9": (corners + 1e-9) @ to_law,
        "far outside, 1e6": far @ to_law,
    }


def row(name: str, place: str, law: MembraneLaw, E: Array) -> tuple[Value, ...]:
    """Whether the answers are numbers and obey what every law promises."""
    answer, cut = law.response(E), law.cut(E)
    numbers = [answer.energy, answer.S, answer.C, answer.E_star, cut.S, cut.h, cut.violation]
    size = 1.0 + np.abs(E).max(axis=1)
    stress = np.abs(answer.S).max(axis=1) + 1e-300
    push = (eigenvalues(answer.S)[0] / stress).min()
    metric = np.abs(E - answer.E_star - answer.S @ law.compliance.T).max(axis=1) / size
    left = law.cut(answer.E_star).violation / size
    energy = 0.5 * (answer.S * WEIGHT * (E - answer.E_star)).sum(axis=1)
    balance = np.abs(energy - answer.energy) / (1e-300 + np.maximum(np.abs(energy), size * stress * 1e-3))
    return (
        name,
        place,
        len(E),
        "yes" if all(np.isfinite(part).all() for part in numbers) else "NO",
        at_most(max(1e-14, -push)),
        at_most(max(1e-14, float(metric.max()))),
        at_most(max(1e-14, float(left.max()))),
        at_most(max(1e-12, float(balance.max()))),
    )


def refused_rows(laws: dict[str, MembraneLaw]) -> list[tuple[Value, ...]]:
    """What each function of a law says to a strain or load that is no number."""
    rows: list[tuple[Value, ...]] = []
    for name, law in laws.items():
        for function in ("response", "cut", "support"):
            said = [refusal(partial(getattr(law, function), np.array([[v, 0.0, 0.1]]))) for v in NOT_NUMBERS]
            rows.append((name, function, sum(text != "accepted" for text in said), said[0]))
    return rows


def measure(full: bool) -> Section:
    """All laws at all places."""
    laws = kinds()
    rows = [row(name, place, law, E) for name, law in laws.items() for place, E in places(law).items()]
    refused = refused_rows(laws)
    columns = (
        Column("law"),
        Column("strains"),
        Column("points"),
        Column("all finite"),
        Column("push / pull"),
        Column("E - E* = A S"),
        Column("E* outside"),
        Column("energy = S:(E - E*)/2"),
    )
    refused_columns = (
        Column("law"),
        Column("function"),
        Column("refused of nan, inf, -inf"),
        Column("what nan is told"),
    )
    finite = sum(r[3] == "yes" for r in rows)
    told = sum(r[2] == len(NOT_NUMBERS) for r in refused)
    worst = max(rows, key=lambda r: float(str(r[5]).split()[-1]))
    return Section(
        "laws",
        "Laws at vertices, edges, far outside and at NaN",
        "`push / pull`: most negative principal line load over the largest; errors of the closest point E* and "
        "its metric are "
        "relative to 1 + |E|. Law and tangent must be numbers everywhere; what is no number must be refused in a "
        "sentence.",
        (Table("Answers", columns, tuple(rows)), Table("What is no number", refused_columns, tuple(refused))),
        conclusion=(
            f"All answers are finite in {finite} of {len(rows)} rows; the metric of the closest point holds to "
            f"{worst[5]} at worst "
            f"({worst[0]}, {worst[1]}). NaN and infinity are refused in a sentence by {told} of {len(refused)} "
            "functions."
        ),
    )
