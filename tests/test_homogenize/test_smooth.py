"""The smooth law: convex and tensile for every parameter, its derivatives, its fit of a set it can describe."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from homogenize.fitting.report import random_loads
from homogenize.fitting.rows import normality
from homogenize.fitting.smooth import SmoothOptions, _Problem, fit_smooth
from homogenize.io import load_law, save_law
from homogenize.laws.projection import ProjectionError
from homogenize.laws.smooth import log_sum, patches_of, smooth_law
from rve.common.errors import InputError
from rve.common.tensor import WEIGHT, disc, double_dot, eigenvalues, from_disc, mirror, trace

from .conftest import derivative_errors, disc_grid, rows_of

GENTLE = np.array(
    [
        [0.0, 0.0, 0.0, 0.2, 0.0, -0.5, 0.1, 0.3],
        [1.0, 0.3, 0.0, 0.3, 0.1, -0.5, 0.1, 0.1],
        [-1.0, 0.8, 0.5, -0.1, 0.0, -0.4, 0.2, 0.05],
        [-0.3, 2.0, 0.2, 0.0, 0.1, -0.6, 0.3, 0.08],
    ]
)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.sampled_from([0.3, 3.0, 300.0]))
def test_any_parameters_make_a_convex_tensile_set(seed, count, size):
    """Hessian positive semidefinite, load positive semidefinite, cut convex and mirror-symmetric: no exception."""
    rng = np.random.default_rng(seed)
    law = smooth_law(rng.normal(scale=size, size=(count, 8)))
    x = rng.normal(scale=0.5, size=(40, 3))
    H = log_sum(x, law.patches)[2]
    scale = np.abs(H).max(axis=(1, 2)) + 1.0
    assert np.all(np.linalg.eigvalsh(H)[:, 0] >= -1e-9 * scale)
    E, F = rng.normal(scale=0.5, size=(40, 3)), rng.normal(scale=0.5, size=(40, 3))
    e, f, mid = law.cut(E), law.cut(F), law.cut(0.5 * (E + F))
    assert np.all(eigenvalues(e.S)[0] >= -1e-9)
    assert np.allclose(trace(e.S), 1.0)
    assert np.all(mid.violation <= 0.5 * (e.violation + f.violation) + 1e-9)
    assert np.allclose(law.cut(mirror(E)).violation, e.violation, atol=1e-9)
    # a supporting half-space of one point holds every other point of the set
    on_surface = F - f.violation[:, None] * [1.0, 0.0, 1.0]
    assert np.all(e.h[:, None] + 1e-8 >= (e.S * WEIGHT) @ on_surface.T)


def test_derivatives_of_the_log_sum_by_complex_step():
    x = np.random.default_rng(16).normal(scale=0.4, size=(50, 3))
    value, slope, H = log_sum(x, patches_of(GENTLE))
    for j in range(3):
        nudged = x.astype(complex)
        nudged[:, j] += 1e-30j
        up, up_slope, _ = log_sum(nudged, patches_of(GENTLE))
        assert np.allclose(up.imag * 1e30, slope[:, j], rtol=1e-12, atol=1e-12)
        assert np.allclose(up_slope.imag * 1e30, H[:, :, j], rtol=1e-10, atol=1e-9)
    assert np.isrealobj(value)


def test_response_is_the_gradient_of_its_energy_inside_on_and_outside():
    stiffness = np.array([[900.0, 80.0, 200.0], [40.0, 500.0, 15.0], [200.0, 30.0, 600.0]])
    law = smooth_law(GENTLE, stiffness)
    E = np.random.default_rng(17).normal(scale=0.4, size=(400, 3))
    answer = law.response(E)
    outside = answer.energy > 0.0
    assert 50 < outside.sum() < 390
    assert np.allclose(answer.S[~outside], 0.0)
    of_energy, of_load = derivative_errors(law, E, step=1e-5)
    assert of_energy.max() < 1e-4
    assert np.quantile(of_load, 0.99) < 1e-3  # the surface itself, where the tangent jumps, is hit by few
    on = answer.E_star[outside]
    assert np.abs(law.cut(on).violation).max() < 1e-9
    assert np.allclose(law.response(on).S, 0.0, atol=1e-6)
    assert np.allclose(E - answer.S @ law.compliance.T, answer.E_star, atol=1e-12)


def test_support_is_that_of_the_cut():
    law = smooth_law(GENTLE)
    E = np.random.default_rng(18).normal(scale=0.4, size=(200, 3))
    cut = law.cut(E)
    assert np.allclose(law.support(cut.S), cut.h, atol=1e-7)
    A, B = random_loads(60, 1), random_loads(60, 2)
    hA, hB = law.support(A), law.support(B)
    assert np.allclose(law.support(2.5 * A), 2.5 * hA, rtol=1e-9)
    assert np.all(law.support(A + B) <= hA + hB + 1e-8)


def test_fit_finds_a_smooth_set_and_its_jacobian_is_right(ellipsoid):
    rows = rows_of(ellipsoid, disc_grid(4, 16))
    assert normality(rows).holds
    law = fit_smooth(rows, options=SmoothOptions(patches=6, evaluations=200))
    S = random_loads(300)
    S = S[np.hypot(*disc(S).T) < 0.9]
    error = np.abs(law.support(S) - ellipsoid.support(S))
    assert error.mean() < 1e-3
    assert error.max() < 5e-3
    x = rows.E @ np.array([[0.5, 0.0, 0.5], [0.5, 0.0, -0.5], [0.0, 1.0, 0.0]]).T
    n = np.column_stack([np.ones(len(rows)), disc(rows.S)])
    theta = law.theta.ravel()
    problem = _Problem(x, n, 0.06, theta, np.full(len(rows), 0.15))
    J = problem.jacobian(theta)
    for j in range(8, len(theta), 5):
        step = 1e-6 * np.eye(len(theta))[j]
        slope = (problem.residual(theta + step) - problem.residual(theta - step)) / 2e-6
        assert np.allclose(slope, J[:, j], atol=1e-5 * (1.0 + np.abs(J[:, j]).max()))


def test_law_file_and_refusals(tmp_path):
    law = smooth_law(GENTLE)
    save_law(law, tmp_path / "law.json")
    E = from_disc(np.array([[0.3, 0.1]]))
    assert np.array_equal(load_law(tmp_path / "law.json").response(E).S, law.response(E).S)
    assert double_dot(E, law.response(E).S)[0] > 0.0
    with pytest.raises(InputError, match="eight finite parameters"):
        smooth_law(np.ones((3, 7)))
    with pytest.raises(InputError, match="eight finite parameters"):
        smooth_law(np.full((3, 8), np.nan))
    assert issubclass(ProjectionError, RuntimeError)
