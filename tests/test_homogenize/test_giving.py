"""Rings that give by direction: one convex energy, its stress and tangent, and the compliance of the rows."""

from dataclasses import replace

import numpy as np
import pytest

from homogenize import default_law, elastic_law
from homogenize.fitting import stiffness_by_direction
from homogenize.laws import constant_compliance, giving_law, work_along
from rve.common import WEIGHT, double_dot, eigenvalues, trace

LAW = default_law()
GIVING = giving_law(LAW)


def strains(n, seed):
    """Strains around and well beyond locking, (n, 3)."""
    return np.random.default_rng(seed).normal(size=(n, 3)) * 0.1 + np.array([0.15, 0.0, 0.15])


def test_stress_is_the_slope_of_the_energy_and_the_tangent_that_of_the_stress():
    E, step = strains(300, 1), 1e-6
    found = GIVING.response(E)
    assert (found.energy > 0.0).mean() > 0.8
    errors = []
    for k in range(3):
        up, down = (GIVING.response(E + sign * step * np.eye(3)[k]) for sign in (1.0, -1.0))
        slope = (up.energy - down.energy) / (2.0 * step) / WEIGHT[k]
        assert slope == pytest.approx(found.S[:, k], abs=1e-7 * np.abs(found.S).max())
        errors.append(np.abs((up.S - down.S) / (2.0 * step) - found.C[:, :, k]).max(axis=1))
    assert np.quantile(errors, 0.98) < 1e-6 * np.abs(found.C).max()  # kinks of the tangent lie between some


def test_the_energy_is_least_under_the_half_spaces():
    """The strain E* is inside what tau widens, and energy = (E - E*):D0^-1:(E - E*)/2 + tau^2/2."""
    E = strains(300, 2)
    found = GIVING.response(E)
    floor = 0.5 * double_dot(found.S, E - found.E_star)
    tau = np.sqrt(np.maximum(2.0 * (found.energy - floor), 0.0))
    assert GIVING.cut(np.column_stack([found.E_star, tau])).violation.max() < 1e-7
    assert E - found.E_star == pytest.approx(found.S @ GIVING.compliance.T, abs=1e-12)
    i, size = trace(found.S).argmax(), trace(found.S).max()  # the largest load, under which locked strains widen far
    both = size * LAW.support(found.S / size) + 0.5 * size**2 * GIVING.compliance_along(found.S / size, size)
    assert both[i] == pytest.approx(double_dot(found.S[i], E[i]) - found.energy[i], rel=1e-4)


def test_it_is_convex_monotone_and_tensile():
    E, other = strains(1000, 3), strains(1000, 4)
    one, two, middle = (GIVING.response(X) for X in (E, other, 0.5 * (E + other)))
    scale = one.energy.max()
    assert (0.5 * (one.energy + two.energy) - middle.energy).min() > -1e-12 * scale
    assert double_dot(one.S - two.S, E - other).min() > -1e-12 * scale
    assert eigenvalues(one.S)[0].min() > -1e-12 * np.abs(one.S).max()


@pytest.mark.slow
def test_rows_are_met_along_their_loads_where_one_compliance_is_far_off():
    known = LAW.strength.stretched
    for size in (0.1, 1.0, 3.0):
        share = GIVING.compliance_along(known.S, size) / known.compliance
        assert share.max() < 1.0 + 1e-6  # the convex energy is nowhere softer than the rows
        assert share.min() > 0.85
        assert np.median(share) > 0.99
    constant = work_along(known.S, constant_compliance(known.S, known.compliance, True)) / known.compliance
    assert constant.min() < 0.15
    assert constant.max() > 1.3
    assert "at 1 N/mm" in stiffness_by_direction(LAW)


def test_one_compliance_for_all_is_met_by_the_rows():
    A = np.array([[3e-3, 0.0, -1e-3], [0.0, 4e-3, 0.0], [-1e-3, 0.0, 2e-3]]) / WEIGHT[:, None]
    strength = replace(LAW.strength, compliance=work_along(LAW.strength.S, A))
    found = giving_law(replace(LAW, strength=strength))
    assert (found.compliance_along(strength.S, 1.0) / strength.compliance).min() > 0.98
    part = (found.compliance / np.where(A == 0.0, 1.0, A))[A != 0.0]
    assert part == pytest.approx(np.full(5, part[0]), rel=1e-9)
    assert 0.8 < part[0] <= 0.9 + 1e-9  # lowered by what is interpolated between rows


def test_laws_without_strength_keep_their_stiffness():
    plain = replace(LAW, strength=None)
    assert elastic_law(plain) is plain
    assert stiffness_by_direction(plain) is None
