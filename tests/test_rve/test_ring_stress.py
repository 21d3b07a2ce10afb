"""First yield of single rings: the stress in the skin against the section forces it stands for, and its peak."""

import numpy as np
import pytest

from rve.wire import Ring, internal_forces, peak_stress, skin_stress

from .frame import random_load

RING = Ring(5.0, 0.8, 200e3, 0.3)


def test_stresses_of_all_fibres_add_up_to_the_section_forces():
    """Plane sections of a ring: 1 and 1/r in the plane, z/r out of it, in amounts that make N, M_z or M_r two."""
    r1, r2 = 5.0, 0.8
    rho, w = np.polynomial.legendre.leggauss(30)
    rho, w = 0.5 * r2 * (rho + 1.0), 0.5 * r2 * w
    psi = 2.0 * np.pi * np.arange(64) / 64
    dA = (w * rho)[:, None] * 2.0 * np.pi / 64

    def shapes(rho):
        x, z = rho * np.cos(psi), rho * np.sin(psi)
        return np.stack([np.ones_like(x), r1 / (r1 + x), z / (r1 + x)]), x, z

    inside, x, z = shapes(rho[:, None])
    resultants = np.array([np.sum(dA * inside * arm, axis=(1, 2)) for arm in (1.0, -z, x)])
    skin, _, _ = shapes(r2)
    for row, name in enumerate((1, 3, 5)):
        amounts = np.linalg.solve(resultants, 2.0 * np.eye(3)[row])
        q = 2.0 * np.eye(6)[name]
        assert skin_stress(q, psi, r1, r2) == pytest.approx(np.abs(amounts @ skin), rel=1e-9, abs=1e-12)


def test_the_inside_of_thick_wire_is_stressed_more():
    q = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    inside, outside = skin_stress(q, np.array([np.pi, 0.0]), 5.0, 0.8)
    straight = 4.0 / (np.pi * 0.8**3)
    assert inside > 1.1 * straight > straight > outside
    # Timoshenko's correction for a round section at R/r2 = 6.25: 1 + 3/4 (r2/R) + ... inside
    assert inside / straight == pytest.approx(1.0 + 0.75 * 0.16 + 0.625 * 0.16**2, rel=5e-3)


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_the_peak_is_that_of_a_much_finer_search(seed):
    phi, forces = random_load(seed)
    peak, angle, skin = peak_stress(phi, forces, RING)
    at = np.concatenate([np.linspace(0.0, 2.0 * np.pi, 3000), phi, phi - 1e-9])
    q = internal_forces(phi, forces, at, RING.curved())
    fibre = np.linspace(0.0, 2.0 * np.pi, 720)
    stress = skin_stress(q[:, None], fibre, 5.0, 0.8)
    assert peak >= stress.max() * (1.0 - 1e-6)
    assert peak == pytest.approx(stress.max(), rel=1e-4)
    there = internal_forces(phi, forces, angle[None], RING.curved())
    assert skin_stress(there[0], skin, 5.0, 0.8) == pytest.approx(peak, rel=1e-12)


def test_the_peak_of_a_butted_ring_is_where_it_is_said_to_be():
    phi, forces = random_load(5)
    peaks = []
    for joint in np.array([0.0, 1.0, 2.0, 4.0]):
        peak, angle, fibre = peak_stress(phi, forces, RING, joint)
        q = internal_forces(phi, forces, angle[None], RING.curved(), joint)
        assert skin_stress(q[0], fibre, 5.0, 0.8) == pytest.approx(peak, rel=1e-12)
        peaks.append(peak)
    assert max(peaks) > peak_stress(phi, forces, RING)[0]


def test_joints_between_two_neighbouring_contacts_are_the_same_joint():
    """Free ends carry no load: the wire between the joint and the next contact is unloaded wherever the joint is."""
    phi, forces = random_load(3)
    start, end = np.sort(phi)[2:4]
    joints = start + np.array([0.1, 0.5, 0.9]) * (end - start)
    stress = [peak_stress(phi[None], forces[None], RING, joint=np.array([x]))[0][0] for x in joints]
    np.testing.assert_allclose(stress, stress[0], rtol=1e-5)
    other = peak_stress(phi[None], forces[None], RING, joint=np.array([end + 0.01]))[0][0]
    assert other != pytest.approx(stress[0], rel=1e-3)


def test_stress_follows_force_and_size():
    phi, forces = random_load(6)
    one = peak_stress(phi, forces, RING)[0]
    assert peak_stress(phi, 3.0 * forces, RING)[0] == pytest.approx(3.0 * one, rel=1e-12)
    assert peak_stress(phi, forces, Ring(10.0, 1.6, 70e3, 0.3))[0] == pytest.approx(one / 4.0, rel=1e-9)
