"""Arrays of a mesh against scikit-fem's own forms and against plain sums over points."""

import numpy as np
import pytest
import skfem
from skfem.helpers import dot, grad

from macro_fem.fem import ELEMENTS, SparsityPattern, discretize, gradient, internal_force, load_vector, stiffness


def distorted(n=4, amount=0.03, seed=0):
    mesh = skfem.MeshTri.init_tensor(np.linspace(0, 2, n + 1), np.linspace(0, 1, n))
    shift = amount * np.random.default_rng(seed).standard_normal(mesh.p.shape)
    return type(mesh)(mesh.p + shift, mesh.t)


def symmetric_tangents(rng, n, d):
    R = rng.standard_normal((n, 2 * d, 2 * d))
    return (R + R.swapaxes(1, 2)).reshape(n, d, 2, d, 2)


def plain_stiffness(disc, A):
    """sum_p w B^T A B as a dense matrix, point by point: slow and without any of the module's tricks."""
    d = A.shape[1]
    K = np.zeros((disc.n_nodes * d,) * 2)
    for p in range(disc.n_points):
        g, nodes = disc.grad[p], disc.cell_dofs[p % disc.n_cells]
        block = disc.weight[p] * np.einsum("aj,ijkl,bl->aibk", g, A[p], g).reshape(len(nodes) * d, -1)
        rows = (nodes[:, None] * d + np.arange(d)).ravel()
        K[np.ix_(rows, rows)] += block
    return K


@pytest.mark.parametrize("element", ELEMENTS)
def test_gradients_and_loads_are_those_of_scikit_fem(element, monkeypatch):
    mesh = distorted()
    disc = discretize(mesh, element)
    basis = skfem.Basis(mesh, ELEMENTS[element][0](), intorder=4)
    v = np.random.default_rng(1).standard_normal(disc.n_nodes)
    # Same degrees of freedom: the mass and gradient integrals agree at the order that is exact for both.
    monkeypatch.setitem(ELEMENTS, element, (ELEMENTS[element][0], 4))
    fine = discretize(mesh, element)
    energy = float(fine.weight @ (gradient(fine, v[:, None]) ** 2).sum(axis=(1, 2)))
    K = skfem.BilinearForm(lambda u, w, _: dot(grad(u), grad(w))).assemble(basis)
    assert energy == pytest.approx(float(v @ (K @ v)), rel=1e-12)
    f = skfem.LinearForm(lambda w, _: w).assemble(basis)
    np.testing.assert_allclose(load_vector(disc, np.array([1.0, -2.0])), np.outer(f, [1.0, -2.0]), atol=1e-14)
    by_place = skfem.LinearForm(lambda w, at: at.x[0] * w).assemble(basis)
    np.testing.assert_allclose(load_vector(fine, fine.points[:, :1])[:, 0], by_place, atol=1e-14)


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("d", [2, 3])
def test_forces_and_stiffness_are_plain_sums(element, d):
    rng = np.random.default_rng(2)
    disc = discretize(distorted(), element)
    P = rng.standard_normal((disc.n_points, d, 2))
    f = np.zeros((disc.n_nodes, d))
    np.add.at(f, np.tile(disc.cell_dofs, (disc.n_quad, 1)), np.einsum("p,pij,paj->pai", disc.weight, P, disc.grad))
    np.testing.assert_allclose(internal_force(disc, P), f, atol=1e-13)
    A = symmetric_tangents(rng, disc.n_points, d)
    K = plain_stiffness(disc, A)
    free = rng.random((disc.n_nodes, d)) < 0.7
    pattern = SparsityPattern.of(disc, d, free)
    found = stiffness(disc, pattern, A).toarray()
    np.testing.assert_allclose(found, K[np.ix_(free.ravel(), free.ravel())], atol=1e-12)


@pytest.mark.parametrize("element", ELEMENTS)
def test_affine_fields_are_exact_on_distorted_cells(element):
    disc = discretize(distorted(), element)
    H = np.array([[0.3, -0.2], [0.1, 0.4], [0.7, -0.5]])
    u = disc.nodes @ H.T + np.array([1.0, -2.0, 3.0])
    np.testing.assert_allclose(gradient(disc, u), np.broadcast_to(H, (disc.n_points, 3, 2)), atol=1e-12)
    np.testing.assert_allclose(disc.cell_mean(gradient(disc, u)), np.broadcast_to(H, (disc.n_cells, 3, 2)), atol=1e-12)
