"""Tables of every weave of the catalogue: each row has an answer, is normal, and no load by itself does more work."""

import numpy as np
import pytest

from rve import WEAVES, Cell, grid, solve_table, support
from rve.common.tensor import WEIGHT, trace


@pytest.mark.release
@pytest.mark.parametrize(
    ("name", "thinner"),
    [(name, thinner) for name in WEAVES for thinner in (1.03, 1.5, 2.0)]
    + [(name, 3.0) for name in ("8-in-1", "japanese-4-in-1", "japanese-6-in-1")],
)
def test_rows_are_answers_and_no_load_does_more_work(name, thinner):
    """Of every weave from near its jamming to a third of its thickest wire, and loads every 15 degrees."""
    weave = WEAVES[name]
    cell = Cell(5.0, 5.0 / (thinner * weave.jamming_ratio), weave)
    table = solve_table(cell, grid(15.0, weave))
    assert table.converged.all(), table.status
    S = table.S / trace(table.S)[:, None]
    works = (S * WEIGHT) @ table.E.T
    own = np.diagonal(works)
    assert (works - own[:, None]).max() < 1e-8
    rows = np.linspace(0, len(S) - 1, 9).astype(int)
    assert (support(cell, S[rows]).h - own[rows]).max() < 1e-8
