"""Problems with answers from elsewhere: Mansfield's sheared membrane, the gathered net, a manufactured sheet."""

import numpy as np
import pytest

from benchmarks.sheet.ours import NeoHookeanSheet
from homogenize import diagonal_net
from macro_fem import read_scene
from macro_fem.curtain import solve_scene
from macro_fem.fem.assembly import deformation_gradient, gradient, internal_force
from macro_fem.fem.discretization import discretize
from macro_fem.fem.membrane import evaluate, first_piola, green_strain
from macro_fem.solvers.newton import solve
from tests.test_macro_fem.sheets import TensionFieldSheet, mesh_of, rectangle, supported

MANSFIELD_ENERGY = 12.41061  # N mm, from his closed form
MANSFIELD_ANGLE = 55.2934  # degrees from the long side, half-way between the free ends


def sheared_membrane(element, n, scale):
    """Energy over scale^2 and wrinkle angle at the centre: 200 x 100 x 0.025 mm, E = 3500 MPa, top moved by (0.6, 0.2).

    His theory is one of small strain. The law is homogeneous of degree two, so the same solver reaches it by moving
    `scale` times as far: the strains then differ from small ones by `scale` times a fraction of a per cent.
    """
    disc = rectangle(element, 200.0, 100.0, 2 * n, n)
    top, bottom = disc.nodes[:, 1] == 100.0, disc.nodes[:, 1] == 0.0
    displacement = scale * np.outer(top, [0.6, 0.2])
    fixed = np.repeat((top | bottom)[:, None], 2, axis=1)
    law, fem = TensionFieldSheet(3500.0 * 0.025, 0.3), supported(disc, fixed, displacement)
    solution = solve(fem, law, 0 * displacement, scale * disc.nodes[:, 1:] / 100.0 * [0.6, 0.2])
    assert solution.stop == "closed"
    S = evaluate(disc, law, solution.u).response.S
    S = S[np.argmin(np.linalg.norm(disc.points - [100.0, 50.0], axis=1))]
    angle = 0.5 * np.degrees(np.arctan2(2 * S[1], S[0] - S[2]))
    return solution.stored / scale**2, angle


@pytest.mark.parametrize(
    ("element", "excess"), [("P1", (2e-2, 8e-3)), ("Q1", (1.5e-2, 6e-3)), ("P2", (3e-3, 1e-3)), ("Q2", (2.5e-3, 8e-4))]
)
def test_mansfield_from_above(element, excess):
    """Conforming elements store more than the exact energy, and less on a finer mesh."""
    coarse, _ = sheared_membrane(element, 8, 1e-4)
    fine, angle = sheared_membrane(element, 16, 1e-4)
    assert 0.0 < coarse / MANSFIELD_ENERGY - 1.0 < excess[0]
    assert 0.0 < fine / MANSFIELD_ENERGY - 1.0 < excess[1]
    assert fine < coarse
    assert angle == pytest.approx(MANSFIELD_ANGLE, abs=0.02)


def test_mansfield_small_strain_is_a_limit():
    """The difference from small strain falls in proportion to the movement."""
    energy = [sheared_membrane("Q1", 8, scale)[0] for scale in (1.0, 0.1, 1e-4)]
    assert (energy[0] - energy[2]) / (energy[1] - energy[2]) == pytest.approx(10.0, rel=0.05)


@pytest.mark.slow
def test_mansfield_fine():
    energy, angle = sheared_membrane("Q2", 64, 1e-4)
    assert 0.0 < energy / MANSFIELD_ENERGY - 1.0 < 2.5e-4
    assert angle == pytest.approx(MANSFIELD_ANGLE, abs=1e-3)


def gathered_net_height(element, n):
    """Mean height of the inextensible net, 40 x 40 mm gathered to 70 %: two stiffnesses, extrapolated to rigid."""
    scene = read_scene(
        {
            "curtain": {"width": 40.0, "height": 40.0, "areal_mass": 100.0},
            "mesh": {"cells": n, "element": element, "pattern": "diagonal"},
            "support": {"kind": "top", "gather": 0.7},
            "solver": {"kind": "elastic", "stabilising_tension": 0.0},
        }
    )
    solutions = [solve_scene(scene, diagonal_net(1.0, stiffness)) for stiffness in (1e3, 1e4)]
    assert [one.status for one in solutions] == ["converged"] * 2
    soft, stiff = (one.mean_height() for one in solutions)
    return stiff + (stiff - soft) / 9.0


@pytest.mark.parametrize(
    ("element", "n", "mean_potential"),
    [
        ("P1", 8, 23664.7),
        ("P1", 16, 23453.0),
        ("Q1", 8, 24268.2),
        ("P2", 4, 23005.0),
        ("CR", 8, 21919.0),
        ("CR", 16, 22246.0),
    ],
)
def test_gathered_net_on_every_element(element, n, mean_potential):
    """The cone programs of another author, as the integral of the height over 1600 mm2, to their printed digit."""
    assert 1600.0 * gathered_net_height(element, n) == pytest.approx(mean_potential, abs=0.06)


def test_gathered_net_brackets_the_exact_height():
    """Conforming elements hang too high, Crouzeix-Raviart too low, and both come closer."""
    exact = 14.187635
    above = [gathered_net_height(e, n) - exact for e, n in (("P1", 8), ("P1", 16), ("P2", 4), ("P2", 8))]
    below = [gathered_net_height("CR", n) - exact for n in (8, 16)]
    assert above[0] > above[1] > above[3] > 0.0
    assert above[2] > above[3]
    assert below[0] < below[1] < 0.0


def smooth_field(x):
    """A displacement without symmetry and its gradient at x (n, 2), stretched so that the sheet is taut everywhere.

    Taut, because Crouzeix-Raviart has no Korn inequality: only tension holds its cells against turning one by one.
    """
    s, c = np.sin(2.0 * x[:, 0] + x[:, 1]), np.cos(2.0 * x[:, 0] + x[:, 1])
    t, q = np.sin(x[:, 0] - 2.0 * x[:, 1]), np.cos(x[:, 0] - 2.0 * x[:, 1])
    u = 0.1 * np.stack([s, t], axis=-1) + 0.5 * x
    H = 0.1 * np.stack([np.stack([2 * c, c], axis=-1), np.stack([q, -2 * q], axis=-1)], axis=1)
    return u, H + 0.5 * np.eye(2)


@pytest.mark.parametrize(("element", "order"), [("P1", 2), ("P2", 3), ("CR", 2), ("Q1", 2), ("Q2", 3)])
def test_newton_converges_at_the_order_of_the_element(element, order):
    """Neo-Hookean sheet whose load is chosen so that a smooth field is the answer: L2 order k + 1, gradient order k.

    The load is l(v) = integral of P(F) : grad v with the exact F, so that no derivative of P is needed.
    """
    law = NeoHookeanSheet(mu=1.0)
    errors, slopes = [], []
    for n in (4, 8, 16):
        mesh = mesh_of(element, 1.0, 1.0, n, n)
        disc, fine = discretize(mesh, element), discretize(mesh, element, order=8)
        _, H = smooth_field(fine.points)
        P = first_piola(H + np.eye(2), law.response(green_strain(H)).S)
        edge = np.repeat(np.any((disc.nodes == 0.0) | (disc.nodes == 1.0), axis=1)[:, None], 2, axis=1)
        u, _ = smooth_field(disc.nodes)
        solution = solve(supported(disc, edge, u), law, internal_force(fine, P), u)
        assert solution.stop == "closed"
        gap = fine.interpolate(solution.u) - smooth_field(fine.points)[0]
        errors.append(np.sqrt(fine.weight @ (gap**2).sum(axis=1)))
        tilt = gradient(fine, solution.u) - H
        slopes.append(np.sqrt(fine.weight @ (tilt**2).sum(axis=(1, 2))))
    assert np.log2(errors[1] / errors[2]) == pytest.approx(order, abs=0.15)
    assert np.log2(slopes[1] / slopes[2]) == pytest.approx(order - 1, abs=0.15)
    assert errors[2] < 5e-4
    assert np.all(np.linalg.det(deformation_gradient(disc, solution.u)) > 0.1)
