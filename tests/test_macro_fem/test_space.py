"""Curtains in space: what takes a scene there, that plane ones stay what they are, turned ones turn, forces balance."""

import json
from dataclasses import replace
from pathlib import Path
from typing import get_args

import meshio
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from homogenize import default_law
from macro_fem import compare, load_scene, read_scene, solve
from macro_fem.curtain import gathered_start
from macro_fem.output import features
from macro_fem.scene import HeldAxes
from macro_fem.solvers import green_strain, load_scale
from rve import InputError
from tests.test_macro_fem.clarabel_oracle import curtain_by_clarabel
from tests.test_macro_fem.sheets import posed, sheet, solve_scene

LAW = default_law()
EXAMPLES = sorted((Path(__file__).resolve().parents[2] / "examples").glob("*.toml"))
PLANE_EXAMPLES = [scene for scene in map(load_scene, EXAMPLES) if not scene.in_space]
UP = {"kind": "edge", "edge": "bottom", "move": [0.0, 400.0, 300.0]}
WIND = {"pressure": 6.0, "direction": [0.0, 0.0, -2.0]}


def tables(support, load=None, cells=4, width=500.0, height=500.0, solver=None, **curtain):
    return sheet(width, height, cells, support, load=load or {}, solver=solver or {}, **curtain)


SMALL = {
    "hammock": tables([{"kind": "top"}, UP]),
    "wind on corners": tables({"kind": "corners", "gather": 0.9}, {"wind": WIND}),
    "net held at points": tables(
        [
            {"kind": "point", "at": [x, y], "move": [0.1 * (250.0 - x), -0.1 * y, 0.2 * y]}
            for x in (0.0, 500.0)
            for y in (0.0, 500.0)
        ],
        {"point": {"at": [250.0, 250.0], "force": [1.0, 0.5, 3.0]}},
    ),
    "sliding rail": tables({"kind": "rail"}, {"edge": {"edge": "bottom", "force": [0.0, 0.0, 2e-3]}}, weave_angle="x"),
    "bar and patch": tables(
        {"kind": "top", "gather": 0.8, "move": [0.0, 0.0, 100.0]},
        {"bar": {"mass": 0.5}, "patch": {"at": [250.0, 200.0], "radius": 100.0, "force": [0.0, 0.0, -2.0]}},
    ),
}  # fmt: skip


def scale(solution):
    """The unit of a potential: total load times size, N mm."""
    problem = solution.problem
    return load_scale(problem.force, problem.disc.weight) * problem.mesh.size


def forced(scene):
    """The scene with the third coordinate, without bounds, and the same scene in the plane."""
    plane = replace(scene, solver=replace(scene.solver, bounds=False, adapt=0))
    return replace(plane, solver=replace(plane.solver, space=True)), plane


@pytest.mark.parametrize(
    ("support", "load", "solver", "why"),
    [
        ([{"kind": "top"}, UP], {}, {}, "[support] move = [0.0, 400.0, 300.0]"),
        ({"kind": "top"}, {"gravity": [0.0, -9.0, 1.0]}, {}, "[load] gravity = [0.0, -9.0, 1.0]"),
        ({"kind": "top"}, {"point": {"at": [0, 0], "force": [0, 0, 1]}}, {}, "[load.point] force = [0.0, 0.0, 1.0]"),
        ({"kind": "top"}, {"edge": {"edge": "left", "force": [0, 0, 1]}}, {}, "[load.edge] force = [0.0, 0.0, 1.0]"),
        ({"kind": "top"}, {"wind": WIND}, {}, "[load.wind] direction = [0.0, 0.0, -2.0]"),
        ({"kind": "top"}, {}, {"space": True}, "[solver] space = true"),
        ({"kind": "top"}, {}, {}, ""),
        ({"kind": "top", "move": [0.0, 1.0, 0.0]}, {"gravity": [1.0, -9.0, 0.0]}, {}, ""),
        ({"kind": "top"}, {"wind": {"pressure": 6.0, "direction": [1.0, 0.0]}}, {}, ""),
    ],
)
def test_a_scene_says_why_it_needs_a_third_coordinate(support, load, solver, why):
    scene = read_scene(tables(support, load, solver=solver))
    assert scene.in_space == bool(why)
    assert scene.space_reason.startswith(why)
    problem = posed(scene, LAW)
    assert problem.fem.d == problem.force.shape[1] == scene.d == (3 if why else 2)


@pytest.mark.parametrize("held", get_args(HeldAxes))
def test_held_names_the_components(held):
    support = [{"kind": "top"}, {"kind": "edge", "edge": "bottom", "held": held}]
    problem = posed(tables(support, {"wind": WIND}), LAW)
    nodes = problem.supports.held[1].nodes
    expected = [held == "both" or axis in held for axis in "xyz"]
    assert (problem.supports.mask[nodes] == expected).all()
    assert (problem.fem.held[nodes] == expected).all()


def test_loads_have_the_sum_and_direction_that_are_asked_for():
    load = {
        "gravity": [1.0, 2.0, -3.0],
        "wind": [WIND, {"pressure": 2.0, "direction": [3.0, 4.0]}],
        "bar": {"mass": 2.0, "straight": False},
        "edge": {"edge": "left", "force": [1e-3, 0.0, 2e-3]},
    }
    force = posed(tables({"kind": "top"}, load, areal_mass=2.0), LAW, 0.5).force.sum(axis=0)
    area = 0.25  # m2
    weight = (2.0 * area + 2.0) * np.array([1.0, 2.0, -3.0])
    live = area * np.array([1.2, 1.6, -6.0]) + np.array([0.5, 0.0, 1.0])
    assert np.allclose(force, weight + 0.5 * live, rtol=1e-12)


def assert_same_potential(scene, law=LAW):
    space, plane = (solve_scene(one, law) for one in forced(scene))
    assert space.problem.fem.d == 3
    assert plane.problem.fem.d == 2
    assert space.status == plane.status
    if plane.elastic or plane.status == "converged":
        assert abs(space.primal - plane.primal) < 1e-8 * scale(plane)


@pytest.mark.parametrize("kind", ["rigid", "elastic"])
def test_a_plane_curtain_stays_in_the_plane(kind):
    load = {"point": {"at": [250.0, 0.0], "force": [0.3, -0.5]}}
    scene = read_scene(tables({"kind": "top", "gather": 0.9}, load, solver={"kind": kind}))
    space, plane = (solve_scene(one, LAW) for one in forced(scene))
    assert abs(space.primal - plane.primal) < 1e-8 * scale(plane)
    assert np.abs(space.x[:, 2]).max() < 1e-4 * space.problem.mesh.size
    assert np.abs(space.x[:, :2] - plane.x).max() < 1e-2 * space.problem.mesh.size
    assert space.verdict.status == plane.verdict.status == "converged"


def quick(scene):
    return scene.source.stem in ("corner_hung", "round_net")


@pytest.mark.parametrize(
    "scene",
    [pytest.param(one, id=one.source.stem, marks=() if quick(one) else pytest.mark.slow) for one in PLANE_EXAMPLES],
)
def test_a_coarse_plane_example_has_the_same_potential_in_space(scene):
    assert_same_potential(replace(scene, mesh=replace(scene.mesh, cells=min(12, scene.mesh.cells))))


def test_a_scene_turned_as_a_whole_gives_the_turned_answer():
    """Supports, gravity and loads turned about a slanted axis: the same curtain in another place."""
    R = Rotation.from_euler("zyx", [35.0, -70.0, 110.0], degrees=True).as_matrix()
    corners = np.array([[0.0, 500.0, 0.0], [500.0, 500.0, 0.0], [0.0, 0.0, 0.0]])
    moves = np.array([[40.0, 0.0, 0.0], [-40.0, 0.0, 0.0], [30.0, 60.0, 80.0]])

    def turned(A):
        support = [
            {"kind": "point", "at": X[:2].tolist(), "move": (A @ (X + move) - X).tolist()}
            for X, move in zip(corners, moves, strict=True)
        ]
        load = {
            "gravity": (A @ [0.0, -9.81, 0.0]).tolist(),
            "point": {"at": [500.0, 0.0], "force": (A @ [0.5, -0.5, 1.0]).tolist()},
            "wind": {"pressure": 10.0, "direction": (A @ [0.3, 0.0, -1.0]).tolist()},
        }
        return solve_scene(read_scene(tables(support, load)), LAW)

    plain, other = turned(np.eye(3)), turned(R)
    assert plain.status == other.status == "converged"
    work = [float((one.problem.force * one.x).sum()) for one in (plain, other)]
    assert abs(work[0] - work[1]) < 1e-9 * scale(plain)
    assert np.abs(other.x - plain.x @ R.T).max() < 1e-5 * plain.problem.mesh.size
    assert np.abs(other.reactions - plain.reactions @ R.T).max() < 1e-6 * np.abs(plain.problem.force).sum()
    assert np.allclose(other.problem.frame, R @ plain.problem.frame, atol=1e-12)


@pytest.mark.parametrize("name", SMALL)
def test_clarabel_agrees_and_forces_balance(name):
    ours = solve_scene(read_scene(SMALL[name]), LAW)
    theirs = curtain_by_clarabel(ours.problem)
    assert ours.problem.fem.d == theirs.problem.fem.d == 3
    assert ours.status == theirs.status == "converged"
    assert abs(ours.primal - theirs.primal) < 1e-7 * scale(ours)
    force = ours.problem.force
    assert np.abs(force.sum(axis=0) + ours.reactions.sum(axis=0)).max() < 1e-8 * np.abs(force).sum()
    moment = np.cross(ours.x, force + ours.reactions).sum(axis=0)
    assert np.abs(moment).max() < 1e-5 * scale(ours)


def test_load_steps_end_where_one_step_does():
    one = solve(read_scene(SMALL["hammock"]), LAW)
    many = solve(read_scene(SMALL["hammock"] | {"load": {"steps": 3}}), LAW)
    assert [step.status for step in many.steps] == ["converged"] * 3
    assert abs(one.solution.primal - many.solution.primal) < 1e-8 * scale(one.solution)
    places = [step.problem.supports.positions[:, 2].max() for step in many.steps]
    assert np.allclose(places, [100.0, 200.0, 300.0])


def test_supports_out_of_reach_in_space_are_refused_and_taut_ones_are_named():
    far = tables([{"kind": "top"}, {"kind": "edge", "edge": "bottom", "move": [0.0, 0.0, 100.0]}])
    with pytest.raises(InputError, match="farther apart than the mesh can stretch"):
        solve(read_scene(far), LAW)
    taut = tables([{"kind": "top"}, {"kind": "edge", "edge": "bottom", "move": [0.0, 200.0, 400.0]}])
    assert solve(read_scene(taut), LAW).status == "taut"  # 300 and 400 mm make 500 mm, the length of the mesh


def test_the_start_is_slack_and_turns_with_the_supports():
    problem = posed(SMALL["net held at points"], LAW)
    start = gathered_start(problem)
    assert np.linalg.svd(problem.fem.gradient(problem.fem.unknowns(start)), compute_uv=False).max() < 1.2
    E = green_strain(np.linalg.lstsq(problem.disc.nodes - 250.0, start - start.mean(axis=0), rcond=None)[0].T[None])
    assert np.linalg.eigvalsh([[E[0, 0], E[0, 1]], [E[0, 1], E[0, 2]]]).max() < 1e-9


def test_a_free_sliding_along_z_is_pinned_and_carries_nothing():
    load = {"gravity": 9.81, "wind": [WIND, WIND | {"direction": [0.0, 0.0, 1.0]}]}
    found = solve_scene(read_scene(tables({"kind": "edge", "edge": "top", "held": "xy"}, load)), LAW)
    assert found.status == "converged"
    assert found.problem.supports.pins.direction.tolist() == [[0.0, 0.0, 1.0]]
    assert np.abs(found.x[:, 2]).max() < 1e-3 * found.problem.mesh.size
    assert not found.reactions[:, 2].any()


def test_files_of_a_curtain_in_space(tmp_path):
    found = solve(read_scene(SMALL["hammock"]), LAW)
    summary = found.save(tmp_path, picture=False)
    x = found.solution.x
    assert summary["out_of_plane_mm"] == np.abs(x[:, 2]).max() == 300.0
    assert summary["lowest_point_at_mm"][1] == summary["lowest_point_mm"] == x[:, 1].min()
    assert summary["centre_of_gravity_mm"][1] == pytest.approx(summary["mean_height_mm"])
    assert 0.0 < summary["centre_of_gravity_mm"][2] < 300.0
    rows = (tmp_path / "support_forces.csv").read_text().splitlines()
    assert rows[0].endswith("force_x_N,force_y_N,force_z_N,place_x_mm,place_y_mm,place_z_mm,point")
    forces = np.array([row.split(",")[4:7] for row in rows[1:]], float)
    total = json.loads((tmp_path / "summary.json").read_text())["total_load_N"]
    assert np.allclose(forces.sum(axis=0), -np.array(total), atol=1e-8 * np.abs(total).sum())
    assert {row.split(",")[-2] for row in rows[1:]} == {"0.0", "300.0"}
    vtu = meshio.read(tmp_path / "curtain.vtu")
    assert np.allclose(vtu.points + vtu.point_data["displacement_mm"], found.solution.x, atol=1e-9)
    assert np.allclose(vtu.point_data["support_force_N"], found.loaded.reactions, atol=1e-9)
    told = {one.feature: one for one in features(found.solution, bounds=False)}
    assert told["third-coordinate"].used


RING_PIECE = {"curtain": {"width": 66.0, "height": 75.876417741}, "mesh": {"cells": 6}, "support": {"kind": "top"}}


@pytest.mark.slow
def test_rings_one_by_one_hang_in_the_wind_as_the_membrane_does():
    compared = compare(read_scene(RING_PIECE | {"load": {"wind": {"pressure": 20.0, "direction": [0.0, 0.0, 1.0]}}}))
    disk, rings, summary = compared.disk, compared.rings, compared.summary
    assert summary["rings"]["status"] == disk.status == "converged"
    assert disk.x[:, 2].max() > 40.0
    assert summary["shape_distance_mm"] < 1.0  # a ring has 10
    assert summary["line_load_distance"] < 0.1
    held = rings.scene.groups[0][1]
    assert np.allclose(rings.found.reaction[held].reshape(-1, 3).sum(axis=0), disk.reactions.sum(axis=0), atol=1e-6)


@pytest.mark.parametrize("name", ["wind on corners", "bar and patch"])
def test_the_even_tension_of_slack_parts_is_taken_out_of_the_bounds(name):
    """Both values of a curtain with it hold for the load alone, whose potential is known to 1e-9 without it."""
    alone, spread = (
        solve_scene(read_scene(SMALL[name] | {"solver": {"stabilising_tension": tension}}), LAW)
        for tension in (0.0, 1e-3)
    )
    assert alone.relative_gap < 1e-8
    unit = scale(alone)
    assert spread.dual < alone.primal - 1e-4 * unit  # by what the tension may do at most
    assert alone.primal - 1e-8 * unit < spread.primal < alone.primal + 1e-3 * unit
    assert alone.primal - spread.dual < 1e-2 * unit
