"""What slides carries nothing: pins of every kind of sliding, obstacles at supports that slide, and noise."""

import numpy as np
import pytest

from homogenize import default_law
from macro_fem import read_scene
from macro_fem.curtain import solve_problem
from rve import InputError
from tests.test_macro_fem.sheets import posed

SIZE = 200.0
RAIL = {"kind": "rail"}
HOOKS = {"kind": "hooks", "pitch": 50.0, "sliding": True}
DIAGONAL = {"kind": "edge", "edge": "top", "along": [[0, SIZE, 0], [0.8 * SIZE, SIZE, 0.6 * SIZE]], "sliding": True}


def wall(facing, point, **keys):
    return {"kind": "wall", "facing": facing, "point": point, **keys}


def scene(support, *obstacles, **solver):
    tables = {"curtain": {"width": SIZE, "height": SIZE}, "mesh": {"cells": 4}, "support": support, "solver": solver}
    return read_scene(tables | ({"obstacle": list(obstacles)} if obstacles else {}), "scene")


def solved(support, *obstacles, **solver):
    law, asked = default_law(), scene(support, *obstacles, **solver)
    return solve_problem(posed(asked, law))


def total(solution):
    return float(np.abs(solution.problem.force).sum())


@pytest.mark.parametrize(
    ("support", "way"),
    [(RAIL, [1.0, 0.0]), (HOOKS, [1.0, 0.0]), (DIAGONAL, [0.8, 0.0, 0.6])],
    ids=["rail", "hooks", "diagonal"],
)
def test_every_kind_of_sliding_has_its_pin(support, way):
    """Without obstacles it is free of force, and supports report none along the way."""
    found = solved(support)
    pins = found.problem.supports.pins
    assert pins.direction == pytest.approx(np.array([way]))
    assert np.abs(pins.along(found.unbalanced)).max() < 1e-9 * total(found)
    assert np.abs(found.reactions @ way).max() < 1e-9 * total(found)
    fixed = found.problem.fem.held[pins.nodes]
    assert fixed.all()


def test_a_wall_that_pushes_along_a_diagonal_line_is_refused():
    """Once the line's column of T was deleted, and the answer carried 11 % of the weight along it."""
    slope = wall([1.0, 1.0, 0.0], [100.0, 60.0, 0.0])
    with pytest.raises(InputError, match=r"\[obstacle\]: nothing carries the force of 0.0\d* N along \[0.8, 0.0"):
        solved(DIAGONAL, slope)


@pytest.mark.parametrize("support", [RAIL, HOOKS, DIAGONAL], ids=["rail", "hooks", "diagonal"])
@pytest.mark.parametrize("kind", ["rigid", "elastic"])
def test_a_support_that_slides_may_still_be_inside_an_obstacle(support, kind):
    """A floor above it, and a wall in front, from which no sliding leads out."""
    name = {"rail": "rail", "hooks": "hooks", "edge": "edge top"}[support["kind"]]
    with pytest.raises(InputError, match=rf"scene: \[obstacle\] floor: {name} is 10 mm inside it$"):
        solved(support, {"kind": "floor", "height": SIZE + 10.0}, kind=kind)
    facing = [-0.6, 0.0, 0.8] if support is DIAGONAL else [0.0, 0.0, 1.0]
    with pytest.raises(InputError, match=rf"scene: \[obstacle\] wall: {name} is 10 mm inside it$"):
        solved(support, wall(facing, [10.0 * one for one in facing]), kind=kind)


def test_a_sloping_line_slides_along_a_wall():
    """Its nodes beyond the wall have room along the line: they are not fixed. The one that is a pin must be outside."""
    found = solved(DIAGONAL, wall([1.0, 0.0, 0.0], [20.0, 0.0, 0.0]))
    assert found.status == "converged"
    assert found.x[:, 0].min() > 20.0 - 1e-6
    with pytest.raises(InputError, match=r"edge top is 20 mm inside it, and nothing but that holds it along \[0.8, 0"):
        solved(DIAGONAL, wall([1.0, 0.0, 0.0], [100.0, 0.0, 0.0]))


@pytest.mark.parametrize(
    "solver",
    [{}, {"tolerance": 1e-4}, {"tolerance": 1e-2}, {"stabilising_tension": 1e-4}, {"stabilising_tension": 0.0}],
    ids=["as it is", "1e-4", "1e-2", "tension", "no tension"],
)
def test_noise_is_no_force(solver):
    """A wall beside a curtain on a rail: what presses it there is the even tension, and the gap of the answer."""
    found = solved(RAIL, wall([1.0, 0.0], [20.0, 0.0]), **solver)
    assert found.status == "converged"
    pushed = np.abs(found.problem.supports.pins.along(found.unbalanced)).max()
    assert pushed < found.noise
    assert found.noise < 1e-5 * total(found) or solver
    assert not found.reactions[:, 0].any()
