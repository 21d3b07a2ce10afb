"""The elastic curtain through its own solver: closed forms, the rigid limit, iterations that do not grow, refusals."""

from dataclasses import replace

import numpy as np
import pytest

from homogenize import default_law, diagonal_net
from macro_fem import read_scene
from macro_fem.curtain import solve_problem
from macro_fem.fem import discretize
from macro_fem.solvers import PathOptions, Terms, solve_path
from tests.test_macro_fem.sheets import mesh_of, posed, solve_scene, supported

ELASTIC = {"kind": "elastic"}
FREE = ELASTIC | {"stabilising_tension": 0.0}
PER_MM2 = 2.785e-6 * 9.81


def rings(stiffness):
    """The shipped ring law with one stiffness for all directions, N/mm."""
    return replace(default_law(), stiffness=stiffness * np.eye(3), strength=None)


def hanging_strip(locked, stiffness, height, per_mm2):
    """Mean height and potential per width of a strip: stretch t, (t^2 - 1)/2 = locked + S/k, t S = weight below.

    The cubic is solved at Gauss points; 40 of them integrate the smooth stretch to round-off.
    """
    points, weights = np.polynomial.legendre.leggauss(40)
    weights = 0.5 * height * weights
    load = per_mm2 * 0.5 * height * (points + 1.0)
    t = np.array([max(np.real(np.roots([0.5 * stiffness, 0.0, -stiffness * (0.5 + locked), -p]))) for p in load])
    sag = weights @ (load * t)  # of the weight, from the rail: per_mm2 times the integral of the depth
    stored = weights @ (0.5 * stiffness * (0.5 * (t**2 - 1.0) - locked) ** 2)
    return height - sag / (per_mm2 * height), stored - sag + 0.5 * per_mm2 * height**2


@pytest.mark.slow
@pytest.mark.parametrize(("hang", "kind"), [("y", "top"), ("y", "rail"), ("x", "rail")])
@pytest.mark.parametrize(("element", "order", "stiffness"), [("P1", 2, 1.0), ("P2", 4, 1.0), ("P1", 2, 1e3)])
def test_hanging_strips_have_their_closed_form(scene_tables, hang, kind, element, order, stiffness):
    """Stretch = locked + compliance times load. The potential comes from above, at twice the element's order."""
    law = rings(stiffness)
    locked = float(law.support(np.array([[0.0, 0.0, 1.0]] if hang == "y" else [[1.0, 0.0, 0.0]]))[0])
    height = 1000.0
    mean_height, potential = hanging_strip(locked, stiffness, height, PER_MM2)
    errors = []
    for cells in (2, 4):
        tables = scene_tables(hang=hang, width=height, height=height, support={"kind": kind}, solver=ELASTIC)
        tables["mesh"] = {"cells": cells, "element": element, "pattern": "crossed"}
        solution = solve_scene(read_scene(tables), law)
        assert solution.status == "converged"
        errors.append(solution.primal / height - potential)
    scale = PER_MM2 * height**2
    assert -1e-12 * scale < errors[1] <= errors[0] + 1e-12 * scale
    assert errors[0] / errors[1] > 0.8 * 2**order or errors[1] < 1e-10 * scale
    off = (1e-4 if element == "P1" else 1e-6) * height / stiffness
    assert solution.mean_height() == pytest.approx(mean_height, abs=off)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("support", "load"),
    [
        ({"kind": "corners"}, {}),
        ({"kind": "top", "gather": 0.8}, {}),
        ({"kind": "corners"}, {"bar": {"mass": 0.1}}),
        ({"kind": "hooks", "pitch": 50.0, "sliding": True}, {}),
    ],
)
def test_elastic_minus_rigid_is_proportional_to_the_compliance(scene_tables, support, load):
    """k times the fall of the potential tends to a constant, half the least sum of |S|^2; and it is never negative."""
    tables = scene_tables(support=support, load=load)
    rigid = solve_scene(read_scene(tables), default_law())
    elastic = {k: solve_scene(read_scene({**tables, "solver": ELASTIC}), rings(k)) for k in (1e2, 1e3, 1e4)}
    assert {one.status for one in (rigid, *elastic.values())} == {"converged"}
    scaled = [k * (rigid.primal - one.primal) for k, one in elastic.items()]
    assert scaled[0] > 0.0
    assert abs(scaled[2] - scaled[1]) < 0.02 * scaled[2]
    assert abs(scaled[1] - scaled[0]) < 0.1 * scaled[1]
    last = elastic[1e4]
    stored = 0.5 * last.problem.disc.weight @ (last.S**2 @ [1.0, 2.0, 1.0])
    assert scaled[2] == pytest.approx(stored, rel=0.01)


@pytest.mark.parametrize(("hang", "row"), [("y", [[0.0, 0.0, 1.0]]), ("x", [[1.0, 0.0, 0.0]])])
def test_a_strip_of_rings_gives_as_their_wire_does_along_its_load(scene_tables, hang, row):
    """The compliance of the rings differs by a factor of 26 between the two directions."""
    law, row, height = default_law(), np.array(row), 1000.0
    tables = scene_tables(hang=hang, width=height, height=height, support={"kind": "rail"}, solver=ELASTIC)
    tables["mesh"] = {"cells": 4, "element": "P2", "pattern": "crossed"}
    solution = solve_scene(read_scene(tables), law)
    stiffness = 1.0 / float(law.strength.compliance_along(row)[0])
    mean_height, potential = hanging_strip(float(law.support(row)[0]), stiffness, height, PER_MM2)
    assert solution.status == "converged"
    assert solution.primal / height == pytest.approx(potential, abs=1e-9 * PER_MM2 * height**2)
    assert solution.mean_height() == pytest.approx(mean_height, abs=1e-6 * height)


@pytest.mark.parametrize("weave_angle", [0.0, 25.0])
def test_stiff_rings_lower_the_potential_by_half_their_compliance_along_the_stress(scene_tables, weave_angle):
    tables = scene_tables(support={"kind": "corners"})
    tables["curtain"]["weave_angle"] = weave_angle
    law = default_law()
    rigid, falls = solve_scene(read_scene(tables), law), []
    for part in (1.0, 0.1):
        strength = replace(law.strength, compliance=part * law.strength.compliance)
        elastic = solve_scene(read_scene({**tables, "solver": ELASTIC}), replace(law, strength=strength))
        assert elastic.status == "converged"
        S = elastic.S @ getattr(elastic.problem.law, "to_weave", np.eye(3)).T
        size = np.maximum(S[:, 0] + S[:, 2], 1e-12)
        stored = 0.5 * elastic.problem.disc.weight @ (size**2 * strength.compliance_along(S + 1e-12 * np.eye(3)[0]))
        falls.append((rigid.primal - elastic.primal) / stored)
    assert falls == pytest.approx([1.0, 1.0], rel=0.1)


@pytest.mark.parametrize("stiffness", [1e-1, 1e1, 1e3, 1e5])
def test_iterations_do_not_grow_with_stiffness(scene_tables, stiffness):
    tables = scene_tables(width=1000.0, height=1000.0, support={"kind": "corners"}, solver=ELASTIC)
    tables["mesh"] = {"cells": 6, "pattern": "crossed"}
    solution = solve_scene(read_scene(tables), rings(stiffness))
    assert solution.status == "converged"
    assert solution.iterations < 70


@pytest.mark.parametrize("support", [{"kind": "corners"}, {"kind": "top", "gather": 0.8}])
def test_a_straight_bar_stays_straight(scene_tables, support):
    """As in the rigid curtain; it costs energy against a loose bar, and the supports carry it."""
    bar = scene_tables(support=support, load={"bar": {"mass": 3.0}}, solver=ELASTIC)
    solution = solve_scene(read_scene(bar), diagonal_net(1.1))
    assert solution.status == "converged"
    disc = solution.problem.disc
    hem = np.flatnonzero(np.isclose(disc.nodes[:, 1], 0.0))
    x = solution.x[hem[np.argsort(disc.nodes[hem, 0])]]
    even = np.broadcast_to((x[-1] - x[0]) / (len(x) - 1), (len(x) - 1, 2))
    np.testing.assert_allclose(np.diff(x, axis=0), even, atol=1e-9)
    loose = solve_scene(read_scene({**bar, "load": {"bar": {"mass": 3.0, "straight": False}}}), diagonal_net(1.1))
    assert loose.primal <= solution.primal + 1e-9 * abs(solution.primal)
    weight = 9.81 * 3.0 + PER_MM2 * 1e4
    np.testing.assert_allclose(solution.reactions.sum(axis=0), [0.0, weight], atol=1e-8 * weight)


def test_supports_out_of_reach_are_refused_by_proof(scene_tables):
    """Far out of reach ends in the sentence; a hair out of reach is what an elastic law is for."""
    far = scene_tables(support={"kind": "top", "gather": 2.0}, solver=ELASTIC)
    refused = solve_scene(read_scene(far), default_law())
    assert refused.status == "infeasible"
    assert "farther apart than the mesh can stretch" in refused.message
    pulled = [{"kind": "edge", "edge": "top", "move": [0.0, 42.0]}, {"kind": "edge", "edge": "bottom"}]
    tables = {**scene_tables(solver=ELASTIC), "support": pulled}
    assert solve_scene(read_scene(tables), diagonal_net(1.0, 1e3)).status == "infeasible"  # 0.42 > sqrt(2) - 1
    soft = solve_scene(read_scene(tables), diagonal_net(1.0, 1e-3))  # its own weight stretches it by more than that
    assert soft.status == "taut"
    assert "by their stiffness" in soft.message
    assert solve_scene(read_scene({**tables, "solver": {}}), diagonal_net(1.0, 1e-3)).status == "infeasible"


@pytest.mark.parametrize("stiffness", [1.0, 1e3])
def test_the_dual_stress_is_that_of_the_law(scene_tables, stiffness):
    tables = scene_tables(support={"kind": "corners"}, mesh={"cells": 4}, solver=FREE)
    scene, law = read_scene(tables), rings(stiffness)
    problem = posed(scene, law)
    found = solve_problem(problem)
    assert found.status == "converged"
    assert found.relative_gap < 1e-7
    np.testing.assert_allclose(found.S, law.response(found.E).S, atol=3e-3 * np.abs(found.S).max())


@pytest.mark.slow
@pytest.mark.parametrize("S", [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.5, 0.0, 0.5], [0.6, 0.3, 0.4], [0.9, -0.25, 0.1]])
@pytest.mark.parametrize("element", ["P1", "P2"])
def test_patch_in_every_locked_state_of_the_rings(S, element):
    """An edge moved to E* + D S all around: the whole sheet stores what one point does."""
    law = rings(10.0)
    S = 0.2 * np.array(S)
    reach = (law.vertices * [1.0, 2.0, 1.0]) @ S
    touched = law.vertices[reach > reach.max() - 1e-12]
    locked = touched[
        np.argmax(np.minimum(touched[:, 0], touched[:, 2]))
    ]  # of a flat face a state that is not collapsed
    E = locked + S @ law.compliance.T
    C = np.array([[1.0 + 2.0 * E[0], 2.0 * E[1]], [2.0 * E[1], 1.0 + 2.0 * E[2]]])
    values, vectors = np.linalg.eigh(C)
    F = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    disc = discretize(mesh_of(1.0, 1.0, 3, 3), element)
    edge = np.any((disc.nodes == 0.0) | (disc.nodes == 1.0), axis=1)
    u = disc.nodes @ (F - np.eye(2)).T
    fixed = np.repeat(edge[:, None], 2, axis=1)
    start = u + 0.01 * np.random.default_rng(0).standard_normal(u.shape) * ~fixed
    fem = supported(disc, fixed, u)
    z = fem.unknowns(disc.nodes + start)
    how = PathOptions(gap=1e-4)  # of 1e-6 N/mm times the area: without load nothing larger is known
    found = solve_path(fem, law, np.zeros(fem.n), z, 1.0, how, Terms(law.compliance))
    assert found.status == "converged"
    point = law.response(E[None])
    assert point.energy[0] == pytest.approx(0.5 * (S**2 @ [1.0, 2.0, 1.0]) / 10.0, rel=1e-6)
    assert found.primal == pytest.approx(point.energy[0], rel=1e-6)
    np.testing.assert_allclose(found.S, np.broadcast_to(S, found.S.shape), atol=1e-4)


@pytest.mark.parametrize("load", [{}, {"bar": {"mass": 0.1}}])
def test_a_net_that_collapses_to_a_line_has_one_energy(scene_tables, load):
    """Half-spaces and energy are those of two springs: locked parts of its strains may leave I + 2E >= 0."""
    support = {"kind": "top", "gather": 0.7} if load else {"kind": "point", "at": [50.0, 100.0]}
    tables = scene_tables(support=support, load=load, solver=FREE)
    law = diagonal_net(1.0, 1.0)
    found = solve_scene(read_scene(tables), law)
    assert found.status == "converged"
    assert abs(found.relative_gap) < 1e-8
    np.testing.assert_allclose(found.S, law.response(found.E).S, atol=1e-3 * np.abs(found.S).max())
