"""Problems that several benchmarks share: load directions, square curtains, and how normal the rows of a table are."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rve import StrainTable
from rve.directions import product

Array = NDArray[np.float64]


def loads(step: float = 5.0, first_beta: float = 0.0) -> tuple[Array, Array]:
    """Directions alpha from 0 to 45 and beta from `first_beta` to 90 degrees, (n,) each; the paper's 190 by default."""
    return product(np.arange(0.0, 45.01, step), np.arange(first_beta, 90.01, step))


def normality(table: StrainTable) -> Array:
    """Least S_i:(E_i - E_j) over all j, for each converged row i: rows of one convex law have none below round-off."""
    S, E = table.S[table.converged], table.E[table.converged]
    return np.asarray(np.einsum("ik,ijk->ij", S * [1, 2, 1], E[:, None] - E[None]).min(axis=1))


def square(cells: int, support: str | dict[str, Any] = "corners", size: float = 1000.0, **more: Any) -> dict[str, Any]:
    """The tables of a scene: a square curtain of `size` mm; `more` adds or replaces tables."""
    kind = {"kind": support} if isinstance(support, str) else support
    return {"curtain": {"width": size, "height": size}, "mesh": {"cells": cells}, "support": kind} | more
