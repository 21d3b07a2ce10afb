"""macro_fem: `python -m benchmarks.sheet.ours N [tangent|extrapolate] [cholmod|superlu|multigrid]`."""

import json
import sys
import time

start = time.perf_counter()

import numpy as np  # noqa: E402
import skfem  # noqa: E402

from macro_fem.assembly import discretize  # noqa: E402
from macro_fem.linear import LinearOptions  # noqa: E402
from macro_fem.materials import NeoHookeanSheet  # noqa: E402
from macro_fem.newton import LoadStep, Membrane, NewtonOptions, solve  # noqa: E402


def main(n: int, predictor: str, method: str) -> None:
    """Clamped unit square, N x N Q1, stretched to 1.5 in ten steps."""
    loaded = time.perf_counter()
    ticks = np.linspace(0.0, 1.0, n + 1)
    disc = discretize(skfem.MeshQuad.init_tensor(ticks, ticks), "Q1")
    x = disc.nodes[:, 0]
    fixed = np.repeat(((x == 0.0) | (x == 1.0))[:, None], 2, axis=1)
    displacement = np.zeros((disc.n_nodes, 2))
    displacement[x == 1.0, 0] = 0.5
    sheet = Membrane(disc, NeoHookeanSheet(mu=1.0), fixed, displacement, np.zeros_like(displacement))
    ready = time.perf_counter()
    options = NewtonOptions(
        rtol=1e-9, predictor_order=0 if predictor == "tangent" else 3, linear=LinearOptions(method=method)
    )
    solution = solve(sheet, options, steps=[LoadStep(displacement=k / 10) for k in range(1, 11)])
    done = time.perf_counter()
    statistics = solution.statistics
    answer = {
        "version": f"this tree, scikit-fem {skfem.__version__}",
        "ok": solution.status.name == "CONVERGED",
        "reaction": float(solution.reactions[x == 1.0, 0].sum()),
        "iterations": statistics.iterations,
        "factorizations": statistics.factorizations,
        "import_s": loaded - start,
        "setup_s": ready - loaded,
        "solve_s": done - ready,
        "note": f"assembly {statistics.assembly_s:.2f} s, linear {statistics.linear_s:.2f} s",
    }
    print(json.dumps(answer))


if __name__ == "__main__":
    main(int(sys.argv[1]), *(sys.argv[2:] + ["extrapolate", "auto"][len(sys.argv) - 2 :]))
