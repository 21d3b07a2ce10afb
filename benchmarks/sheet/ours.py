"""macro_fem: options [tangent|extrapolate] [cholmod|superlu|multigrid]."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import skfem

from macro_fem.fem.assembly import discretize
from macro_fem.fem.linear import LinearOptions
from macro_fem.fem.materials import NeoHookeanSheet
from macro_fem.solvers.newton import LoadStep, Membrane, NewtonOptions, solve


def clamped_sheet(n: int, pull: float) -> tuple[Membrane, np.ndarray]:
    """Unit square, n x n Q1, clamped left and right, its right edge pulled; flags of the nodes there."""
    ticks = np.linspace(0.0, 1.0, n + 1)
    disc = discretize(skfem.MeshQuad.init_tensor(ticks, ticks), "Q1")
    x = disc.nodes[:, 0]
    fixed = np.repeat(((x == 0.0) | (x == 1.0))[:, None], 2, axis=1)
    displacement = np.outer(x == 1.0, [pull, 0.0])
    return Membrane(disc, NeoHookeanSheet(mu=1.0), fixed, displacement, 0.0 * displacement), x == 1.0


def run(n: int, predictor: str = "extrapolate", method: str = "auto") -> Iterator[dict[str, Any]]:
    """Stretched to 1.5 in ten steps."""
    sheet, pulled = clamped_sheet(n, 0.5)
    yield {}
    order, linear = 0 if predictor == "tangent" else 3, LinearOptions(method=method)
    options = NewtonOptions(rtol=1e-9, predictor_order=order, linear=linear)
    solution = solve(sheet, options, steps=[LoadStep(displacement=k / 10) for k in range(1, 11)])
    yield {}
    statistics = solution.statistics
    yield {
        "version": f"this tree, scikit-fem {skfem.__version__}",
        "ok": solution.status.name == "CONVERGED",
        "reaction": float(solution.reactions[pulled, 0].sum()),
        "iterations": statistics.iterations,
        "factorizations": statistics.factorizations,
        "note": f"assembly {statistics.assembly_s:.2f} s, linear {statistics.linear_s:.2f} s",
    }
