"""The limit surface: a convex set inside of what rows bear, its hull, the work of plastic strains."""

import json
from dataclasses import replace

import clarabel
import numpy as np
import pytest
from click.testing import CliRunner
from scipy import sparse

from homogenize import default_law, diagonal_net
from homogenize.cli import main
from homogenize.laws import limit_surface, plastic_law
from rve import InputError
from rve.common import WEIGHT, mirror


@pytest.fixture(scope="module")
def law():
    return default_law()


@pytest.fixture(scope="module")
def surface(law):
    return limit_surface(law)


def roots(A):
    """Symmetric roots (n, 2, 2) of triples."""
    values, vectors = np.linalg.eigh(A[:, [0, 1, 1, 2]].reshape(-1, 2, 2))
    return (vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]) @ vectors.swapaxes(1, 2)


def carried(P, S, kappa):
    """The least sum of |p_j| / kappa_j with P = sum of p_j L_j: clarabel's largest P:G over kappa_j |G L_j| <= 1."""
    L, n = roots(S), len(S)
    A = np.zeros((n, 5, 4))
    for a in range(2):
        for k in range(2):
            A[:, 1 + 2 * a + k, 2 * a : 2 * a + 2] = -L[:, :, k]
    b = np.zeros((n, 5))
    b[:, 0] = 1.0 / kappa
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    empty = sparse.csc_matrix((4, 4))
    rows = sparse.csc_matrix(A.reshape(-1, 4))
    cones = n * [clarabel.SecondOrderConeT(5)]
    return -clarabel.DefaultSolver(empty, -P.ravel(), rows, b.ravel(), cones, settings).solve().obj_val


@pytest.mark.slow
def test_no_row_bears_more_than_its_own_collapse_load(law, surface):
    rows, g = law.strength.S[::31], law.strength.collapse[::31]
    at = law.vertices[((rows * WEIGHT) @ law.vertices.T).argmax(axis=1)]
    F = roots(2.0 * at + np.array([1.0, 0.0, 1.0]))
    T = rows[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    least = [carried(P, surface.S, surface.c / surface.safe) / one for P, one in zip(F @ T, g, strict=True)]
    assert min(least) > 1.0 - 1e-6
    raw = [carried(P, surface.S, surface.c / surface.g) / one for P, one in zip(F @ T, g, strict=True)]
    assert min(raw) < 0.9  # the hull bears more: it is not safe


def test_the_safe_set_keeps_what_rows_bear_along_both_axes(law, surface):
    axes = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert 1.0 / surface.loads(axes)[0] == pytest.approx(law.strength.collapse_at(axes), rel=1e-9)


def test_the_safe_set_is_inside_and_the_hull_outside_and_the_difference_is_told(law, surface):
    rows = law.strength.S
    safe, hull = surface.loads(np.vstack([rows, mirror(rows)]))
    own = 1.0 / np.tile(law.strength.collapse, 2)
    assert (safe <= own * (1.0 + 1e-3)).all()
    assert (hull >= own * (1.0 - 1e-3)).all()
    assert (hull / safe).max() == pytest.approx(surface.difference, rel=1e-3)


def test_new_rows_do_not_bring_the_safe_set_and_the_hull_together(law, surface):
    """Dents of the star, not gaps between its rows, keep them apart: of 190 rows 42 with the fibres give the same."""
    inner = np.linalg.det(law.strength.S[:, [0, 1, 1, 2]].reshape(-1, 2, 2)) > 1e-9
    few = limit_surface(replace(law, strength=law.strength.take(~inner | (np.cumsum(inner) % 8 == 1))))
    S = np.array([[0.5, 0.0, 0.5], [0.4, 0.1, 0.6], [0.2, -0.2, 0.8]])
    assert few.loads(S)[0] == pytest.approx(surface.loads(S)[0], rel=1e-6)
    assert few.difference == pytest.approx(surface.difference, rel=0.01)


def test_work_of_plastic_strains_is_the_support_function_of_the_safe_set(surface):
    rng = np.random.default_rng(0)
    E = rng.normal(size=(200, 3))
    work = surface.dissipation(E)
    assert (work >= 0.0).all()
    assert surface.dissipation(3.0 * E) == pytest.approx(3.0 * work)
    assert (surface.dissipation(E[:100] + E[100:]) <= (work[:100] + work[100:]) * (1.0 + 1e-12)).all()
    S = roots(rng.normal(size=(200, 3)) @ np.diag([0.1, 0.1, 0.1]) + np.array([1.0, 0.0, 1.0]))[:, [0, 0, 1], [0, 1, 1]]
    S /= (S[:, 0] + S[:, 2])[:, None]
    inside = surface.loads(S)[0][:, None] * S
    assert ((inside * WEIGHT) @ E.T <= work * (1.0 + 1e-9) + 1e-12).all()


@pytest.mark.slow
def test_strips_and_rows_are_safe_whatever_the_star(law):
    rng = np.random.default_rng(1)
    for _ in range(3):
        rough = law.strength.collapse * np.exp(0.3 * rng.normal(size=len(law.strength.collapse)))
        odd = replace(law, strength=replace(law.strength, collapse=rough))
        found = limit_surface(odd)
        assert (found.safe >= found.g * (1.0 - 1e-12)).all()
        worst = np.argsort(rough)[-3:]
        rows = odd.strength.S[worst]
        at = law.vertices[((rows * WEIGHT) @ law.vertices.T).argmax(axis=1)]
        F = roots(2.0 * at + np.array([1.0, 0.0, 1.0]))
        for P, g in zip(F @ rows[:, [0, 1, 1, 2]].reshape(-1, 2, 2), rough[worst], strict=True):
            assert carried(P, found.S, found.c / found.safe) > g * (1.0 - 1e-4)


def test_cuts_are_the_half_spaces_that_are_violated_most(law):
    flowing = plastic_law(law)
    E, tau = np.random.default_rng(2).normal(size=(50, 3)), np.linspace(0.0, 2.0, 50)
    cut = flowing.cut(np.column_stack([E, tau, 0.5 * tau**2]))
    c = np.sqrt(2.0 * flowing.h + 1.0)
    excess = (E * WEIGHT) @ flowing.S.T + 0.5 - 0.5 * (c + flowing.N * tau[:, None]) ** 2
    assert cut.violation == pytest.approx(excess.max(axis=1))
    assert flowing.support(cut.S) == pytest.approx(cut.h, abs=1e-9)


def test_laws_without_half_spaces_or_strength_are_refused(law):
    for bad, told in ((diagonal_net(), "no half-spaces"), (replace(law, strength=None), "holds no strength")):
        with pytest.raises(InputError, match=told):
            limit_surface(bad)


def test_strength_prints_both_sets(law, tmp_path):
    law.save(tmp_path / "law.json")
    found = {}
    for load in ("0,0,1", "0.37,0,0.63"):
        run = CliRunner().invoke(main, ["strength", str(tmp_path / "law.json"), "--S", load])
        found[load] = json.loads(run.output)
    grain, even = found.values()
    assert grain["safe_N_per_mm"] == pytest.approx(grain["collapse_N_per_mm"], rel=1e-6)
    assert even["safe_N_per_mm"] < even["collapse_N_per_mm"] <= even["hull_N_per_mm"] * (1.0 + 1e-3)
    assert even["hull_N_per_mm"] / even["safe_N_per_mm"] <= even["hull_over_safe_max"] * (1.0 + 1e-6)
