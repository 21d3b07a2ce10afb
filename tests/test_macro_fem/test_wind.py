"""Wind from a speed: the drag of a screen against published values and both equations of its model, and bad keys."""

import re

import numpy as np
import pytest

import macro_fem
import rve
from homogenize.io import default_law
from homogenize.laws.net import diagonal_net
from macro_fem.curtain import solve_scene
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.schema import read_scene
from macro_fem.scene.wind import drag_coefficient, ring_solidity
from macro_fem.solution import make_problem
from rve.common.errors import InputError


def with_wind(scene_tables, **wind):
    return read_scene(scene_tables(mesh={"cells": 4}, load={"wind": {"direction": [0.0, 0.0, 2.0], **wind}}))


def wind_force(scene, law):
    """Total force of the wind, N."""
    force = make_problem(scene, law, build_mesh(scene, law.cell)).force.sum(axis=0)
    assert force[0] == pytest.approx(0.0, abs=1e-12)
    return force[2]


@pytest.mark.parametrize("beta", [0.1, 0.23, 0.4, 0.64, 0.9, 0.99])
def test_the_drag_solves_both_equations(beta):
    """u from the momentum of the wake (2.12) by bisection, then the resistance of the screen (2.15)."""
    drag = drag_coefficient(1.0 - beta)
    low, high = 0.0, 1.0
    for _ in range(80):
        u = 0.5 * (low + high)
        low, high = (u, high) if 4.0 / 3.0 * (1.0 - u) * (2.0 + u) / (2.0 - u) > drag else (low, u)
    through = u**2 * (1.0 / beta**2 - 1.0) - 4.0 / 3.0 * (1.0 - u) ** 3 / (2.0 - u) ** 2
    assert through == pytest.approx(drag, rel=1e-9)


def test_the_drag_has_its_limits():
    """Solid 4/3; nearly open the resistance itself, k = 1/beta^2 - 1; it grows with the solidity."""
    assert drag_coefficient(1.0) == pytest.approx(4.0 / 3.0)
    assert drag_coefficient(0.0) == 0.0
    assert drag_coefficient(1e-4) == pytest.approx(2e-4, rel=1e-3)
    assert (np.diff([drag_coefficient(s) for s in np.linspace(0.0, 1.0, 50)]) > 0.0).all()


def test_a_speed_is_the_pressure_of_its_drag(scene_tables):
    """C_D rho v^2 / 2 with the solidity of the law's own rings, and with both numbers given."""
    law = default_law()
    solidity = rve.solidity(rve.Cell(5.0, 0.5))
    assert ring_solidity(law.cell) == pytest.approx(solidity, rel=1e-9)
    area = 0.1 * 0.1
    by_speed = wind_force(with_wind(scene_tables, speed=20.0), law)
    assert by_speed == pytest.approx(0.5 * drag_coefficient(solidity) * 1.25 * 400.0 * area, rel=1e-9)
    given = with_wind(scene_tables, speed=20.0, drag_coefficient=0.9, air_density=1.0)
    assert wind_force(given, law) == pytest.approx(0.5 * 0.9 * 400.0 * area, rel=1e-12)
    assert wind_force(given, diagonal_net()) == pytest.approx(0.5 * 0.9 * 400.0 * area, rel=1e-12)


def test_the_same_pressure_gives_the_same_curtain(scene_tables):
    law = default_law()
    by_speed = solve_scene(with_wind(scene_tables, speed=12.0, drag_coefficient=1.0), law)
    by_pressure = solve_scene(with_wind(scene_tables, pressure=0.5 * 1.25 * 144.0), law)
    assert by_speed.status == "converged"
    assert by_speed.x == pytest.approx(by_pressure.x, abs=1e-9)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "pressure: is missing; give it in N/m2, or speed in m/s"),
        ({"pressure": 5.0, "speed": 3.0}, "speed = 3: is not used together with pressure"),
        ({"pressure": 5.0, "air_density": 1.2}, "air_density = 1.2: is not used together with pressure"),
        ({"pressure": 5.0, "drag_coefficient": 1.2}, "drag_coefficient = 1.2: is not used together with pressure"),
        ({"speed": -3.0}, "speed = -3.0: must be at least 0"),
        ({"speed": 3.0, "air_density": 0.0}, "air_density = 0.0: must be greater than 0"),
        ({"speed": 3.0, "drag_coefficient": "high"}, "drag_coefficient = 'high': is not a number"),
        ({"speed": 3.0, "direction": [0.0, 0.0]}, "direction = [0.0, 0.0]: has no direction"),
    ],
)
def test_bad_keys_of_wind_end_in_one_sentence(scene_tables, keys, message):
    with pytest.raises(InputError, match=re.escape(f"scene: [load.wind] {message}")):
        with_wind(scene_tables, **keys)


def test_a_law_without_rings_needs_a_drag_coefficient(scene_tables):
    scene, law = with_wind(scene_tables, speed=3.0), diagonal_net()
    with pytest.raises(InputError, match=r"scene: \[load.wind\] speed = 3: the law has no rings to tell the drag"):
        make_problem(scene, law, build_mesh(scene, law.cell))


def test_the_summary_tells_drag_and_pressure(scene_tables):
    scene = with_wind(scene_tables, speed=10.0)
    (told,) = macro_fem.solve(scene).summary["wind"]
    assert told["solidity"] == pytest.approx(0.3606, abs=2e-3)
    assert told["drag_coefficient"] == drag_coefficient(told["solidity"])
    assert told["pressure_N_per_m2"] == pytest.approx(62.5 * told["drag_coefficient"])
    assert "wind" not in macro_fem.solve(with_wind(scene_tables, pressure=5.0)).summary
