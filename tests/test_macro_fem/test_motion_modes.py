"""Natural frequencies: Bernoulli's hanging chain, a slack catenary, and what is refused."""

import numpy as np
import pytest
from scipy.linalg import eigh, null_space
from scipy.optimize import brentq
from scipy.special import jn_zeros

from homogenize import default_law
from macro_fem.curtain import solve_scene
from macro_fem.motion.modes import find_modes
from macro_fem.scene.schema import read_scene
from rve.common.errors import InputError

G, LENGTH = 9810.0, 1000.0


def strip(rows: int, *, kind: str = "rigid", **more):
    """A strip of 1 m hung along the grain, with about this many rows of nodes along it, at rest."""
    tables = {
        "curtain": {"width": 2.0 * LENGTH / rows, "height": LENGTH},
        "mesh": {"cells": 2},
        "support": {"kind": "top"},
        "solver": {"kind": kind},
    }
    return solve_scene(read_scene(tables | more), default_law())


@pytest.mark.parametrize("kind", ["rigid", "elastic"])
def test_frequencies_of_a_hanging_chain(kind):
    exact = 0.25 * jn_zeros(0, 3) * np.sqrt(G / LENGTH) / np.pi
    error = [np.abs(find_modes(strip(rows, kind=kind), 3).frequencies_Hz / exact - 1.0).max() for rows in (16, 32)]
    assert error[1] < 1e-4  # 2e-5 are the law's own
    assert error[0] / error[1] > 8.0  # 16 of the fourth order


def chain_frequencies(span: float, links: int = 300) -> np.ndarray:
    """Frequencies in Hz of an inextensible chain of LENGTH between two points on one level: along and across it."""
    a = brentq(lambda a: 2.0 * a * np.sinh(span / (2.0 * a)) - LENGTH, span / 20.0, 1e6)
    s = np.linspace(-0.5, 0.5, links + 1) * LENGTH
    edge = np.diff(np.column_stack([a * np.arcsinh(s / a), np.sqrt(a * a + s * s)]), axis=0)
    length = np.linalg.norm(edge, axis=1)
    k = G * np.hypot(a, 0.5 * (s[1:] + s[:-1])) / length
    D = np.diff(np.eye(links + 1), axis=0)
    K, m = D.T @ (k[:, None] * D), np.full(links + 1, LENGTH / links)
    inner = slice(1, -1)
    C = (edge / length[:, None])[:, None, :] * D[:, :, None]
    Z = null_space(C[:, inner].reshape(links, -1))
    K2, M2 = np.kron(K[inner, inner], np.eye(2)), np.diag(np.repeat(m[inner], 2))
    along = eigh(Z.T @ K2 @ Z, Z.T @ M2 @ Z, eigvals_only=True)[:3]
    across = eigh(K[inner, inner], np.diag(m[inner]), eigvals_only=True)[:3]
    return np.sort(np.sqrt(np.concatenate([along, across])) / (2.0 * np.pi))


def test_frequencies_of_a_slack_catenary_are_those_of_its_chain():
    hung = strip(
        32,
        support=[{"kind": "edge", "edge": "top"}, {"kind": "edge", "edge": "bottom", "move": [0.0, 100.0, 0.0]}],
        load={"gravity": [0.0, 0.0, -9.81]},
    )
    found = find_modes(hung, 6)
    assert found.frequencies_Hz == pytest.approx(chain_frequencies(900.0), rel=2e-3)
    assert found.shapes.shape == (6, hung.problem.disc.n_nodes, 3)
    assert np.array_equal(find_modes(hung, 6).shapes, found.shapes)  # signs and bases as well
    assert np.linalg.norm(found.shapes, axis=2).max(axis=1) == pytest.approx(1.0)


def test_a_heavy_bar_makes_a_strip_a_string_under_tension():
    mass = 5.0
    hung = strip(64, load={"bar": {"mass": mass}}, kind="elastic")
    per_length = default_law().cell.areal_mass_kg_per_m2 * 1e-6 * 2.0 * LENGTH / 64
    found = find_modes(hung, 4).frequencies_Hz
    pendulum = np.sqrt(G / LENGTH) / (2.0 * np.pi)  # of the bar, which also turns about the vertical
    assert np.abs(found / pendulum - 1.0).min() < 5e-3
    string = 0.5 / LENGTH * np.sqrt((mass + 0.5 * per_length * LENGTH) * G / per_length)
    assert np.abs(found / string - 1.0).min() < 5e-3


@pytest.mark.parametrize("number", [0, -1, 10**6])
def test_senseless_numbers_of_modes_are_refused(number):
    with pytest.raises(InputError, match="number = "):
        find_modes(strip(16), number)
