"""Alternating projection: what it finds is right, what it misses is counted."""

from dataclasses import replace

import numpy as np
import pytest

from rve.equilibrium.system import Equations
from rve.geometry.circles import are_linked, local_minima
from rve.geometry.kinematics import cauchy_line_load
from rve.geometry.weave import FOUR_IN_ONE
from rve.paper import stewart_trinkle as st
from rve.paper.alternating_projection import alternating_projection


@pytest.fixture(scope="module")
def linked_pairs():
    """Some two thousand random pairs of linked circles: offset and normals."""
    rng = np.random.default_rng(7)
    d = rng.normal(size=(6000, 3)) * np.array([1.2, 1.2, 0.0])
    normals = rng.normal(size=(2, 6000, 3))
    n_a, n_b = normals / np.linalg.norm(normals, axis=2)[..., None]
    linked = are_linked(d, n_a, n_b, 1.0)
    return d[linked], n_a[linked], n_b[linked]


def apart(one, two):
    return np.linalg.norm(one.rho_a - two.rho_a, axis=1)


def test_it_ends_in_a_local_minimum(linked_pairs):
    d, n_a, n_b = linked_pairs
    all_minima = local_minima(d, n_a, n_b, 1.0)
    found = alternating_projection(d, n_a, n_b, d)
    nearest = np.full(len(d), np.inf)
    way = np.linalg.norm(all_minima.rho_a - found.rho_a[all_minima.pair], axis=1)
    np.minimum.at(nearest, all_minima.pair, way)
    stiff = found.curvature > 0.1  # it contracts by 1 - curvature or better; 400 iterations are enough
    assert stiff.mean() > 0.9
    assert nearest[stiff].max() < 1e-9


def test_it_misses_contacts(linked_pairs):
    d, n_a, n_b = linked_pairs
    all_minima = local_minima(d, n_a, n_b, 1.0)
    double = np.bincount(all_minima.pair, minlength=len(d)) == 2
    deepest = np.full(len(d), np.inf)
    np.minimum.at(deepest, all_minima.pair, all_minima.distance)
    near, far = (alternating_projection(d, n_a, n_b, sign * d) for sign in (1.0, -1.0))
    missed = double & (apart(near, far) < 1e-4)
    assert double.sum() > 1000
    assert 0.05 < missed.sum() / double.sum() < 0.2  # two starts: about one double contact in ten
    assert (near.distance > deepest + 1e-6).mean() > 0.2  # one start: not even the deepest in a third of the pairs


def test_it_stops_short_where_minima_merge():
    """Two minima of a symmetric pair merge where the curvature goes to zero; there the iteration creeps."""
    tilt = np.radians(35.0)
    n_a, n_b = np.array([[0.0, np.sin(tilt), np.cos(tilt)]]), np.array([[0.0, -np.sin(tilt), np.cos(tilt)]])
    reach = np.linspace(1.0, 1.9, 400)
    d = np.stack([reach, 0.0 * reach, 0.0 * reach], axis=1)
    n_a, n_b = np.tile(n_a, (400, 1)), np.tile(n_b, (400, 1))
    counts = np.bincount(local_minima(d, n_a, n_b, 1.0).pair, minlength=400)
    assert set(counts) == {1, 2}
    off_axis = d + np.array([0.0, 0.3, 0.0])
    steps = [alternating_projection(d, n_a, n_b, off_axis, max_iterations=n) for n in (400, 4000)]
    creep = apart(*steps)
    merging = np.argmin(np.abs(np.diff(counts)) < 1)
    assert creep.max() > 1e-3
    assert abs(int(np.argmax(creep)) - int(merging)) < 10


def test_the_locked_state_is_the_same():
    s = cauchy_line_load([20.0], [50.0])
    equations = Equations.of(FOUR_IN_ONE, 0.1)
    options = st.StewartTrinkleOptions()
    newton = st.solve(s, equations, options)
    projected = st.solve(s, equations, replace(options, contacts="projection"))
    assert projected.status[0] == "converged"
    assert projected.pose.lattice == pytest.approx(newton.pose.lattice, abs=1e-8)
