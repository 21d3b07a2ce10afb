"""The map of half-spaces against a search through all of them, on the grid, off it, and where planes meet."""

import numpy as np
import pytest

from homogenize.fitting.refine import refined_half_spaces
from homogenize.laws.lookup import envelope_of
from rve.common.tensor import WEIGHT

from .conftest import disc_grid, rows_of


@pytest.mark.parametrize("kind", ["smooth set", "one vertex"])
def test_map_finds_the_most_violated_half_space(kind, ellipsoid):
    S, h = refined_half_spaces(rows_of(ellipsoid, disc_grid(8, 40)))
    if kind == "one vertex":
        S = disc_grid(8, 40)
        h = S @ (np.array([0.1, 0.05, -0.2]) * WEIGHT)
    envelope = envelope_of(S, h, np.array([[-0.3, -0.2], [0.4, 0.2]]))
    rng = np.random.default_rng(13)
    D, G, T = rng.uniform(-0.5, 0.5, 5000), rng.uniform(-0.4, 0.4, 5000), rng.uniform(-0.5, 0.5, 5000)
    D[:500], G[:500] = 0.15 + rng.normal(scale=1e-4, size=500), 0.05 + rng.normal(scale=1e-4, size=500)
    E = np.stack([T + D, G, T - D])
    index, excess = envelope.highest(E)
    every = E.T @ (S * WEIGHT).T - h
    assert np.allclose(excess, every.max(axis=1), atol=1e-13)
    assert np.allclose(excess, every[np.arange(len(index)), index], atol=1e-13)
    on_grid = (np.abs(D - 0.05) < 0.35) & (np.abs(G) < 0.2)
    assert on_grid.sum() > 1000
    plain = envelope.crowd >= -1
    assert plain.mean() > 0.9  # the map does the work, not the search
