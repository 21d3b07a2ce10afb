"""Floors, walls and bodies against closed forms, balance, virtual work and clarabel; sentences for what cannot be."""

import numpy as np
import pytest

from homogenize import default_law
from macro_fem import read_scene, solve
from macro_fem.curtain import ShapeOptions, solve_problem, solve_shape
from macro_fem.judged import obstacle_forces, pushes_of
from macro_fem.scene import Obstacle, PlacedObstacle, read_records
from tests.test_macro_fem.clarabel_oracle import curtain_by_clarabel
from tests.test_macro_fem.sheets import posed, sheet

DENSITY = 2.785 * 9.81e-6
"""Weight of the small scenes, N/mm2."""


def answer(tables, law):
    return solve_problem(posed(tables, law))


def assert_balanced(solution):
    """Supports, obstacles and loads: in sum, and at every unknown."""
    force = solution.problem.force
    total = np.abs(force).sum()
    left = solution.reactions.sum(axis=0) + solution.pushes.sum(axis=0) + force.sum(axis=0)
    assert np.abs(left).max() < 1e-8 * total
    assert solution.residual < 1e-8
    assert solution.wall_forces.min() > 0.0


def on_floor(scene_tables, cells, level, **more):
    return scene_tables(mesh={"cells": cells}, **more) | {"obstacle": {"kind": "floor", "height": level}}


@pytest.mark.parametrize("space", [False, True])
@pytest.mark.parametrize("kind", ["rigid", "elastic"])
def test_sheet_on_the_floor_hangs_at_its_length_and_the_rest_lies_down(fitted_law, scene_tables, kind, space):
    tables = on_floor(scene_tables, 4, 33.0, solver={"kind": kind, "space": space})
    solution = answer(tables, fitted_law)
    assert solution.status == "converged", solution.message
    problem, Y = solution.problem, solution.problem.disc.nodes[:, 1]
    assert problem.fem.d == (3 if space else 2)
    exact = np.maximum(Y, 33.0)
    assert np.abs(solution.x[:, 1] - exact).max() < (2e-3 if kind == "elastic" else 1e-4)
    lying = -problem.force[Y < 33.0, 1].sum()
    assert solution.pushes[:, 1].sum() == pytest.approx(lying, rel=2e-5)  # of which the stabilising tension is 1e-6
    assert_balanced(solution)


def test_height_above_the_floor_is_of_second_order(fitted_law, scene_tables):
    exact, errors = (0.5 * (100.0**2 - 40.0**2) + 40.0**2) / 100.0, []
    for cells in (2, 4, 8):
        solution = answer(on_floor(scene_tables, cells, 40.0, width=50.0), fitted_law)
        force, Y = solution.problem.force[:, 1], solution.problem.disc.nodes[:, 1]
        assert solution.mean_height() == pytest.approx(force @ np.maximum(Y, 40.0) / force.sum(), abs=1e-4)
        errors.append(solution.mean_height() - exact)
    assert errors[0] > 3.0 * errors[1] > 9.0 * errors[2] > 0.0


def test_floor_under_a_straight_bar_levels_it(fitted_law, scene_tables):
    tables = scene_tables(mesh={"cells": 4}, load={"bar": {"mass": 0.01}})
    solution = answer(tables | {"obstacle": {"kind": "floor", "height": 10.0}}, fitted_law)
    bottom = solution.problem.disc.nodes[:, 1] < 1e-9
    assert solution.x[bottom, 1] == pytest.approx(10.0, abs=1e-5)
    assert_balanced(solution)


@pytest.mark.parametrize("z", [0.0, 0.3])
def test_clarabel_agrees_on_the_program_with_walls(fitted_law, scene_tables, z):
    obstacles = [
        {"kind": "wall", "point": [50.0, 35.0], "facing": [-0.3, 1.0, z]},
        {"kind": "wall", "point": [50.0, 30.0], "facing": [0.4, 1.0, z]},
    ]
    tables = scene_tables(mesh={"cells": 4}, support={"kind": "corners", "gather": 0.5}) | {"obstacle": obstacles}
    problem = posed(tables, fitted_law)
    assert problem.fem.d == (3 if z else 2)
    own, oracle = solve_problem(problem), curtain_by_clarabel(problem)
    assert own.status == oracle.status == "converged"
    assert_balanced(own)
    assert {0, 1} == set(problem.walls.owner[own.wall_forces > 1e-4 * np.abs(problem.force).sum()])
    scale = np.abs(problem.force).sum() * problem.mesh.size
    assert own.primal / scale == pytest.approx(oracle.primal / scale, abs=1e-7)
    for number in range(2):
        push, its = (pushes_of(one, number).sum(axis=0) for one in (own, oracle))
        assert push == pytest.approx(its, abs=1e-4 * np.abs(problem.force).sum())


def test_a_wall_that_nothing_touches_changes_nothing(fitted_law, scene_tables):
    tables = scene_tables(mesh={"cells": 4}, support={"kind": "corners", "gather": 0.7})
    alone = answer(tables, fitted_law)
    walled = answer(tables | {"obstacle": {"kind": "wall", "facing": [0, 1], "point": [0, -300]}}, fitted_law)
    scale = np.abs(alone.problem.force).sum()
    assert walled.primal == pytest.approx(alone.primal, abs=1e-8 * scale * alone.problem.mesh.size)
    assert walled.wall_forces.sum() < 1e-7 * scale
    assert not len(alone.problem.walls)
    assert len(alone.wall_forces) == 0


def test_bounds_of_the_potential_contain_that_of_the_sheet_on_the_floor(fitted_law, scene_tables):
    """The discrete potential lies between the primal and the dual value, closer than the allowance for slack parts."""
    solution = answer(on_floor(scene_tables, 4, 33.0, solver={"stabilising_tension": 0.0}), fitted_law)
    problem, Y = solution.problem, solution.problem.disc.nodes[:, 1]
    exact = -float(problem.force[:, 1] @ (np.maximum(Y, 33.0) - Y))
    scale = np.abs(problem.force).sum() * problem.mesh.size
    assert solution.dual - 1e-9 * scale < exact < solution.primal + 1e-9 * scale
    assert solution.primal - solution.dual < 1e-7 * scale


R, LENGTH = 200.0, 2000.0


def test_quadratic_cells_do_not_dip_below_a_floor_between_their_nodes(fitted_law, scene_tables):
    """With half-spaces on nodes alone P2 is 1.3 mm below it here."""
    rod = {"kind": "edge", "edge": "top", "along": [[0.0, 100.0, 0.0], [80.0, 125.0, 10.0]]}
    tables = on_floor(scene_tables, 3, 40.0, support=rod) | {"mesh": {"cells": 3, "element": "P2"}}
    solution = answer(tables, fitted_law)
    assert solution.status == "converged", solution.message
    assert_balanced(solution)
    assert (solution.problem.disc.lattice @ solution.x)[:, 1].min() > 40.0 - 1e-6
    assert solution.pushes[:, 1].sum() > 0.1 * -solution.problem.force[:, 1].sum()


def rope(cells, clear="nodes"):
    """A strip held at (y, z) = (0, -R) that goes over a cylinder of radius R and hangs down in front of it."""
    strip = sheet(2.0 * LENGTH / cells, LENGTH, 2, {"kind": "top", "move": [0.0, -LENGTH, -R]}, areal_mass=2.785)
    return strip | {
        "obstacle": {"kind": "cylinder", "axis": [1, 0, 0], "radius": R, "clear": clear},
        "start": {"origin": [0.0, R, LENGTH - R], "y_axis": [0.0, 0.0, -1.0]},
    }


def over_the_pulley(law, cells, clear):
    """A solved strip, and errors: mean and least height, pull of the top, tension, push. T - w y is the same everywhere
    and T = 0 at the free end."""
    end = np.pi * R - LENGTH
    solution = answer(rope(cells, clear), law)
    assert solution.status == "converged", solution.message
    assert_balanced(solution)
    assert solution.settling.is_settled
    problem, x = solution.problem, solution.x
    weight = DENSITY * problem.scene.curtain.width
    pull = solution.reactions[problem.supports.held[0].nodes, 1].sum() / (weight * end)
    middle = x[problem.disc.cell_dofs].mean(axis=1)[:, 1]
    tension = np.abs(solution.principal()[0][:, 0] - DENSITY * (middle - end)).mean() / (DENSITY * (R - end))
    push = pushes_of(solution, 0).sum(axis=0)[1] / (weight * (LENGTH - end))
    height = (2.0 * R**2 - 0.5 * end**2) / LENGTH
    errors = [solution.mean_height() - height, x[:, 1].min() - end, pull - 1.0, tension, push - 1.0]
    return solution, np.array(errors) / [LENGTH, LENGTH, 1.0, 1.0, 1.0]


@pytest.mark.slow
def test_strip_over_a_cylinder_is_a_rope_over_a_pulley(fitted_law):
    (one, coarse), (other, fine) = (over_the_pulley(fitted_law, cells, "nodes") for cells in (8, 16))
    for solution in (one, other):
        distance = np.hypot(solution.x[:, 1], solution.x[:, 2])
        assert distance[~solution.problem.fem.held.all(axis=1)].min() > R - 1e-5
    assert np.all((coarse[:2] / 3.4 < fine[:2]) & (fine[:2] < 0.0))  # chords of the circle are shorter
    assert np.all(np.abs(fine) < [2e-3, 1.0, 0.01, 0.03, 0.005])
    assert fine[3] < coarse[3] / 2.0
    assert one.settling.between_nodes_mm / other.settling.between_nodes_mm == pytest.approx(4.0, rel=0.1)


@pytest.mark.slow
def test_a_strip_that_clears_a_cylinder_with_whole_cells_converges_to_the_rope(fitted_law):
    """Its sides touch the cylinder instead of its nodes: heights come from above, and bodies do not show through."""
    (one, coarse), (other, fine) = (over_the_pulley(fitted_law, cells, "cells") for cells in (16, 32))
    assert np.all((fine[:2] > 0.0) & (fine[:2] < coarse[:2] / 3.4))
    assert np.all(np.abs(fine[[0, 1, 4]]) < [4e-3, 5e-3, 0.01])
    for cells, solution in ((16, one), (32, other)):  # part of the height of a chord; nodes alone leave 1.33
        assert solution.settling.between_nodes_mm / (LENGTH / cells) ** 2 * 8.0 * R < 0.4


def pushed(scene_tables, travel, **more):
    sphere = {"kind": "sphere", "centre": [50.0, 40.0, -41.0], "radius": 40.0, "move": [0.0, 0.0, travel]}
    tables = scene_tables(mesh={"cells": 4}, support={"kind": "corners", "gather": 0.8}, load={"bar": {"mass": 0.02}})
    return tables | {"obstacle": sphere | more}


@pytest.mark.slow
def test_reaction_of_a_moving_sphere_is_the_slope_of_the_potential(fitted_law, scene_tables):
    """Virtual work: what the sphere does when it goes on is what the potential rises by."""
    step = 0.25
    low, here, high = (answer(pushed(scene_tables, 19.5 + s * step), fitted_law) for s in (-1, 0, 1))
    assert {one.status for one in (low, here, high)} == {"converged"}
    slope = (high.primal - low.primal) / (2.0 * step)
    (line,) = obstacle_forces([here])
    assert line.reaction_N[2] == pytest.approx(slope, rel=0.02)
    assert line.reaction_N[2] > 0.02 * np.abs(here.problem.force).sum()
    assert line.nodes_touched >= 1
    assert_balanced(here)


@pytest.mark.slow
def test_summary_tells_reaction_and_displacement_step_by_step(fitted_law, scene_tables):
    tables = pushed(scene_tables, 45.0, name="shoulder")
    tables["load"] = {**tables["load"], "steps": 3}
    summary = solve(read_scene(tables), fitted_law).summary
    (line,) = summary["obstacles"]
    assert (line["obstacle"], line["kind"]) == ("shoulder", "sphere")
    assert [one["displacement_mm"] for one in line["steps"]] == pytest.approx([15.0, 30.0, 45.0])
    push = [one["reaction_N"][2] for one in line["steps"]]
    assert 0.0 < push[0] < push[1] < push[2]
    assert line["reaction_N"] == line["steps"][-1]["reaction_N"]
    assert summary["settling"]["misfit"] <= summary["settling"]["asked"]
    used = {one["feature"]: one["used"] for one in summary["features"]}
    assert used["rounds"]
    assert used["half-spaces-on-nodes"]
    assert used["third-coordinate"]


def test_mesh_over_the_edge_of_a_box_is_held_by_roof_and_front(fitted_law):
    strip = sheet(250.0, 1000.0, 2, {"kind": "top", "move": [0.0, -1000.0, -400.0]}, areal_mass=2.785)
    box = {"kind": "box", "corner": [-500.0, -2000.0, -2000.0], "size": [1500.0, 2000.0, 2000.0], "clear": "nodes"}
    start = {"origin": [0.0, 0.0, 600.0], "y_axis": [0.0, 0.0, -1.0]}
    solution = answer(strip | {"obstacle": box, "start": start}, fitted_law)
    assert solution.status == "converged", solution.message
    assert_balanced(solution)
    x, way = solution.x, pushes_of(solution, 0).sum(axis=0)
    assert solution.problem.bodies[0].gap(x).min() > -1e-5
    assert -way[2] == pytest.approx(solution.reactions[:, 2].sum(), rel=1e-6)
    hanging = 600.0 * 250.0 * DENSITY
    assert way[2] == pytest.approx(hanging, rel=0.15)  # a rope over a smooth edge; 0.4 % at 16 cells, 17 % at 4
    assert -x[:, 1].min() == pytest.approx(600.0, rel=0.1)
    assert way[1] == pytest.approx(1000.0 * 250.0 * DENSITY, rel=0.05)


def test_rounds_that_are_cut_short_end_by_name(fitted_law):
    problem = posed(rope(8), fitted_law)
    solution = solve_shape(problem, None, solve_problem, options=ShapeOptions(rounds=1))
    assert solution.status == "unsettled"
    assert "has not settled after 1 rounds" in solution.message


@pytest.mark.parametrize("kind", ["sphere", "cylinder", "box", "floor", "wall"])
def test_tangent_half_spaces_touch_the_obstacle_and_leave_it_out(kind):
    rng = np.random.default_rng(7)
    keys = {
        "sphere": {"centre": [1.0, 2.0, 3.0], "radius": 4.0},
        "cylinder": {"point": [1.0, 2.0, 3.0], "axis": [1.0, 2.0, 2.0], "radius": 4.0},
        "box": {"corner": [-1.0, -2.0, -3.0], "size": [2.0, 4.0, 6.0]},
        "floor": {"height": 1.0},
        "wall": {"facing": [1.0, 2.0, 2.0], "point": [1.0, 0.0, 0.0]},
    }
    (item,) = read_records({"kind": kind, "move": [2.0, 0.0, 4.0], **keys[kind]}, Obstacle.kinds, "scene: [obstacle]")
    assert isinstance(item, Obstacle.kinds[kind])
    body = PlacedObstacle(0, item, 0.5, 3)
    x = rng.uniform(-15.0, 15.0, (400, 3))
    normal = body.normal(x)
    assert np.linalg.norm(normal, axis=1) == pytest.approx(1.0)
    gap = body.gap(x)
    nearest = x - gap[:, None] * normal  # a point of the obstacle's surface
    assert body.gap(nearest) == pytest.approx(0.0, abs=1e-9)
    inside = nearest[gap < 0.0] if (gap < 0.0).any() else nearest
    everywhere = normal @ inside.T - body.offset(normal)[:, None]
    assert everywhere.max() < 1e-9
    slope = (body.gap(x + 1e-6 * normal) - gap) / 1e-6
    assert slope[gap > 1e-3] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_points_between_nodes_are_where_the_element_puts_them(scene_tables, fitted_law, element):
    """Each place of the mesh once; a straight state is straight there, and nodes are among them."""
    disc = posed(scene_tables(mesh={"cells": 2, "element": element}), fitted_law).disc
    for points in (disc.meeting, disc.lattice):
        X = points @ disc.nodes
        x = points @ (disc.nodes @ [[1.0, 0.5], [0.0, 2.0]] + [3.0, 4.0])
        assert x == pytest.approx(X @ [[1.0, 0.5], [0.0, 2.0]] + [3.0, 4.0], abs=1e-9)
        assert len(np.unique(np.rint(1e6 * X), axis=0)) == len(X)
    to_node = np.linalg.norm((disc.meeting @ disc.nodes)[:, None] - disc.nodes, axis=-1).min(axis=0)
    assert to_node.max() < 1e-9


@pytest.mark.slow
def test_a_body_that_has_passed_between_nodes_on_the_way_is_told():
    """Rows of nodes 38 mm apart let a bar of 30 mm through, and the strip ends below it without touching it."""
    strip = {
        "curtain": {"width": 75.0, "height": 300.0, "areal_mass": 2.0},
        "mesh": {"cells": 2, "pattern": "diagonal"},
        "support": {"kind": "edge", "edge": "top", "move": [0.0, -305.0, -90.0]},
        "obstacle": {"kind": "cylinder", "axis": [1.0, 0.0, 0.0], "radius": 15.0, "clear": "nodes"},
        "start": {"origin": [0.0, 15.1, 283.0], "y_axis": [0.0, 0.0, -1.0]},
    }
    found = answer(strip, default_law())
    assert found.x[:, 1].mean() < -150.0
    assert found.settling.between_nodes_mm == 0.0
    assert found.status == "pierced"
    assert "gone through the mesh" in found.message


def test_least_distance_from_a_way_is_that_of_its_nearest_point():
    rng, t = np.random.default_rng(4), np.linspace(0.0, 1.0, 4001)[:, None]
    bodies = [
        {"kind": "sphere", "centre": [1.0, 2.0, 3.0], "radius": 4.0},
        {"kind": "cylinder", "axis": [1.0, 2.0, -1.0], "point": [0.0, 1.0, 0.0], "radius": 3.0},
        {"kind": "box", "corner": [-3.0, -2.0, -4.0], "size": [6.0, 5.0, 7.0], "rounding": 1.0},
    ]
    for number, body in enumerate(read_records(bodies, Obstacle.kinds, "scene: [obstacle]")):
        one = PlacedObstacle(number, body, 0.0, 3)
        start, end = rng.normal(scale=9.0, size=(2, 40, 3))
        sampled = np.array([one.gap(a + t * (b - a)).min() for a, b in zip(start, end, strict=True)])
        assert sampled.min() < -1.0
        assert np.abs(one.least_gap(start, end) - sampled).max() < 1e-2
