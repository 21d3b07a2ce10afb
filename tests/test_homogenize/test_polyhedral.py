"""Polyhedral laws: bounds on a known set, closest points against a plain solver, derivatives everywhere."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from homogenize.fitting import bounds_of, inner_law, outer_law, random_loads, refined_half_spaces
from homogenize.laws import polyhedral_law
from rve import InputError
from rve.common import WEIGHT, double_dot, eigenvalues, from_disc, trace

from .conftest import derivative_errors, disc_grid, rows_of

ANISOTROPIC = np.linalg.solve(
    np.diag(WEIGHT), np.array([[900.0, 40.0, 200.0], [40.0, 500.0, 30.0], [200.0, 30.0, 600.0]])
)


@pytest.fixture
def rows(ellipsoid):
    return rows_of(ellipsoid, disc_grid(5, 20))


def test_bounds_enclose_the_truth(rows, ellipsoid):
    S = random_loads(2000)
    bounds = bounds_of(rows)
    assert np.all(bounds.lower(S) <= ellipsoid.support(S) + 1e-12)
    assert np.all(bounds.upper(S) >= ellipsoid.support(S) - 1e-12)
    assert np.allclose(bounds.lower(rows.S), rows.h, atol=1e-12)
    assert np.allclose(bounds.upper(rows.S), rows.h, atol=1e-12)


def test_laws_are_ordered_and_refinement_stays_between(rows, ellipsoid):
    S = random_loads(20_000)
    inner, outer = inner_law(rows).support(S), outer_law(rows).support(S)
    refined = polyhedral_law(*refined_half_spaces(rows)).support(S)
    bounds = bounds_of(rows)
    assert np.all(inner >= bounds.lower(S) - 1e-12)
    assert np.all(inner <= bounds.lower(S) + 1e-5)  # the rim of the inner law has 720 loads, not all
    assert np.allclose(outer, bounds.upper(S), atol=1e-11)
    assert np.all(refined >= bounds.lower(S) - 1e-12)
    assert np.all(refined <= bounds.upper(S) + 1e-12)
    truth = ellipsoid.support(S)
    assert np.abs(refined - truth).mean() < 0.35 * np.abs(outer - truth).mean()


@pytest.mark.parametrize("stiffness", [1000.0 * np.eye(3), ANISOTROPIC])
def test_closest_point_is_that_of_a_plain_solver(rows, stiffness):
    """Oracle: the dual as nonnegative least squares over all half-spaces, one point at a time."""
    law = outer_law(rows, stiffness)
    R = np.linalg.cholesky(WEIGHT[:, None] * stiffness).T
    normals = np.linalg.solve(R.T, (law.S * WEIGHT).T)
    E = np.random.default_rng(6).normal(scale=0.5, size=(60, 3))
    answer = law.response(E)
    for k, point in enumerate(E):
        # min |y - x|^2 with n.x <= h is nnls of [n; h - n.y] against e4, in the form of Lawson and Hanson (LDP)
        slack = law.h - normals.T @ (R @ point)
        factor, _ = nnls(np.vstack([-normals, -slack]), np.array([0.0, 0.0, 0.0, 1.0]), maxiter=10000)
        r = np.vstack([-normals, -slack]) @ factor - np.array([0.0, 0.0, 0.0, 1.0])
        shift = -r[:3] / r[3] if slack.min() < 0.0 else np.zeros(3)
        assert answer.energy[k] == pytest.approx(0.5 * shift @ shift, rel=1e-8, abs=1e-10)
    assert law.cut(answer.E_star).violation.max() < 1e-12


@pytest.mark.parametrize("stiffness", [1000.0 * np.eye(3), ANISOTROPIC])
def test_derivatives_inside_on_and_outside(rows, stiffness):
    law = outer_law(rows, stiffness)
    rng = np.random.default_rng(7)
    far = rng.normal(scale=0.5, size=(300, 3))
    vertices = law.vertices[rng.integers(len(law.vertices), size=100)]
    near = vertices + rng.normal(scale=1e-3, size=vertices.shape)
    for E in (far, near, vertices):
        of_energy, of_load = derivative_errors(law, E)
        assert of_energy.max() < 2e-3  # half the kink of S over the step, 1e-6 x 1000 N/mm, is the most C1 allows
        if E is not vertices:
            assert np.quantile(of_load, 0.9) < 1e-3  # a tenth may straddle a face of the normal fan
    assert eigenvalues(law.response(far).S)[0].min() > -1e-9
    assert np.allclose(law.response(far).E_star, far - law.response(far).S @ law.compliance.T, atol=1e-12)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.01, 1.0, 50.0]))
def test_any_half_spaces_make_a_convex_tensile_law(seed, size):
    """Random, also absurd: support homogeneous and subadditive, S tensile, energy convex, tangent symmetric."""
    rng = np.random.default_rng(seed)
    m = int(rng.integers(3, 40))
    S = np.vstack([from_disc(np.zeros((1, 2))), random_loads(m, seed)])
    law = polyhedral_law(S, np.concatenate([[size], rng.uniform(-0.2, size, m)]), ANISOTROPIC)
    A, B = random_loads(50, seed + 1), random_loads(50, seed + 2)
    hA, hB = law.support(A), law.support(B)
    tiny = 1e-9 * (1.0 + np.abs(law.vertices).max())
    assert np.allclose(law.support(3.0 * A), 3.0 * hA, rtol=1e-12)
    assert np.all(law.support(A + B) <= hA + hB + tiny)
    E = rng.normal(scale=size, size=(50, 3))
    F = rng.normal(scale=size, size=(50, 3))
    e, f, mid = law.response(E), law.response(F), law.response(0.5 * (E + F))
    assert np.all(mid.energy <= 0.5 * (e.energy + f.energy) * (1.0 + 1e-9) + 1e-9)
    assert np.all(eigenvalues(e.S)[0] >= -1e-9 * (1.0 + trace(e.S)))
    hessian = WEIGHT[:, None] * e.C
    assert np.allclose(hessian, hessian.transpose(0, 2, 1), atol=1e-6)
    assert np.linalg.eigvalsh(hessian).min() > -1e-6


def test_cut_is_the_largest_violation_of_all_loads(rows):
    law = outer_law(rows)
    E = np.random.default_rng(8).normal(scale=0.3, size=(200, 3))
    cut = law.cut(E)
    S = random_loads(4000)
    inside = np.hypot(S[:, 0] - S[:, 2], 2.0 * S[:, 1]) < np.cos(np.pi / 20)  # the hull of the law's own loads
    S = S[inside]
    sampled = (E @ (S * WEIGHT).T - law.support(S)).max(axis=1)
    assert np.all(cut.violation >= sampled - 1e-12)
    assert np.allclose(cut.violation, double_dot(cut.S, E) - law.support(cut.S), atol=1e-11)


def test_contradicting_and_compressive_half_spaces_are_refused():
    S = from_disc(np.array([[0.0, 0.0], [0.5, 0.0], [-0.5, 0.0]]))
    with pytest.raises(InputError, match="not tensile"):
        polyhedral_law(np.array([[1.0, 0.0, -0.5]]), np.array([1.0]))
    with pytest.raises(InputError, match="finite"):
        polyhedral_law(S, np.array([0.1, np.nan, 0.1]))
    with pytest.raises(InputError, match="contradict"):
        polyhedral_law(S, np.array([-0.6, -0.6, -0.6]))  # beyond a cell of no size


def test_half_spaces_of_any_size_are_the_same_law(rows):
    """S:E <= h and 3 S:E <= 3 h are one half-space: violations are strains, and every load has unit trace."""
    law = outer_law(rows, ANISOTROPIC)
    size = np.random.default_rng(16).uniform(0.1, 10.0, len(law.h))
    other = polyhedral_law(law.S * size[:, None], law.h * size, ANISOTROPIC)
    E = np.random.default_rng(17).normal(scale=0.4, size=(350, 3))
    assert np.allclose(trace(other.S), 1.0, atol=1e-12)
    assert np.allclose(trace(other.cut(E).S), 1.0, atol=1e-12)
    assert np.allclose(other.cut(E).violation, law.cut(E).violation, atol=1e-10)
    assert np.allclose(other.response(E).S, law.response(E).S, atol=1e-7 * ANISOTROPIC.max())
    one = polyhedral_law(np.array([[4.0, 0.0, 0.0], [0.0, 0.0, 0.5]]), np.array([2.0, 0.1]))
    assert one.cut(np.array([[0.7, 0.0, 0.0]])).violation[0] == pytest.approx(0.2, abs=1e-12)  # 0.7 - 2/4
