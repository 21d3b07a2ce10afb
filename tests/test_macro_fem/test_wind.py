"""Wind from a speed: the drag of a screen against published values and both equations of its model, and bad keys."""

import numpy as np
import pytest

import macro_fem
import rve
from homogenize import default_law, diagonal_net
from macro_fem import read_scene
from macro_fem.curtain import (
    P2_PARTS,
    ShapeOptions,
    front_of,
    solve_convex,
    solve_problem,
    solve_shape,
    wind_density,
    wind_drags,
)
from macro_fem.scene import drag_coefficient, ring_solidity
from rve import InputError
from tests.test_macro_fem.sheets import posed, sheet


def with_wind(scene_tables, **wind):
    return read_scene(scene_tables(mesh={"cells": 4}, load={"wind": {"direction": [0.0, 0.0, 2.0], **wind}}))


def wind_force(scene, law):
    """Total force of the wind, N."""
    force = posed(scene, law).force.sum(axis=0)
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


def test_a_speed_is_the_pressure_of_its_drag(scene_tables):
    """C_D rho v^2 / 2 with the solidity of the law's own rings, and in thinner air."""
    law = default_law()
    solidity = rve.solidity(rve.Cell(5.0, 0.5))
    assert ring_solidity(law.cell) == pytest.approx(solidity, rel=1e-9)
    area = 0.1 * 0.1
    by_speed = wind_force(with_wind(scene_tables, speed=20.0), law)
    assert by_speed == pytest.approx(0.5 * drag_coefficient(solidity) * 1.25 * 400.0 * area, rel=1e-9)
    thin = with_wind(scene_tables, speed=20.0, air_density=1.0)
    assert wind_force(thin, law) == pytest.approx(by_speed / 1.25, rel=1e-12)


def hung(support, wind, **mesh):
    return sheet(3000.0, 2300.0, 4, support, mesh, {"wind": {"direction": [0.0, 0.0, 1.0], **wind}})


@pytest.mark.parametrize("element", ["P1", "P2"])
@pytest.mark.parametrize("keys", [{}, {"follows": True}])
def test_a_flat_curtain_square_to_the_wind_is_one_layer(element, keys):
    """Also one that is made of nodes laid flat anywhere across the wind."""
    problem = posed(hung({"kind": "top"}, {"speed": 15.0, **keys}, element=element))
    flat = drag_coefficient(ring_solidity(problem.law.cell))
    density = wind_density(problem, problem.fem.reference + np.array([7.0, 5.0, 300.0]))
    assert density == pytest.approx(np.tile([0.0, 0.0, 0.5e-6 * 1.25 * 225.0 * flat], (len(density), 1)), rel=1e-9)


@pytest.mark.parametrize("width", [1.0, 0.5])
def test_layers_of_a_gathered_half_beside_a_flat_half(width):
    """The half of the mesh that is drawn to a part of its width has 1/width layers, the other one, away from it, 1."""
    problem = posed(hung({"kind": "top"}, {"speed": 15.0}, cells=8))
    x = problem.fem.reference.copy()
    x[:, 0] = np.where(x[:, 0] > 1500.0, x[:, 0], 1500.0 + width * (x[:, 0] - 1500.0))
    density = wind_density(problem, x)[:, 2]
    middle = problem.disc.points[:, 0]
    plate = 0.5e-6 * 1.25 * 225.0
    layered = drag_coefficient(1.0 - (1.0 - ring_solidity(problem.law.cell)) ** (1.0 / width)) * width
    alone = drag_coefficient(ring_solidity(problem.law.cell))
    assert density[middle < 1000.0] == pytest.approx(plate * layered, rel=1e-9)
    assert density[middle > 2000.0] == pytest.approx(plate * alone, rel=1e-9)
    assert 0.0 < layered <= 4.0 / 3.0 * width


def by_pixels(problem, x, along, across=1000):
    """Front in mm2 and drag in N of a shape by counting: each of `across` pixels a longer side is behind as many
    layers as the reference areas of the triangles over it are more than what they show there."""
    away = np.eye(3)[np.abs(along).argmin()]
    one = np.cross(along, away) / np.linalg.norm(np.cross(along, away))
    y, disc, parts = x @ np.column_stack([one, np.cross(along, one)]), problem.disc, P2_PARTS
    corners = y[disc.cell_dofs[:, parts if disc.element == "P2" else [[0, 1, 2]]]].reshape(-1, 3, 2)
    whole = np.repeat(disc.cell_area, len(corners) // disc.n_cells) * disc.n_cells / len(corners)
    low, pixel = y.min(axis=0), np.ptp(y, axis=0).max() / across
    layers = np.zeros(np.ceil(np.ptp(y, axis=0) / pixel).astype(int) + 1)
    for (a, b, c), reference in zip((corners - low) / pixel, whole, strict=True):
        turn = np.linalg.det([b - a, c - a])
        begin, end = (np.floor(f(np.stack([a, b, c]), axis=0)).astype(int) for f in (np.min, np.max))
        p = np.stack(np.meshgrid(*(np.arange(m, n + 1) + 0.5 for m, n in zip(begin, end, strict=True))), axis=-1)
        inside = [
            (v[0] - u[0]) * (p[..., 1] - u[1]) - (v[1] - u[1]) * (p[..., 0] - u[0]) for u, v in ((a, b), (b, c), (c, a))
        ]
        is_in = (np.array(inside) * np.sign(turn)).min(axis=0) >= 0.0
        if abs(turn) * pixel**2 > 1e-9 * reference:
            at = tuple((p[is_in] - 0.5).astype(int).T)
            layers[at] += 2.0 * reference / (abs(turn) * pixel**2)
    drag = drag_coefficient(1.0 - (1.0 - ring_solidity(problem.law.cell)) ** layers[layers > 0.0]).sum()
    return (layers > 0.0).sum() * pixel**2, 0.5e-6 * 1.25 * 225.0 * drag * pixel**2


def folded(X, rng):
    """Two layers with a little way between, the upper one shorter."""
    x = np.column_stack(
        [np.where(X[:, 0] > 1700.0, 3400.0 - X[:, 0], X[:, 0]), X[:, 1], np.maximum(X[:, 0] - 1700.0, 0.0) / 99]
    )
    return x @ np.linalg.qr(rng.standard_normal((3, 3)))[0]


def twisted(X, rng):
    """One turn and a quarter over the height, which is drawn to its half."""
    angle = 2.5 * np.pi * X[:, 1] / 2300.0
    return np.column_stack([(X[:, 0] - 1500.0) * np.cos(angle), 0.5 * X[:, 1], (X[:, 0] - 1500.0) * np.sin(angle)])


def gathered(X, rng):
    """Waves of a quarter of the width, slanted."""
    return np.column_stack(
        [0.4 * X[:, 0] + 300.0 * np.sin(X[:, 0] / 120.0), X[:, 1] + 0.2 * X[:, 0], 400.0 * np.cos(X[:, 0] / 120.0)]
    )


def crumpled(X, rng):
    return np.column_stack([X, 0.0 * X[:, 0]]) @ rng.standard_normal((3, 3)) + 150.0 * rng.standard_normal((len(X), 3))


@pytest.mark.slow
@pytest.mark.parametrize("shape", [folded, twisted, gathered, crumpled])
@pytest.mark.parametrize(("cells", "element"), [(5, "P1"), (14, "P1"), (4, "P2")])
def test_front_and_drag_are_those_that_pixels_count(shape, cells, element):
    """In winds along an axis and aslant, at every number of cells; and never more than those of a plate."""
    rng, along = np.random.default_rng(cells), np.array([0.48, 0.36, 0.8])
    for direction in ([0.0, 0.0, 1.0], along.tolist()):
        wind = {"speed": 15.0, "direction": direction}
        problem = posed(hung({"kind": "top"}, wind, cells=cells, element=element))
        x, along = shape(problem.disc.nodes, rng), np.array(direction)
        front, drag = by_pixels(problem, x, along)
        seen = front_of(problem, x, along)
        density = wind_density(problem, x)
        assert seen.area.sum() == pytest.approx(front, rel=1e-3)
        assert problem.disc.weight @ density @ along == pytest.approx(drag, rel=1e-3)
        assert (density @ along).min() >= 0.0
        assert 0.0 < drag < 4.0 / 3.0 * 0.5e-6 * 1.25 * 225.0 * front


@pytest.mark.parametrize("cells", [8, pytest.param(24, marks=pytest.mark.slow)])
def test_the_summary_of_a_gathered_curtain_tells_what_pixels_count(cells):
    """The track of fullness 1.05 whose folds a sum over the cells that do not touch counted 3.5 % short."""
    track = {"kind": "track", "fullness": 1.05, "height": 600.0, "count": 5}
    loads = {"wind": {"direction": [0.0, 0.0, 1.0], "speed": 15.0}, "bar": {"mass": 40.0, "straight": False}}
    solution = solve_problem(posed(sheet(1200.0, 600.0, cells, track, {}, loads)))
    (told,) = wind_drags(solution)
    front, drag = by_pixels(solution.problem, solution.x, np.array([0.0, 0.0, 1.0]))
    assert told.front_area_m2 == pytest.approx(1e-6 * front, rel=1e-3)
    assert told.layers == pytest.approx(0.72e6 / front, rel=1e-3)
    assert told.drag_N == pytest.approx(drag, rel=1e-3)


@pytest.mark.parametrize("speed", [3.0, pytest.param(12.0, marks=pytest.mark.slow)])
def test_a_strip_swings_out_of_the_wind_to_a_closed_form(speed):
    """A straight strip at the angle t from the vertical: tan t = q C_D(1/cos t layers) cos t over its weight."""
    problem = posed(hung({"kind": "top"}, {"speed": speed}) | {"curtain": {"width": 200.0, "height": 2000.0}})
    solution = solve_problem(problem)
    assert solution.status == "converged", solution.message
    law, q = problem.law, 0.5 * 1.25 * speed**2
    F = solution.F
    length = float(np.linalg.norm(F[:, :, 1], axis=1).mean())
    front = np.abs(np.cross(F[:, :, 0], F[:, :, 1])[:, 2])
    s = ring_solidity(law.cell)
    per_area = drag_coefficient(1.0 - (1.0 - s) ** float(1.0 / front.mean())) * q * front.mean()
    weight = law.cell.areal_mass_kg_per_m2 * 9.81
    low = solution.x[problem.disc.nodes[:, 1] == 0.0].mean(axis=0) - [100.0, 2000.0, 0.0]
    assert length == pytest.approx(1.0, abs=0.05)
    assert low[2] / -low[1] == pytest.approx(per_area / weight, rel=0.03)


@pytest.mark.release
@pytest.mark.parametrize("speed", [12.0, 25.0, 37.0])
def test_a_strip_in_wind_that_follows_comes_to_rest_at_a_closed_form(speed):
    """At the angle t from the vertical: q C_D cos^2 t per present area against its weight's part along the normal."""
    wind = {"speed": speed, "follows": True}
    problem = posed(hung({"kind": "top"}, wind) | {"curtain": {"width": 200.0, "height": 2000.0}})
    solution = solve_problem(problem)
    assert solution.status == "converged", solution.message
    size = float(np.linalg.norm(np.cross(solution.F[:, :, 0], solution.F[:, :, 1]), axis=1).mean())
    s = ring_solidity(problem.law.cell)
    press = drag_coefficient(1.0 - (1.0 - s) ** (1.0 / size)) * 0.5 * 1.25 * speed**2 * size
    part = problem.law.cell.areal_mass_kg_per_m2 * 9.81 / (2.0 * press)
    t = np.arcsin(np.sqrt(part**2 + 1.0) - part)
    low = solution.x[problem.disc.nodes[:, 1] == 0.0].mean(axis=0) - [100.0, 2000.0, 0.0]
    assert np.arctan2(low[2], -low[1]) == pytest.approx(t, rel=0.02)
    assert wind_drags(solution)[0].front_area_m2 == pytest.approx(0.4 * size * np.cos(t), rel=0.02 * t)


@pytest.mark.release
def test_a_drawn_track_in_wind_that_follows_comes_to_rest():
    """3000 x 2300 mm on a track of radius 1500 mm at fullness 1.5; supports carry the drag along the wind."""
    track = {"kind": "track", "radius": 1500.0, "fullness": 1.5}
    solution = solve_problem(posed(hung(track, {"speed": 15.0, "follows": True}, cells=8)))
    assert solution.status == "converged", solution.message
    (told,) = wind_drags(solution)
    assert -solution.reactions[:, 2].sum() == pytest.approx(told.drag_N, abs=solution.noise)
    assert told.drag_N < 4.0 / 3.0 * 0.5 * 1.25 * 225.0 * told.front_area_m2


def test_wind_without_rest_says_so():
    problem = posed(hung({"kind": "top"}, {"speed": 30.0, "follows": True}, cells=2))
    solution = solve_shape(problem, None, solve_convex, options=ShapeOptions(rounds=2))
    assert solution.status == "unsettled"
    assert "has no rest; take less wind, a heavier bar at its lower edge, or a pressure that" in solution.message


@pytest.mark.parametrize(("speed", "mass"), [(8.0, 0.9), pytest.param(23.0, 3.0, marks=pytest.mark.slow)])
def test_drag_of_a_gathered_sheet_with_a_bar_comes_to_rest(speed, mass):
    """Its rigid rings leave open how far single cells fold."""
    loads = {"wind": {"direction": [0.0, 0.0, 1.0], "speed": speed}, "bar": {"mass": mass}}
    solution = solve_problem(posed(sheet(1200.0, 900.0, 8, {"kind": "top", "gather": 0.7}, {}, loads)))
    assert solution.status == "converged", solution.message
    assert -solution.reactions[:, 2].sum() == pytest.approx(wind_drags(solution)[0].drag_N, rel=1e-4)


@pytest.mark.release
def test_folds_that_find_no_rest_in_drag_are_smoothed_and_the_answer_says_so():
    loads = {"wind": {"direction": [0.0, 0.0, 1.0], "speed": 18.4}, "bar": {"mass": 2.7}}
    solution = solve_problem(posed(sheet(600.0, 400.0, 12, {"kind": "hooks", "pitch": 200.0}, {}, loads)))
    assert solution.status == "converged", solution.message
    assert solution.message.endswith("; its folds came to rest in the wind with stabilising_tension = 0.001")
    assert -solution.reactions[:, 2].sum() == pytest.approx(wind_drags(solution)[0].drag_N, rel=1e-3)


@pytest.mark.slow
def test_folds_of_elastic_rings_come_to_rest_in_drag_too():
    """The even tension stays in their load; without it forces of 5e-3 of the loads turned after 44 rounds."""
    hooks, wind = {"kind": "hooks", "pitch": 150.0, "gather": 0.8}, {"direction": [0.0, 0.0, 1.0], "speed": 18.0}
    solution = solve_problem(posed(sheet(600.0, 800.0, 6, hooks, {}, {"wind": wind}, {"kind": "elastic"})))
    assert solution.status == "converged", solution.message
    assert -solution.reactions[:, 2].sum() == pytest.approx(wind_drags(solution)[0].drag_N, rel=1e-3)


@pytest.mark.slow
def test_a_track_drawn_to_its_half_takes_less_than_a_plate():
    """3000 x 2300 mm on a track of radius 1500 mm at fullness 1.5: the half-open front is 1.0 m wide."""
    drags = []
    for drawn in (1.0, 0.5):
        track = {"kind": "track", "radius": 1500.0, "fullness": 1.5, "drawn": drawn}
        solution = solve_problem(posed(hung(track, {"speed": 15.0}, cells=8)))
        assert solution.status == "converged", solution.message
        (told,) = wind_drags(solution)
        plate = 4.0 / 3.0 * 0.5 * 1.25 * 225.0 * told.front_area_m2
        assert told.drag_N <= plate
        assert -solution.reactions[:, 2].sum() == pytest.approx(told.drag_N, rel=1e-5)
        assert told.layers * told.front_area_m2 == pytest.approx(6.9, rel=1e-9)
        drags.append(told.drag_N)
    assert drags[1] < 0.75 * drags[0] < 0.75 * 742.0
    assert drags[1] < 420.0


def test_a_law_without_rings_tells_no_drag(scene_tables):
    scene, law = with_wind(scene_tables, speed=3.0), diagonal_net()
    with pytest.raises(InputError, match=r"scene: \[load.wind\] speed = 3: the law has no rings to tell the drag"):
        posed(scene, law)


@pytest.mark.slow
def test_the_summary_tells_drag_and_pressure(scene_tables):
    scene = with_wind(scene_tables, speed=10.0)
    (told,) = macro_fem.solve(scene).summary["wind"]
    assert told["solidity"] == pytest.approx(0.3606, abs=2e-3)
    assert told["drag_coefficient"] == drag_coefficient(told["solidity"])
    assert told["pressure_N_per_m2"] == pytest.approx(62.5 * told["drag_coefficient"])
    assert "wind" not in macro_fem.solve(with_wind(scene_tables, pressure=5.0)).summary
