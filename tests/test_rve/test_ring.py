"""Mechanics of one ring against closed forms, quadrature and an independent frame of straight beams."""

import numpy as np
import pytest

from rve.wire import (
    Ring,
    Section,
    flexibility,
    internal_forces,
    out_of_plane_inertia,
    section_matrix,
    self_stress,
    shear_factor,
)

from .frame import frame_flexibility, local_axes, random_load

R = 7.0
EI, GJ = 3.0, 1.7
THIN = Section(R, 1.0 / EI, 1.0 / EI, 1.0 / GJ)
THICK = Ring(5.0, 1.0, 200e3, 0.3)
SECTIONS = [THICK.thin(), THICK.straight(), THICK.curved()]
OUT = np.array([1.0, 0.0, 0.0])
UP = np.array([0.0, 0.0, 1.0])


def pieces(phi, extra=(), order=12):
    """Quadrature points and weights (in angle) between the loads."""
    edges = np.sort(np.concatenate([np.mod(phi, 2.0 * np.pi), extra]))
    edges = np.append(edges, edges[0] + 2.0 * np.pi)
    x, w = np.polynomial.legendre.leggauss(order)
    half, mid = 0.5 * np.diff(edges), 0.5 * (edges[1:] + edges[:-1])
    return (mid[:, None] + half[:, None] * x).ravel(), (half[:, None] * w).ravel()


def test_two_opposed_radial_forces():
    phi = np.array([0.4, 0.4 + np.pi])
    opening = flexibility(phi, np.tile(OUT, (2, 1)), THIN).sum()
    assert opening == pytest.approx(R**3 / EI * (np.pi / 4.0 - 2.0 / np.pi), rel=1e-10)
    at = np.array([0.4, 0.4 + np.pi / 2.0])
    q = internal_forces(phi, 2.5 * np.tile(OUT, (2, 1)), at, THIN)
    assert q[:, 5] == pytest.approx([2.5 * R / np.pi, 2.5 * R * (1.0 / np.pi - 0.5)], rel=1e-10)
    assert q[1, 1] == pytest.approx(1.25, rel=1e-12)  # half of the pull in each half of the ring
    assert np.abs(q[:, 2:5]).max() == 0.0


@pytest.mark.parametrize("psi", [0.3, 1.0, np.pi / 2.0, 2.5])
def test_two_opposed_pulls_at_an_angle(psi):
    """Forces +y at psi and -y at -psi: with M = m - P R cos t + [|t| < psi] F R (cos psi - cos t), least energy gives
    the opening F R^3/(E I) (I2 - I1^2/(2 pi) - J^2/pi)."""
    c, s = np.cos(psi), np.sin(psi)
    I1, J = 2.0 * (psi * c - s), s * c - psi
    I2 = 2.0 * psi * c**2 - 3.0 * s * c + psi
    phi = np.array([psi, -psi])
    forces = np.einsum("mij,mj->mi", local_axes(phi), np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]))
    exact = R**3 / EI * (I2 - I1**2 / (2.0 * np.pi) - J**2 / np.pi)
    assert flexibility(phi, forces, THIN).sum() == pytest.approx(exact, rel=1e-10)
    at = np.array([0.1 * psi, psi, 0.5 * (psi + np.pi)])
    exact = R / np.pi * (s - psi * c + (psi - s * c) * np.cos(at))  # m - P R cos t, in units of the force
    exact += np.where(at < psi, R * (c - np.cos(at)), 0.0)
    M = internal_forces(phi, forces, at, THIN)[:, 5]
    assert np.abs(M) == pytest.approx(np.abs(exact), rel=1e-10)
    assert np.sign(M / exact) == pytest.approx(np.full(3, np.sign(M[0] / exact[0])))


def test_four_alternating_axial_forces():
    """By symmetry M_r = F R (cos t - sin t)/2 and M_t = F R (1 - sin t - cos t)/2 in each quarter."""
    phi = 0.2 + 0.5 * np.pi * np.arange(4)
    forces = np.array([1.0, -1.0, 1.0, -1.0])[:, None] * UP
    exact = R**3 * ((np.pi / 2.0 - 1.0) / EI + (np.pi - 3.0) / GJ)
    assert flexibility(phi, forces, THIN).sum() == pytest.approx(exact, rel=1e-10)
    t = np.array([0.1, 0.7, 1.3])
    q = internal_forces(phi, forces, 0.2 + t, THIN)
    assert np.abs(q[:, 3]) == pytest.approx(np.abs(R / 2.0 * (np.cos(t) - np.sin(t))), rel=1e-10)
    assert np.abs(q[:, 4]) == pytest.approx(np.abs(R / 2.0 * (1.0 - np.sin(t) - np.cos(t))), rel=1e-10)


def test_thin_wire_is_the_limit_of_thick_wire():
    phi, forces = random_load(1)
    for r2, closeness in ((0.5, 0.05), (0.05, 5e-4)):
        ring = Ring(5.0, r2, 200e3, 0.3)
        energies = [flexibility(phi, forces, s).sum() for s in (ring.thin(), ring.straight(), ring.curved())]
        assert energies[1:] == pytest.approx([energies[0]] * 2, rel=closeness)
        assert abs(energies[2] / energies[0] - 1.0) > 1e-3 * closeness


@pytest.mark.parametrize("section", SECTIONS, ids=["thin", "straight", "curved"])
def test_section_forces_balance_close_the_ring_and_store_the_energy(section):
    phi, forces = random_load(2)
    at, weight = pieces(phi)
    q, S = internal_forces(phi, forces, at, section), section_matrix(section)
    H = self_stress(at, 5.0)
    for piece in range(len(phi)):  # between loads they are a self-stress
        rows = slice(12 * piece, 12 * piece + 12)
        x = np.linalg.lstsq(H[rows].reshape(-1, 6), q[rows].ravel(), rcond=None)[0]
        assert np.abs(H[rows] @ x - q[rows]).max() < 1e-11
    gap = np.einsum("k,kia,ij,kj->a", weight, H, S, q)  # displacement and rotation between the two faces of any cut
    energy = np.einsum("k,ki,ij,kj->", weight, q, S, q) * 5.0
    assert np.abs(gap).max() < 1e-12 * energy
    assert flexibility(phi, forces, section).sum() == pytest.approx(energy, rel=1e-11)
    jump = internal_forces(phi, forces, phi, section) - internal_forces(phi, forces, phi - 1e-9, section)
    assert jump[:, :3] == pytest.approx(-forces, abs=1e-7)


@pytest.mark.parametrize("section", SECTIONS, ids=["thin", "straight", "curved"])
def test_flexibility_is_symmetric_and_positive(section):
    phi, _ = random_load(3)
    C = flexibility(np.repeat(phi, 3), np.tile(np.eye(3), (7, 1)), section)
    assert np.abs(C - C.T).max() < 1e-12 * np.abs(C).max()
    values = np.linalg.eigvalsh(C)
    assert values[0] > -1e-13 * values[-1]
    assert np.count_nonzero(values > 1e-11 * values[-1]) >= 15  # 21 forces less six balances


def test_frame_of_straight_beams_agrees():
    phi, forces = random_load(4)
    ring = Ring(5.0, 0.8, 200e3, 0.3)
    area, inertia = np.pi * 0.8**2, 0.25 * np.pi * 0.8**4
    G = ring.shear_modulus
    stiffness = (200e3 * area, 200e3 * inertia, 200e3 * inertia, 2.0 * G * inertia, shear_factor(0.3) * G * area)
    exact = flexibility(phi, forces, ring.straight()).sum()
    errors = [frame_flexibility(phi, forces, 5.0, stiffness, count).sum() / exact - 1.0 for count in (40, 120)]
    assert abs(errors[1]) < 1e-3
    assert errors[0] / errors[1] > 5.0  # second order


@pytest.mark.parametrize("section", SECTIONS, ids=["thin", "straight", "curved"])
def test_a_butted_ring_is_free_at_its_joint(section):
    phi, forces = random_load(5)
    joint = np.array(1.0)
    q = internal_forces(phi, forces, joint[None], section, joint)
    assert np.abs(q).max() < 1e-12
    at, weight = pieces(phi, extra=[1.0])
    q, S = internal_forces(phi, forces, at, section, joint), section_matrix(section)
    energy = np.einsum("k,ki,ij,kj->", weight, q, S, q) * 5.0
    assert flexibility(phi, forces, section, joint).sum() == pytest.approx(energy, rel=1e-11)
    assert energy > flexibility(phi, forces, section).sum()


def test_a_butted_ring_under_two_pulls_is_a_hook():
    """Open half-way between the pulls, one half carries all: M = F R sin t, opening pi/2 F R^3/(E I)."""
    phi = np.array([0.0, np.pi])
    found = flexibility(phi, np.tile(OUT, (2, 1)), THIN, np.array(np.pi / 2.0)).sum()
    assert found == pytest.approx(np.pi / 2.0 * R**3 / EI, rel=1e-10)
    q = internal_forces(phi, np.tile(OUT, (2, 1)), np.array([np.pi / 3.0, 1.5 * np.pi]), THIN, np.array(np.pi / 2.0))
    assert np.abs(q[:, 5]) == pytest.approx([0.0, R], abs=1e-10)


def test_numbering_rotation_mirror_and_units_change_nothing():
    phi, forces = random_load(6)
    C = flexibility(phi, forces, THICK.curved())
    order = np.random.default_rng(0).permutation(len(phi))
    assert flexibility(phi[order], forces[order], THICK.curved()) == pytest.approx(C[np.ix_(order, order)], rel=1e-12)
    assert flexibility(phi + 2.0, forces, THICK.curved()) == pytest.approx(C, rel=1e-10, abs=1e-18)
    mirrored = forces * np.array([1.0, -1.0, 1.0])
    assert flexibility(-phi, mirrored, THICK.curved()) == pytest.approx(C, rel=1e-10, abs=1e-18)
    metres = Ring(5e-3, 1e-3, 200e9, 0.3).curved()
    assert 1e3 * flexibility(phi, forces, metres) == pytest.approx(C, rel=1e-10, abs=1e-18)


def test_constants_of_the_curved_section_are_integrals_over_it():
    """Sections stay plane and fibres have the length r = R + x: E A e R and E I_r by quadrature over the disc."""
    rho, w = np.polynomial.legendre.leggauss(40)
    rho, w = 0.5 * (rho + 1.0), 0.5 * w
    psi = 2.0 * np.pi * np.arange(200) / 200
    x, z = rho[:, None] * np.cos(psi), rho[:, None] * np.sin(psi)
    dA = w[:, None] * rho[:, None] * 2.0 * np.pi / 200
    area, over_r = np.pi, np.sum(dA / (5.0 + x))
    e = 5.0 - area / over_r
    section = THICK.curved()
    assert 1.0 / section.bending == pytest.approx(200e3 * area * e * 5.0, rel=1e-10)
    assert out_of_plane_inertia(5.0, 1.0) == pytest.approx(np.sum(dA * z**2 * 5.0 / (5.0 + x)), rel=1e-10)
    assert 1.0 / section.coupling == pytest.approx(200e3 * area * 5.0, rel=1e-12)
