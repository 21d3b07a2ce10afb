"""Edges on lines in space: held, sliding along an axis, sliding on sloping lines, and what is refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from macro_fem import read_scene
from macro_fem.fem import discretize
from macro_fem.rings import ring_scene
from macro_fem.scene import build_mesh, build_supports
from rve import InputError
from tests.test_macro_fem.sheets import solve_scene

TURN = Rotation.from_euler("zxy", [-50.0, 25.0, 70.0], degrees=True).as_matrix()
WAYS = [np.eye(3), TURN]


def placed(turn, *place):
    return (turn @ np.array(place, float)).tolist()


def line(turn, edge, first, last, **keys):
    return {"kind": "edge", "edge": edge, "along": [placed(turn, *first), placed(turn, *last)], **keys}


def solved(scene_tables, law, turn, support, wind=30.0, **keys):
    load = {"gravity": placed(turn, 0.0, -9.81, 0.0)}
    load |= {"wind": {"pressure": wind, "direction": placed(turn, 0.0, 0.0, 1.0)}}
    tables = scene_tables(load=load, solver={"stabilising_tension": 0.0, **keys}, mesh={"cells": 4})
    return solve_scene(read_scene({**tables, "support": support}), law)


def work(solution):
    """Work of the loads over their size times that of the curtain, and the balance of all forces."""
    force = solution.problem.force
    balance = (solution.reactions + force).sum(axis=0)
    assert np.abs(balance).max() < 1e-8 * np.linalg.norm(force.sum(axis=0))
    return (force * solution.x).sum() / (np.linalg.norm(force, axis=1).sum() * 100.0)


def test_a_sloping_rail_is_the_turned_rail(ring_like, scene_tables):
    """The top slides on a line along x (a rail in space), and on the same line turned with the whole scene."""
    works, places = [], []
    for turn in WAYS:
        top = line(turn, "top", (0.0, 100.0, 0.0), (100.0, 100.0, 0.0), sliding=True)
        solution = solved(scene_tables, ring_like, turn, top, tolerance=1e-11)
        assert solution.status == "converged"
        works.append(work(solution))
        places.append(solution.x @ turn)
    rail = solved(scene_tables, ring_like, WAYS[0], {"kind": "rail"}, tolerance=1e-11)
    assert works == pytest.approx([work(rail)] * 2, abs=1e-8)
    top = rail.problem.disc.nodes[:, 1] == 100.0
    for x in places:
        assert x[top, 1:] == pytest.approx(rail.x[top, 1:], abs=1e-6)


def test_sides_slide_on_sloping_cables(ring_like, scene_tables):
    """Two cables that lean apart: reactions of the cables are at right angles to them, nodes stay on them."""
    support = [
        line(TURN, "left", (-5.0, 0.0, 10.0), (5.0, 100.0, 0.0), sliding=True),
        line(TURN, "right", (105.0, 0.0, -10.0), (95.0, 100.0, 0.0), sliding=True),
        line(TURN, "top", (5.0, 100.0, 0.0), (95.0, 100.0, 0.0)),
    ]
    solution = solved(scene_tables, ring_like, TURN, support)
    assert solution.status == "converged"
    work(solution)
    left, right, top = solution.problem.supports.held
    size = np.abs(solution.reactions).max()
    for cable in (left, right):
        inner = np.setdiff1d(cable.nodes, top.nodes)
        assert np.abs(solution.reactions[inner] @ cable.slide).max() < 1e-8 * size
        assert np.linalg.norm(solution.reactions[inner], axis=1).max() > 1e-3 * size
        away = solution.x[cable.nodes] - cable.positions
        assert np.linalg.norm(away - np.outer(away @ cable.slide, cable.slide), axis=1).max() < 1e-9
        assert np.linalg.norm(away, axis=1).max() > 1e-3
    assert solution.x[top.nodes] == pytest.approx(top.positions, abs=1e-9)


@pytest.mark.slow
def test_a_plane_scene_slides_on_a_sloping_line(ring_like, scene_tables):
    """A line in the plane keeps the scene in the plane: the turned weight pulls along the turned normal."""
    works = []
    for angle in (0.0, 25.0):
        turn = Rotation.from_euler("z", angle, degrees=True).as_matrix()
        ends = [placed(turn, 0.0, 100.0, 0.0)[:2], placed(turn, 100.0, 100.0, 0.0)[:2]]
        gravity = placed(turn, 0.0, -9.81, 0.0)[:2]
        tables = scene_tables(hang="x", load={"gravity": gravity}, solver={"stabilising_tension": 0.0})
        support = {"kind": "edge", "edge": "top", "along": ends, "sliding": True}
        solution = solve_scene(read_scene({**tables, "support": support}), ring_like)
        assert solution.problem.fem.d == 2
        works.append(work(solution))
    assert works[1] == pytest.approx(works[0], abs=1e-8)


def test_supports_that_do_not_meet_on_a_line_are_refused(ring_like, scene_tables):
    """A top edge whose end is off the cable; a point that is held in part where an edge slides."""
    cable = line(TURN, "left", (0.0, 0.0, 0.0), (0.0, 100.0, 0.0), sliding=True)
    top = line(TURN, "top", (3.0, 100.0, 0.0), (97.0, 100.0, 0.0))
    with pytest.raises(InputError, match="hold the point \\(0, 100\\) at different places"):
        solved(scene_tables, ring_like, TURN, [cable, top])
    point = {"kind": "point", "at": [0.0, 0.0], "held": "y", "move": [0.0, placed(TURN, 0.0, 0.0, 0.0)[1]]}
    with pytest.raises(InputError, match="holds some components of the point \\(0, 0\\), which slides"):
        solved(scene_tables, ring_like, TURN, [cable, point])


def test_rings_one_by_one_do_not_slide_on_a_sloping_line(scene_tables):
    along = [[0.0, 25.0, 0.0], [40.0, 25.0, 30.0]]
    top = {"kind": "edge", "edge": "top", "along": along, "sliding": True}
    scene = read_scene({**scene_tables(width=44.0, height=25.0), "support": top})
    with pytest.raises(InputError, match=r"scene: \[support\] sliding = true: rings slide along x, y or z"):
        ring_scene(scene)


def held_on(along, outline, edge):
    """Places of the nodes of an edge that lies on a line, and where they are in the sheet."""
    curtain = {"shape": "outline", "outline": outline, "areal_mass": 1.0}
    support = {"kind": "edge", "edge": edge, "along": np.asarray(along).tolist()}
    scene = read_scene({"curtain": curtain, "mesh": {"cells": 6}, "support": support})
    mesh = build_mesh(scene, None)
    disc = discretize(mesh.mesh, "P1")
    held = build_supports(scene, mesh, disc).held[0]
    return held.positions[:, :2], disc.nodes[held.nodes]


@pytest.mark.parametrize("angle", [-20.0, -1e-6, 0.0, 20.0, 50.0, 83.0, 89.99, 90.0, 90.000001, 97.0, 130.0])
def test_an_edge_on_its_own_line_stays_where_it_is(angle):
    """From its left or lower end, and where these are two, from either."""
    way = 80.0 * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    if angle > 45.0:  # the right side of a parallelogram, else its top
        edge, ends = "right", (np.array([200.0, 0.0]), np.array([200.0, 0.0]) + way)
        outline = [[0.0, 0.0], ends[0], ends[1], way]
    else:
        edge, ends = "top", (np.array([0.0, 100.0]), np.array([0.0, 100.0]) + way)
        outline = [[0.0, 0.0], way, ends[1], ends[0]]
    for first, last in [ends] + ([ends[::-1]] if angle == -20.0 or angle > 91.0 else []):
        places, X = held_on([[*first, 7.0], [*last, 7.0]], np.array(outline).tolist(), edge)
        np.testing.assert_allclose(places, X, atol=1e-6)


def test_an_edge_whose_lower_end_is_the_left_one_turns_as_the_line_says():
    """A rising edge, and an upright one, on lines that lead the other way: turned by half a circle."""
    outline = [[0, 0], [100, 0], [100, 60], [0, 50]]
    places, X = held_on([[100, 60, 0], [0, 50, 0]], outline, "top")
    np.testing.assert_allclose(places, [100.0, 110.0] - X, atol=1e-6)
    places, X = held_on([[0, 50, 0], [0, 0, 0]], outline, "left")
    np.testing.assert_allclose(places[:, 1], 50.0 - X[:, 1], atol=1e-6)
