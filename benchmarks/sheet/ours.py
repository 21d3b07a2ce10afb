"""macro_fem: option [auto|cholmod|superlu]."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import skfem

from homogenize import Response
from macro_fem.fem.discretization import discretize
from macro_fem.fem.membrane import evaluate
from macro_fem.fem.supported import SupportedFem
from macro_fem.solvers.newton import NewtonOptions, solve
from rve.common.types import Array


@dataclass(frozen=True)
class NeoHookeanSheet:
    """Incompressible neo-Hookean sheet in plane stress, W = mu/2 (tr C + 1/det C - 3) with C = I + 2E.

    mu: shear modulus times thickness, N/mm. The law resists compression, so its energy is not convex in the
    displacement: Newton finds a stationary state near its start.

    >>> law = NeoHookeanSheet(mu=2.0)
    >>> stretch = 1.5
    >>> E = 0.5 * np.array([[stretch**2 - 1.0, 0.0, 1.0 / stretch - 1.0]])  # free to contract
    >>> S = law.response(E).S[0]
    >>> bool(np.isclose(S[0] * stretch, 2.0 * (stretch - stretch**-2))), bool(abs(S[2]) < 1e-12)
    (True, True)
    """

    mu: float = 1.0

    def response(self, E: Array) -> Response:
        """S = mu (I - C^-1 / det C) and its derivative, in components of the cofactor of C."""
        a, b, c = 1.0 + 2.0 * E[:, 0], 2.0 * E[:, 1], 1.0 + 2.0 * E[:, 2]
        inverse = 1.0 / (a * c - b * b)
        once = self.mu * inverse * inverse
        four = 4.0 * once * inverse
        S = np.empty((3, len(a)))
        np.subtract(self.mu, once * c, out=S[0])
        np.multiply(once, b, out=S[1])
        np.subtract(self.mu, once * a, out=S[2])
        # d(det C) = (c, -2b, a) . dC for dC = 2 dE; S = mu (1, 0, 1) - once (c, -b, a).
        C = np.empty((3, 3, len(a)))
        fa, fb, fc = four * a, four * b, four * c
        np.multiply(fc, c, out=C[0, 0])
        np.multiply(fa, a, out=C[2, 2])
        np.multiply(fa, c, out=C[0, 2])
        C[0, 2] -= 2.0 * once
        C[2, 0] = C[0, 2]
        np.multiply(fc, -b, out=C[1, 0])
        np.multiply(fa, -b, out=C[1, 2])
        np.multiply(C[1, 0], 2.0, out=C[0, 1])
        np.multiply(C[1, 2], 2.0, out=C[2, 1])
        np.multiply(fb, 2.0 * b, out=C[1, 1])
        C[1, 1] += 2.0 * once
        energy = (0.5 * self.mu) * (a + c + inverse - 3.0)
        return Response(energy, S.T, np.moveaxis(C, -1, 0), E)


def clamped_sheet(n: int, method: str) -> tuple[SupportedFem, Array]:
    """Unit square, n x n Q1, clamped left and right; the displacement (n_nodes, 2) of an even stretch by 1."""
    ticks = np.linspace(0.0, 1.0, n + 1)
    disc = discretize(skfem.MeshQuad.init_tensor(ticks, ticks), "Q1")
    x = disc.nodes[:, 0]
    free = np.repeat((x > 0.0) & (x < 1.0), 2)
    return SupportedFem(disc, np.zeros_like(disc.nodes), free, method=method), np.outer(x, [1.0, 0.0])


def stretched(fem: SupportedFem, even: Array, pull: float) -> SupportedFem:
    """The sheet with its right edge moved by `pull`."""
    return fem.moved(np.where(fem.held, fem.reference + pull * even, 0.0))


def run(n: int, method: str = "auto") -> Iterator[dict[str, Any]]:
    """Stretched to 1.5 in ten steps, each from the last two answers extrapolated."""
    fem, even = clamped_sheet(n, method)
    law, iterations, factorizations = NeoHookeanSheet(mu=1.0), 0, 0
    u, start = 0.0 * even, even / 20
    yield {}
    for k in range(1, 11):
        one = stretched(fem, even, k / 20)
        found = solve(one, law, 0.0 * even, start, NewtonOptions(rtol=1e-9))
        u, start = found.u, 2.0 * found.u - u
        iterations += len(found.history)
        factorizations += sum(line.factorizations for line in found.history)
        if found.stop != "closed":
            break
    yield {}
    yield {
        "version": f"this tree, scikit-fem {skfem.__version__}",
        "ok": found.stop == "closed",
        "reaction": float(evaluate(fem.disc, law, u).internal[even[:, 0] == 1.0, 0].sum()),
        "iterations": iterations,
        "factorizations": factorizations,
        "note": "",
    }
