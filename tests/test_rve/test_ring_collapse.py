"""Plastic collapse of single rings against closed forms and a linear program of plastic hinges."""

import numpy as np
import pytest
from scipy.optimize import linprog

from rve import InputError, Material, NotConverged, pulled_ring
from rve.wire import Ring, StrengthOptions, internal_forces, largest_factors, plastic_collapse, self_stress
from rve.wire.strength import BENDING, TORSION, checked_sections

from .frame import random_load

RING = Ring(5.0, 0.5, 200e3, 0.3)
YIELD = 400.0
PLASTIC = 4.0 / 3.0 * 0.5**3 * YIELD


def pulls(count):
    return 2.0 * np.pi * np.arange(count)[None] / count, np.tile([1.0, 0.0, 0.0], (1, count, 1))


@pytest.mark.parametrize("count", [2, 3, 4, 6])
def test_radial_pulls_make_a_hinge_at_each_load_and_between_each_two(count):
    """Two pulls: F = 4 M_p/R. In general N R (1 - cos h) = 2 M_p, N = F/(2 sin h), h = pi/count."""
    h = np.pi / count
    angles, forces = pulls(count)
    factor, upper = plastic_collapse(angles, forces, RING, YIELD)
    exact = 4.0 * PLASTIC / 5.0 * np.sin(h) / (1.0 - np.cos(h))
    assert factor[0] == pytest.approx(exact, rel=1e-6)
    assert upper[0] >= exact * (1.0 - 1e-9)
    if count == 2:
        assert exact == pytest.approx(4.0 * PLASTIC / 5.0, rel=1e-12)


def test_four_alternating_axial_forces_bend_at_the_loads():
    """M_r = F R/2 at the loads, M_t = F R (sqrt 2 - 1)/2 between them: F = 2 M_p/R."""
    forces = np.array([1.0, -1.0, 1.0, -1.0])[None, :, None] * np.array([0.0, 0.0, 1.0])
    factor, _ = plastic_collapse(0.5 * np.pi * np.arange(4)[None], forces, RING, YIELD)
    assert factor[0] == pytest.approx(2.0 * PLASTIC / 5.0, rel=1e-6)


def program(base, free, planes):
    """The largest factor with the yield surface replaced by planes n.m <= 1, by a linear program."""
    columns = np.concatenate([base[..., None], free], axis=2)
    rows = np.einsum("ac,kcv->kav", planes, columns).reshape(-1, columns.shape[2])
    cost = np.zeros(columns.shape[2])
    cost[0] = -1.0
    found = linprog(cost, A_ub=rows, b_ub=np.ones(len(rows)), bounds=(None, None), method="highs")
    assert found.status == 0
    return found.x[0]


def sphere(count):
    """Directions spread over a sphere (Fibonacci), with the six axes."""
    i = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * i / count, np.pi * (1.0 + np.sqrt(5.0)) * i
    around = np.sqrt(1.0 - z**2)
    points = np.stack([around * np.cos(angle), z, around * np.sin(angle)], axis=1)
    return np.vstack([points, np.eye(3), -np.eye(3)])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_linear_program_of_plastic_hinges_agrees(seed):
    """Tangent planes around the yield surface: an upper bound that is wrong by 1 - cos of their spacing, here 2 %."""
    phi, forces = random_load(seed, 6)
    factor, most = plastic_collapse(phi[None], forces[None], RING, 1.0)
    at = checked_sections(phi)
    plastic = 0.5**3 * np.array([BENDING, TORSION, BENDING])
    base = internal_forces(phi, forces, at, RING.thin())[:, 3:] / plastic
    free = self_stress(at, 5.0)[:, 3:] / plastic[:, None]
    scale = np.abs(free).max(axis=(0, 1))
    upper = program(base * 1e-2, free / scale, sphere(150)) * 1e-2
    assert factor[0] <= upper * (1.0 + 1e-9)
    assert factor[0] == pytest.approx(upper, rel=0.02)
    assert most[0] == pytest.approx(factor[0], rel=1e-6)


def test_collapse_grows_with_yield_and_lies_above_first_yield():
    from rve.wire import peak_stress

    phi, forces = pulls(2)
    one, two = (plastic_collapse(phi, forces, RING, s)[0][0] for s in (200.0, 500.0))
    assert two / one == pytest.approx(2.5, rel=1e-9)
    # thin wire: first yield at M = F R/pi = pi r2^3/4 yield, so that the ratio is 4 M_p/R over that: 64/(3 pi^2)
    thin = Ring(1000.0, 1.0, 2e5, 0.3)
    ratio = plastic_collapse(phi, forces, thin, 1.0)[0][0] * peak_stress(phi, forces, thin)[0][0]
    assert ratio == pytest.approx(64.0 / (3.0 * np.pi**2), rel=2e-3)


def test_choosing_among_contact_forces_helps():
    """A section of moment mu (1 + z) with mu + z >= 0 and mu - z >= 0: z = -mu carries any load, so bound it by 1/2."""
    base = np.array([[[1.0, 0.0, 0.0], [0.0, 0.5, 0.0]]])
    free = np.array([[[[1.0], [0.0], [0.0]], [[0.0], [0.0], [0.0]]]])
    assert largest_factors(base, 0.0 * free)[0][0] == pytest.approx(1.0, rel=1e-4)
    signs = np.array([[[1.0, 1.0], [1.0, -1.0]]])
    assert largest_factors(base, free, signs)[0][0] == pytest.approx(2.0, rel=1e-4)
    half = np.array([[[0.5, 1.0], [1.0, -1.0]]])  # z >= -mu/2
    assert largest_factors(base, free, half)[0][0] == pytest.approx(2.0, rel=1e-4)
    tight = np.array([[[0.25, 1.0], [1.0, -1.0]]])  # z >= -mu/4: (1 - 1/4) mu <= 1
    assert largest_factors(base, free, tight)[0][0] == pytest.approx(4.0 / 3.0, rel=1e-4)


def test_too_few_steps_are_not_an_answer():
    (phi, forces), few = pulls(3), StrengthOptions(steps=2)
    at = checked_sections(phi)
    base = internal_forces(phi, forces, at, RING.thin())[..., 3:]
    free = self_stress(at, 5.0)[..., 3:, :]
    assert np.isnan(largest_factors(base, free, options=few)[0][0])
    assert largest_factors(base, free)[0][0] > 0.0
    with pytest.raises(NotConverged, match="1 of 1 rings"):
        plastic_collapse(phi, forces, RING, YIELD, options=few)


def test_a_ring_between_two_hooks_has_its_closed_forms():
    """Thin wire: first yield at F R/pi = pi r2^3/4 yield, collapse at 4 M_p/R, opening (pi/4 - 2/pi) F R^3/(E I)."""
    found = pulled_ring(500.0, 0.5, Material(yield_N_per_mm2=YIELD, ultimate_N_per_mm2=None))
    inertia = 0.25 * np.pi * 0.5**4
    assert found.first_yield_N == pytest.approx(np.pi**2 * 0.5**3 * YIELD / (4.0 * 500.0), rel=3e-3)
    assert found.collapse_N == pytest.approx(4.0 * PLASTIC / 500.0, rel=1e-6)
    assert found.opening_mm_per_N == pytest.approx((np.pi / 4.0 - 2.0 / np.pi) * 500.0**3 / (210e3 * inertia), rel=1e-4)
    hook = pulled_ring(500.0, 0.5, Material(yield_N_per_mm2=YIELD, ultimate_N_per_mm2=None), "butted:90")
    assert hook.collapse_N == pytest.approx(PLASTIC / 500.0, rel=1e-6)
    assert hook.opening_mm_per_N == pytest.approx(np.pi / 2.0 * 500.0**3 / (210e3 * inertia), rel=1e-4)
    worst = pulled_ring(500.0, 0.5, Material(yield_N_per_mm2=YIELD, ultimate_N_per_mm2=None), "butted")
    # wherever the ring is open, the other half bears all
    assert (worst.first_yield_N, worst.collapse_N) == pytest.approx((hook.first_yield_N, hook.collapse_N), rel=1e-6)
    for bad, message in ((("glued", YIELD), "joint = 'glued'"), (("welded", None), "no yield stress")):
        with pytest.raises(InputError, match=message):
            pulled_ring(5.0, 0.5, Material(yield_N_per_mm2=bad[1], ultimate_N_per_mm2=None), bad[0])
    for r1, r2 in ((5.0, 5.0), (5.0, 0.0), (np.inf, 1.0), (5.0, np.nan)):
        with pytest.raises(InputError, match="0 < r2 < r1"):
            pulled_ring(r1, r2)
