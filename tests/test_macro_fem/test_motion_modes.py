"""Natural frequencies: Bernoulli's hanging chain, a slack catenary, and what is refused."""

import numpy as np
import pytest
from scipy.linalg import eigh, eigh_tridiagonal, null_space
from scipy.optimize import brentq
from scipy.special import jn_zeros

from homogenize import default_law
from macro_fem import read_scene
from macro_fem.modes import find_modes
from rve import InputError
from tests.test_macro_fem.sheets import solve_scene

G, LENGTH = 9810.0, 1000.0
SHEET = {"width": 60.0, "height": LENGTH}


def strip(rows: int, *, kind: str = "rigid", **more):
    """A strip of 1 m hung along the grain, with about this many rows of nodes along it, at rest."""
    tables = {"curtain": {"width": 2.0 * LENGTH / rows, "height": LENGTH}, "mesh": {"cells": 2}}
    tables |= {"support": {"kind": "top"}, "solver": {"kind": kind}}
    return solve_scene(read_scene(tables | more), default_law())


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["rigid", "elastic"])
def test_frequencies_of_a_hanging_chain(kind):
    exact = 0.25 * jn_zeros(0, 3) * np.sqrt(G / LENGTH) / np.pi
    error = [np.abs(find_modes(strip(rows, kind=kind), 3).frequencies_Hz / exact - 1.0).max() for rows in (16, 32)]
    assert error[1] < 1e-4  # 2e-5 are the law's own
    # 16 of the fourth order; forces of rigid rings are open, and errors of coarse strips as small as those of fine ones
    assert max(error) < 3e-4 if kind == "rigid" else error[0] / error[1] > 8.0
    lying = strip(64, obstacle={"kind": "floor", "height": 300.0}, solver={"space": True, "kind": kind})
    assert find_modes(lying, 1).frequencies_Hz[0] == pytest.approx(exact[0] / np.sqrt(0.7), rel=2e-2)  # what hangs


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


@pytest.mark.slow
@pytest.mark.parametrize("columns", [2, 6])
def test_frequencies_of_a_slack_catenary_are_those_of_its_chain(columns):
    """Of many columns triangles hold all of the load or none, in turn."""
    hung = strip(
        32,
        curtain={"width": 2.0 * LENGTH / 32 if columns == 2 else 250.0, "height": LENGTH},
        mesh={"cells": columns},
        kind="rigid" if columns == 2 else "elastic",
        support=[{"kind": "edge", "edge": "top"}, {"kind": "edge", "edge": "bottom", "move": [0.0, 100.0, 0.0]}],
        load={"gravity": [0.0, 0.0, -9.81]},
    )
    found, again = (find_modes(hung, 6) for _ in range(2))
    assert found.frequencies_Hz == pytest.approx(chain_frequencies(900.0), rel=2e-3 if columns == 2 else 2.5e-3)
    assert np.array_equal(again.shapes, found.shapes)  # signs and bases as well
    assert np.linalg.norm(found.shapes, axis=2).max(axis=1) == pytest.approx(1.0)


def hanging_frequencies(bar: float, links: int = 2000) -> np.ndarray:
    """Frequencies in Hz of a hanging chain of LENGTH with a bar of this mass over its own at its end."""
    s = np.arange(links) + 0.5
    k, m = G * (s / links + bar) * links / LENGTH, np.append(0.5 / links + bar, np.full(links - 1, 1.0 / links))
    diagonal, beside = (k + np.append(0.0, k[:-1])) / m, -k[:-1] / np.sqrt(m[:-1] * m[1:])
    square = eigh_tridiagonal(diagonal, beside, eigvals_only=True, select="i", select_range=(0, 5))
    return np.asarray(np.sqrt(square) / (2.0 * np.pi))


COLUMNS = [
    (pattern, d, bar) for pattern in ("aligned", "crossed", "diagonal", "outline") for d, bar in ((2, 0.0), (3, 0.3))
]


@pytest.mark.slow
@pytest.mark.parametrize(("pattern", "d", "bar"), [*COLUMNS, ("aligned", 3, 0.0), ("diagonal", 3, 0.0)])
def test_columns_side_by_side_have_the_frequencies_of_one_and_no_others(pattern, d, bar):
    """Shapes that change from column to column are raised by the mesh, in space also by the locked surface."""
    corners = [[0.0, 0.0], [200.0, 0.0], [200.0, LENGTH], [0.0, LENGTH]]
    sheet = {"shape": "outline", "outline": corners} if pattern == "outline" else {"width": 200.0, "height": LENGTH}
    mesh = {"cells": 6} | ({} if pattern == "outline" else {"pattern": pattern})
    mass = bar * default_law().cell.areal_mass_kg_per_m2 * 0.2
    load = {"bar": {"mass": mass, "straight": False}} if bar else {}
    hung = strip(2, curtain=sheet, mesh=mesh, load=load, solver={"space": d == 3, "kind": "elastic"})
    found = find_modes(hung, 3)
    assert found.frequencies_Hz == pytest.approx(hanging_frequencies(bar)[: len(found.frequencies_Hz)], rel=1e-2)
    assert found.frequencies_Hz[:2] == pytest.approx(hanging_frequencies(bar)[:2], rel=1e-3)
    assert found.multiplicity.min() > 1


def test_a_heavy_bar_makes_a_strip_a_string_under_tension():
    hung = strip(64, load={"bar": {"mass": 5.0}}, kind="elastic")
    per_length = default_law().cell.areal_mass_kg_per_m2 * 1e-6 * 2.0 * LENGTH / 64
    found = find_modes(hung, 4).frequencies_Hz
    assert found[0] == pytest.approx(np.sqrt(G / LENGTH) / (2.0 * np.pi), rel=5e-3)  # the bar, which also turns
    string = 0.5 / LENGTH * np.sqrt((5.0 + 0.5 * per_length * LENGTH) * G / per_length)
    assert np.abs(found / string - 1.0).min() < 5e-3


def test_shapes_stay_off_obstacles_and_free_where_no_support_holds_them():
    wind, wall = {"pressure": 20.0, "direction": [0.0, 0.0, -1.0]}, {"kind": "wall", "facing": [0.0, 0.0, 1.0]}
    pressed = find_modes(strip(16, load={"wind": wind}, obstacle=wall), 2)
    assert np.abs(pressed.shapes[:, :, 2]).max() < 1e-9 < np.abs(pressed.shapes[:, :, 0]).max()
    half = strip(16, support=[{"kind": "top"}, {"kind": "edge", "edge": "left", "held": "x"}])
    assert np.abs(find_modes(half, 1).shapes[0, half.problem.disc.nodes[:, 0] < 1e-6, 2]).max() > 0.9  # as in space


@pytest.mark.slow
def test_frequencies_go_with_the_root_of_gravity_and_close_ones_are_told_apart():
    weak = find_modes(strip(32, load={"gravity": 9.81e-8}), 1).frequencies_Hz[0]
    assert weak == pytest.approx(0.25e-4 * jn_zeros(0, 1)[0] * np.sqrt(G / LENGTH) / np.pi, rel=1e-3)
    hung = strip(64, curtain=SHEET, mesh={"cells": 4}, load={"bar": {"mass": 0.05}}, kind="elastic")
    assert find_modes(hung, 1).frequencies_Hz[0] == pytest.approx(0.553944, rel=1e-3)  # a chain and bar, by J0 and Y0
    square = {"curtain": {"width": LENGTH, "height": LENGTH}, "support": {"kind": "corners"}}
    coarse, fine = (find_modes(strip(2, mesh={"cells": n}, **square), 6).frequencies_Hz for n in (10, 20))
    assert len(coarse) < len(fine)
    assert coarse[0] == pytest.approx(fine[0], rel=2e-2)  # not 0.06 Hz, which is the mesh's own


@pytest.mark.parametrize("number", [0, -1, 10**6])
def test_senseless_numbers_of_modes_are_refused(number):
    with pytest.raises(InputError, match="number = "):
        find_modes(strip(16), number)
    for more in ({"load": {"gravity": 0.0}}, {"curtain": SHEET | {"areal_mass": 0.0}, "load": {"bar": {"mass": 1.0}}}):
        with pytest.raises(InputError, match="has no modes"):
            find_modes(strip(16, **more))
