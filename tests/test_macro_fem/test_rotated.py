"""The law of a rotated weave is the weave's own law in rotated axes: every tensor of its answers rotates."""

from dataclasses import replace

import numpy as np
import pytest

from homogenize import default_law
from macro_fem.fem import HungLaw

ANGLES = [20.0, 90.0, 135.0]


def tensors(triples):
    a, b, c = np.moveaxis(np.asarray(triples), -1, 0)
    return np.stack([np.stack([a, b], axis=-1), np.stack([b, c], axis=-1)], axis=-2)


def triples(tensor):
    return np.stack([tensor[..., 0, 0], tensor[..., 0, 1], tensor[..., 1, 1]], axis=-1)


def rotated(values, degrees):
    """Q T Q^T of triples (n, 3), Q the counterclockwise rotation."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    Q = np.array([[c, -s], [s, c]])
    return triples(Q @ tensors(values) @ Q.T)


def stiff_across():
    """The law of the rings, but stiffer along y than along x, and soft in shear."""
    return replace(default_law(), stiffness=np.diag([500.0, 100.0, 3000.0]), strength=None)


@pytest.fixture(scope="module")
def loads():
    roots = np.random.default_rng(2).normal(size=(6, 2, 2))
    return triples(roots @ roots.swapaxes(1, 2))


@pytest.mark.parametrize("angle", ANGLES)
def test_support_and_compliance_turn_with_the_weave(loads, angle):
    law, seen = stiff_across(), HungLaw.at(stiff_across(), angle)
    assert seen.support(rotated(loads, angle)) == pytest.approx(law.support(loads), rel=1e-9)
    give = loads @ law.compliance.T
    assert rotated(loads, angle) @ seen.compliance.T == pytest.approx(rotated(give, angle), abs=1e-12 * abs(give).max())
    assert abs(rotated(give, 45.0) - rotated(loads, 45.0) @ law.compliance.T).max() > 1e-3 * abs(give).max()


@pytest.mark.parametrize("angle", ANGLES)
def test_response_and_cut_turn_with_the_weave(angle):
    law, seen = stiff_across(), HungLaw.at(stiff_across(), angle)
    E = np.random.default_rng(3).normal(scale=0.3, size=(20, 3))
    here, there = law.response(E), seen.response(rotated(E, angle))
    assert there.energy == pytest.approx(here.energy, rel=1e-7, abs=1e-9 * here.energy.max())
    scale = abs(here.S).max()
    assert np.allclose(there.S, rotated(here.S, angle), rtol=0.0, atol=1e-7 * scale)
    assert there.E_star == pytest.approx(rotated(here.E_star, angle), abs=1e-7)
    cut, seen_cut = law.cut(E), seen.cut(rotated(E, angle))
    assert seen_cut.violation == pytest.approx(cut.violation, abs=1e-9)
    assert np.allclose(seen_cut.S, rotated(cut.S, angle), rtol=0.0, atol=1e-7)


@pytest.mark.parametrize("angle", ANGLES)
def test_first_half_spaces_and_tangent_turn_with_the_weave(angle):
    law, seen = stiff_across(), HungLaw.at(stiff_across(), angle)
    start, there = law.half_spaces(), seen.half_spaces()
    assert np.allclose(there.S, rotated(start.S, angle), rtol=0.0, atol=1e-12)
    assert there.h == pytest.approx(start.h)
    # the tangent is the derivative of the stress in the curtain's own axes
    E, change = np.array([[0.5, 0.1, 0.3]]), 1e-6 * np.array([[1.0, -0.5, 0.7]])
    difference = seen.response(E + change).S - seen.response(E - change).S
    tangent = np.einsum("nij,nj->ni", seen.response(E).C, change)
    assert 0.5 * difference == pytest.approx(tangent, abs=1e-5 * abs(difference).max())
