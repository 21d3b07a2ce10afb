"""felupe, driven through its public classes."""

import felupe
import numpy as np


def stress(x, **kwargs):
    """P = F - J^-2 F^-T; felupe puts points and cells on the last axes."""
    F, state = x[0], x[-1]
    J, H = _determinant_and_inverse_transpose(F)
    return [F - H / J**2, state]


def elasticity(x, **kwargs):
    """dP/dF."""
    J, H = _determinant_and_inverse_transpose(x[0])
    identity = np.einsum("ik,jl->ijkl", np.eye(2), np.eye(2))[..., None, None]
    outer = 2.0 * np.einsum("ij...,kl...->ijkl...", H, H) + np.einsum("il...,kj...->ijkl...", H, H)
    return [identity + outer / J**2]


def _determinant_and_inverse_transpose(F):
    J = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]
    return J, np.array([[F[1, 1], -F[1, 0]], [-F[0, 1], F[0, 0]]]) / J


def run(n):
    """Clamped unit square, N x N Q1, stretched to 1.5 in ten steps."""
    mesh = felupe.Rectangle(n=n + 1)
    field = felupe.FieldContainer([felupe.Field(felupe.RegionQuad(mesh), dim=2)])
    sheet = felupe.SolidBody(felupe.Material(stress=stress, elasticity=elasticity), field)
    supports = {
        "left": felupe.Boundary(field[0], fx=0),
        "right": felupe.Boundary(field[0], fx=1, skip=(1, 0)),
        "pull": felupe.Boundary(field[0], fx=1, skip=(0, 1)),
    }
    step = felupe.Step(items=[sheet], ramp={supports["pull"]: 0.05 * np.arange(1, 11)}, boundaries=supports)
    counts = []
    job = felupe.Job(steps=[step], plugins=[lambda context, _: counts.append(context.substep.iterations)])
    yield {}
    job.evaluate(verbose=0, tol=1e-9)
    yield {}
    force = sheet.results.force.toarray().reshape(-1, 2)
    yield {
        "version": f"felupe {felupe.__version__}",
        "ok": len(counts) == 10,
        "reaction": float(force[mesh.points[:, 0] == 1.0, 0].sum()),
        "iterations": int(sum(counts)),
        "factorizations": int(sum(counts)),
        "note": "its default solver (scipy spsolve)",
    }
