"""Derivative chains of the reference laws and of the membrane's potential; invariances; convexity."""

import numpy as np
import pytest
import skfem

from benchmarks.sheet.ours import NeoHookeanSheet
from homogenize.laws.net import diagonal_net
from macro_fem.fem.assembly import gradient, stiffness
from macro_fem.fem.discretization import discretize
from macro_fem.fem.membrane import evaluate, first_piola, green_strain, tangent
from macro_fem.fem.sparsity import sparsity
from tests.test_macro_fem.sheets import TensionFieldSheet

WEIGHT = np.array([1.0, 2.0, 1.0])
LAWS = {
    "neo-Hookean": NeoHookeanSheet(mu=1.3),
    "tension field": TensionFieldSheet(young=2.0, poisson=0.3),
    "net": diagonal_net(limit=1.05, stiffness=3.0),
}


def strains(law, n=400, seed=0):
    """Random strains away from the kinks of the law, in all of its states."""
    rng = np.random.default_rng(seed)
    F = np.eye(2) + 0.35 * rng.standard_normal((n, 2, 2))
    F = F[np.linalg.det(F) > 0.3]
    E = green_strain(F - np.eye(2))
    step = 1e-4 * rng.standard_normal((8, 1, 3))
    states = np.stack([np.sign(law.response(E + s).C).sum(axis=(1, 2)) for s in step])
    return E[np.ptp(states, axis=0) == 0]


@pytest.mark.parametrize("name", LAWS)
def test_stress_is_the_slope_of_energy_and_tangent_that_of_stress(name):
    law = LAWS[name]
    E = strains(law)
    assert len(E) > 150
    response = law.response(E)
    h = 1e-5
    for k in range(3):
        dE = h * np.eye(3)[k]
        up, down = law.response(E + dE), law.response(E - dE)
        slope = (up.energy - down.energy) / (2 * h)
        size = 1.0 + np.abs(response.C).max(axis=(1, 2))
        assert np.all(np.abs(slope - WEIGHT[k] * response.S[:, k]) < 1e-7 * size)
        bend = (up.S - down.S) / (2 * h)
        assert np.all(np.abs(bend - response.C[:, :, k]).max(axis=1) < 1e-5 * size)
    # d2 Psi is symmetric: W C with W the weights of the product.
    np.testing.assert_allclose(WEIGHT[:, None] * response.C, (WEIGHT[:, None] * response.C).swapaxes(1, 2), atol=1e-12)


def test_neo_hookean_by_complex_step():
    """S = dW/dE to machine precision, with the energy written out anew."""
    mu, h = 1.3, 1e-30
    E = strains(NeoHookeanSheet(mu))
    for k in range(3):
        a, b, c = (E + 1j * h * np.eye(3)[k]).T
        C11, C12, C22 = 1 + 2 * a, 2 * b, 1 + 2 * c
        W = mu / 2 * (C11 + C22 + 1 / (C11 * C22 - C12**2) - 3)
        S = NeoHookeanSheet(mu).response(E).S[:, k]
        np.testing.assert_allclose(WEIGHT[k] * S, W.imag / h, rtol=1e-12, atol=1e-12)


def test_tension_field_is_the_relaxed_sheet():
    """Psi(E) = min over W >= 0 (a wrinkle strain) of the plane-stress energy at E + W, by brute force."""
    young, nu = 2.0, 0.3
    D = young / (1 - nu**2) * np.array([[1, 0, nu], [0, 1 - nu, 0], [nu, 0, 1]])
    grid = np.linspace(0.0, 2.0, 401)
    for e1, e2 in ((0.4, 0.1), (0.4, -0.3), (-0.1, -0.5), (0.4, -0.1199), (0.4, -0.1201)):
        stored = TensionFieldSheet(young, nu).response(np.array([[e1, 0.0, e2]])).energy[0]
        a, b = np.meshgrid(e1 + grid, e2 + grid, indexing="ij")
        brute = (0.5 * (D[0, 0] * (a**2 + b**2) + 2 * D[0, 2] * a * b)).min()
        assert brute - 1e-4 < stored <= brute + 1e-14
    turned = TensionFieldSheet(young, nu).response(np.array([[0.05, 0.35, 0.05]]))  # e = 0.4, -0.3 at 45 degrees
    assert turned.energy[0] == pytest.approx(0.5 * young * 0.4**2, rel=1e-14)
    np.testing.assert_allclose(turned.S[0], young * 0.4 * np.array([0.5, 0.5, 0.5]), rtol=1e-14)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("d", [2, 3])
def test_point_tangent_is_the_slope_of_first_piola(name, d):
    law = LAWS[name]
    E = strains(law, n=200)
    rng = np.random.default_rng(5)
    C = np.stack([1 + 2 * E[:, 0], 2 * E[:, 1], 2 * E[:, 1], 1 + 2 * E[:, 2]], axis=-1).reshape(-1, 2, 2)
    root = np.linalg.cholesky(C).swapaxes(1, 2)  # F with F^T F = C, then any rotation in d dimensions
    Q, _ = np.linalg.qr(rng.standard_normal((len(E), d, d)))
    F = Q[:, :, :2] @ root
    response = law.response(E)
    A = tangent(F, response.S, response.C)
    for i, k in zip(*np.triu_indices(d, 1), strict=True):  # the blocks above the diagonal follow by symmetry
        A[:, i, :, k, :] = A[:, k, :, i, :].swapaxes(1, 2)
    psi = lambda F: law.response(green_strain(F - np.eye(d)[:, :2]))  # noqa: E731
    h = 1e-6
    size = 1.0 + np.abs(response.C).max(axis=(1, 2))
    for i, j in np.ndindex(d, 2):
        dF = np.zeros((d, 2))
        dF[i, j] = h
        up, down = psi(F + dF), psi(F - dF)
        P = first_piola(F, response.S)[:, i, j]
        assert np.all(np.abs((up.energy - down.energy) / (2 * h) - P) < 1e-6 * size)
        slope = (first_piola(F + dF, up.S) - first_piola(F - dF, down.S)) / (2 * h)
        assert np.all(np.abs(slope - A[:, :, :, i, j]).max(axis=(1, 2)) < 1e-5 * size)


@pytest.mark.parametrize("element", ["P1", "P2", "CR", "Q1", "Q2"])
@pytest.mark.parametrize("d", [2, 3])
def test_matrix_is_the_slope_of_forces_and_forces_that_of_energy(element, d):
    mesh_type = skfem.MeshQuad if element[0] == "Q" else skfem.MeshTri
    mesh = mesh_type.init_tensor(np.linspace(0, 1, 4), np.linspace(0, 1, 3))
    rng = np.random.default_rng(6)
    disc = discretize(type(mesh)(mesh.p + 0.03 * rng.standard_normal(mesh.p.shape), mesh.t), element)
    law = NeoHookeanSheet(mu=2.0)
    u = 0.01 * rng.standard_normal((disc.n_nodes, d))
    v = rng.standard_normal((disc.n_nodes, d))
    state = evaluate(disc, law, u)
    pattern = sparsity(disc, d, np.ones(disc.n_nodes, dtype=bool))
    K = pattern.full(stiffness(disc, pattern, tangent(state.F, state.response.S, state.response.C)))
    h = 1e-6
    up, down = evaluate(disc, law, u + h * v), evaluate(disc, law, u - h * v)
    assert (up.stored - down.stored) / (2 * h) == pytest.approx((state.internal * v).sum(), rel=1e-7)
    slope = (up.internal - down.internal).ravel() / (2 * h)
    np.testing.assert_allclose(K @ v.ravel(), slope, atol=1e-7 * np.abs(slope).max())


@pytest.mark.parametrize("d", [2, 3])
def test_rigid_motion_stores_nothing_and_turns_the_forces(d):
    disc = discretize(skfem.MeshTri().refined(2), "P2")
    rng = np.random.default_rng(7)
    law = NeoHookeanSheet()
    Q, _ = np.linalg.qr(rng.standard_normal((d, d)))
    X = np.zeros((disc.n_nodes, d))
    X[:, :2] = disc.nodes
    rigid = X @ Q.T + rng.standard_normal(d) - X
    assert abs(evaluate(disc, law, rigid).stored) < 1e-25
    assert np.abs(evaluate(disc, law, rigid).internal).max() < 1e-12
    u = 0.02 * rng.standard_normal((disc.n_nodes, d))  # strains of 0.5 and more; larger ones turn triangles inside out
    turned = (X + u) @ Q.T - X
    before, after = evaluate(disc, law, u), evaluate(disc, law, turned)
    assert after.stored == pytest.approx(before.stored, rel=1e-12)
    np.testing.assert_allclose(after.internal, before.internal @ Q.T, atol=1e-12)


@pytest.mark.parametrize("name", ["tension field", "net"])
def test_tensile_laws_are_convex_in_the_displacement(name):
    """psi(F) midway between any two gradients lies below the mean, in the plane and in space, slack states included."""
    law = LAWS[name]
    rng = np.random.default_rng(8)
    for d in (2, 3):
        F, G = rng.standard_normal((2, 3000, d, 2))
        psi = lambda F, d=d: law.response(green_strain(F - np.eye(d)[:, :2])).energy  # noqa: E731
        middle, mean = psi(0.5 * (F + G)), 0.5 * (psi(F) + psi(G))
        assert np.all(middle <= mean + 1e-12 * (1 + mean))
        assert np.mean(middle < mean - 1e-3) > 0.3  # and it is not zero everywhere
    neo = NeoHookeanSheet()
    F, G = np.array([[[1.0, 0], [0, 1.0]]]), np.array([[[-1.0, 0], [0, -1.0]]])
    psi = lambda F: neo.response(green_strain(F - np.eye(2))).energy  # noqa: E731
    assert psi(0.5 * (F + G) + 1e-3 * np.eye(2)) > 0.5 * (psi(F) + psi(G))  # the gate sees a law that is not


def test_small_strains_do_not_cancel():
    G = 1e-12 * np.array([[[1.0, 0.5], [0.25, -2.0]]])
    np.testing.assert_allclose(green_strain(G)[0], 1e-12 * np.array([1.0, 0.375, -2.0]), rtol=1e-11)


def test_a_gradient_is_linear():
    disc = discretize(skfem.MeshTri().refined(1), "P2")
    u, v = np.random.default_rng(9).standard_normal((2, disc.n_nodes, 3))
    np.testing.assert_allclose(gradient(disc, u + 2 * v), gradient(disc, u) + 2 * gradient(disc, v), atol=1e-12)
