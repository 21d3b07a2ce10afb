"""The paper's 190 load cases, solved once for all tests."""

import numpy as np
import pytest

from rve import Cell, solve_table
from rve.directions import product


@pytest.fixture(scope="session")
def paper_table():
    """Table of the paper's grid for r1 = 5 mm, r2 = 0.5 mm."""
    return solve_table(Cell(), product(np.arange(0.0, 46.0, 5.0), np.arange(0.0, 91.0, 5.0)))


@pytest.fixture(scope="session")
def row(paper_table):
    """Row number of a load direction in the paper's table."""

    def find(alpha, beta):
        return int(np.flatnonzero((paper_table.alpha_deg == alpha) & (paper_table.beta_deg == beta))[0])

    return find
