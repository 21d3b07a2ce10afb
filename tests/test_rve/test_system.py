"""Equilibrium equations: exact derivatives, objectivity, loads."""

import numpy as np
import pytest

from rve import WEAVES
from rve.geometry import (
    FOUR_IN_ONE,
    cauchy_line_load,
    deformation_gradient,
    find_contacts,
    green_lagrange,
    moved,
    second_pk,
    start_pose,
)
from rve.locking import Equations, lattice_load
from rve.locking.steps import carry_forces


def random_pose(weave, rng, amount=0.08):
    pose = start_pose(weave, 1)
    return moved(pose, amount * rng.uniform(-1.0, 1.0, (1, weave.coordinates)))


@pytest.mark.parametrize("name", WEAVES)
@pytest.mark.parametrize("seed", range(3))
def test_contact_part_is_the_first_and_second_derivative_of_the_gaps(name, seed):
    rng = np.random.default_rng(seed)
    equations = Equations.of(WEAVES[name], 0.05)
    pose = random_pose(WEAVES[name], rng)
    contacts = find_contacts(pose, equations.weave, equations.wire, 0.45)
    lam = np.where(contacts.present, rng.uniform(0.5, 1.5, contacts.gap.shape), 0.0)
    system = equations.assemble(pose, contacts, lam, np.zeros((1, 3)))
    np.testing.assert_allclose(system.r[0], system.G[0].T @ lam.ravel(), atol=1e-13)

    def potential(v):
        near = find_contacts(moved(pose, v[None]), equations.weave, equations.wire, 0.6)
        total = 0.0
        for p, slot in np.argwhere(contacts.present[0]):
            distance = np.linalg.norm(near.rho[0, p] - contacts.rho[0, p, slot], axis=1)
            total += lam[0, p, slot] * near.gap[0, p, np.argmin(np.where(near.present[0, p], distance, np.inf))]
        return total

    h = 2e-4 * equations.weave.radii.min() ** 0.5
    for _ in range(8):
        v = rng.normal(size=system.r.shape[1])
        v /= np.linalg.norm(v)
        f = np.array([potential(k * h * v) for k in (-2, -1, 0, 1, 2)])
        first = (f[0] - 8 * f[1] + 8 * f[3] - f[4]) / (12 * h)
        second = (-f[0] + 16 * f[1] - 30 * f[2] + 16 * f[3] - f[4]) / (12 * h**2)
        assert system.r[0] @ v == pytest.approx(first, abs=1e-8)
        assert v @ system.J[0] @ v == pytest.approx(second, abs=2e-5 * max(1.0, abs(second)))


def test_load_part_of_the_jacobian_by_differences():
    rng = np.random.default_rng(11)
    equations = Equations.of(FOUR_IN_ONE, 0.1)
    pose = random_pose(FOUR_IN_ONE, rng)
    s = cauchy_line_load([25.0], [30.0])

    def residual(v):
        there = moved(pose, np.append(v, np.zeros(6))[None])
        contacts = find_contacts(there, FOUR_IN_ONE, 0.1, 0.6)
        system = equations.assemble(there, contacts, np.zeros(contacts.gap.shape), s)
        return system.r[0, :3], system.J[0, :3, :3]

    h = 1e-6
    J = np.array([(residual(h * e)[0] - residual(-h * e)[0]) / (2 * h) for e in np.eye(3)]).T
    np.testing.assert_allclose(residual(np.zeros(3))[1], J, atol=1e-8)
    assert np.abs(J - J.T).max() > 0.1


def test_load_jacobian_and_zero_moment():
    pose = random_pose(FOUR_IN_ONE, np.random.default_rng(0))
    s = cauchy_line_load([25.0], [30.0])
    f, K = lattice_load(pose, s)
    a = np.concatenate([pose.a1, pose.a2], axis=1)[0]
    np.testing.assert_allclose(K[0] @ a, f[0], atol=1e-14)
    assert abs(a[0] * f[0, 1] - a[1] * f[0, 0] + a[2] * f[0, 3] - a[3] * f[0, 2]) < 1e-13
    # The virtual work of a uniform stretch is the line load times the area swept.
    stretched = f[0] @ a
    area = a[0] * a[3] - a[1] * a[2]
    assert stretched == pytest.approx(area * (s[0, 0] + s[0, 2]), rel=1e-12)
    assert np.abs(K[0] - K[0].T).max() > 0.1  # a following load has no potential


def test_conjugate_work_of_both_stresses():
    # s : sym(dF F^-1) J = S : dE for any increment: the definition of the second Piola-Kirchhoff line load.
    rng = np.random.default_rng(2)
    E = 0.1 * rng.normal(size=(50, 3))
    F = deformation_gradient(E)
    np.testing.assert_allclose(green_lagrange(F), E, atol=1e-14)
    s = cauchy_line_load(rng.uniform(-180, 180, 50), rng.uniform(0, 90, 50))
    S = second_pk(F, s)
    dF = rng.normal(size=F.shape)
    full = np.stack([s[:, [0, 1]], s[:, [1, 2]]], axis=1)
    velocity = dF @ np.linalg.inv(F)
    work = np.linalg.det(F) * np.einsum("nij,nij->n", full, velocity)
    dE = (green_lagrange(F + 1e-6 * dF) - green_lagrange(F - 1e-6 * dF)) / 2e-6
    np.testing.assert_allclose((S * [1, 2, 1] * dE).sum(axis=1), work, atol=1e-8)


def test_axes_of_the_load_are_exact():
    assert np.array_equal(cauchy_line_load([0, 90, 180], [0, 0, 0])[:, [0, 2]], [[1, 0], [0, 1], [1, 0]])
    one, other = cauchy_line_load([20.0], [35.0]), cauchy_line_load([110.0], [55.0])
    np.testing.assert_allclose(one, other, atol=1e-15)


def test_forces_are_handed_on_in_full():
    rng = np.random.default_rng(7)
    for _ in range(20):
        pose = random_pose(FOUR_IN_ONE, rng, 0.2)
        old = find_contacts(pose, FOUR_IN_ONE, 0.1, 0.6)
        lam = np.where(old.present, rng.uniform(0.1, 2.0, old.gap.shape), 0.0)
        new = find_contacts(moved(pose, 0.05 * rng.normal(size=(1, 9))), FOUR_IN_ONE, 0.1, 0.6)
        carried = carry_forces(old, lam, new, np.array([1e-3]))
        both = old.present.any(axis=2) & new.present.any(axis=2)
        np.testing.assert_allclose(carried.sum(axis=2)[both], lam.sum(axis=2)[both], rtol=1e-12)
