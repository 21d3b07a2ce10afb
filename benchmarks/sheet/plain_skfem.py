"""scikit-fem as in its examples, forms assembled anew: option [superlu|cholmod]."""

import numpy as np
import skfem
from scipy.sparse.linalg import splu
from skfem.helpers import ddot, eye, grad, inv, mul, trace, transpose


@skfem.LinearForm
def residual(v, w):
    """P : grad v with P = F - J^-2 F^-T."""
    F = grad(w["u"]) + eye(1.0 + 0.0 * w.x[0], 2)
    J = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]
    return ddot(F - transpose(inv(F)) / J**2, grad(v))


@skfem.BilinearForm
def stiffness(u, v, w):
    """dP : grad v with dP = dF + J^-2 (2 (F^-1 : dF^T) F^-T + (F^-1 dF F^-1)^T)."""
    F = grad(w["u"]) + eye(1.0 + 0.0 * w.x[0], 2)
    J = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]
    G = inv(F)
    GdF = mul(G, grad(u))
    return ddot(grad(u) + (2.0 * trace(GdF) * transpose(G) + transpose(mul(GdF, G))) / J**2, grad(v))


def run(n, factor="superlu"):
    """Clamped unit square, N x N Q1, stretched to 1.5 in ten steps."""
    ticks = np.linspace(0.0, 1.0, n + 1)
    basis = skfem.Basis(skfem.MeshQuad.init_tensor(ticks, ticks), skfem.ElementVector(skfem.ElementQuad1()), intorder=3)
    left, right = basis.get_dofs(lambda x: x[0] == 0.0), basis.get_dofs(lambda x: x[0] == 1.0)
    held = np.union1d(left.all(), right.all())
    free = basis.complement_dofs(held)
    pulled = right.all("u^1")
    yield {}
    u, iterations = basis.zeros(), 0
    for step in range(1, 11):
        jump = np.zeros_like(u)
        jump[pulled] = 0.05 * step - u[pulled]
        for _ in range(20):
            field = basis.interpolate(u)
            r = residual.assemble(basis, u=field)
            if not jump.any() and np.linalg.norm(r[free]) <= 1e-9 * np.linalg.norm(r):
                break
            K = stiffness.assemble(basis, u=field)
            p = jump.copy()
            p[free] = _solve(K[free][:, free].tocsc(), -r[free] - (K @ jump)[free], factor)
            u += p
            jump[:] = 0.0
            iterations += 1
        else:
            raise RuntimeError("Newton did not converge")
    yield {}
    yield {
        "version": f"scikit-fem {skfem.__version__}",
        "ok": True,
        "reaction": float(residual.assemble(basis, u=basis.interpolate(u))[pulled].sum()),
        "iterations": iterations,
        "factorizations": iterations,
        "note": factor,
    }


def _solve(K, b, factor):
    if factor == "cholmod":
        from sksparse.cholmod import cholesky

        return cholesky(K)(b)
    options = {"SymmetricMode": True}
    return splu(K, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options).solve(b)
