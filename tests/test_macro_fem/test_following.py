"""Pressure that follows the surface: the Mylar balloon, and what it does to a flat sheet."""

from dataclasses import replace

import numpy as np
import pytest

from homogenize import ClothLaw
from macro_fem import read_scene
from macro_fem.curtain import make_problem, solve_problem, wind_density
from macro_fem.fem import load_vector
from macro_fem.scene import Sliding, Supports, build_mesh

DISK = 100.0
RADIUS = 0.762760 * DISK
THICKNESS = 1.198140 * RADIUS
VOLUME = 2.745812 * RADIUS**3
PRESSURE = 1e-3
"""N/mm2."""


def quarter(cells):
    """A quarter of one disk of the balloon: its rim slides in its plane, its straight sides in planes of symmetry."""
    angle = np.linspace(0.0, 0.5 * np.pi, 2 * cells + 1)
    arc = DISK * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    arc[-1, 0] = 0.0
    wind = {"pressure": 1000.0, "direction": [0.0, 0.0, 1.0], "follows": True}
    tables = {
        "curtain": {"shape": "outline", "outline": [[0.0, 0.0], *arc.tolist()], "areal_mass": 0.1},
        "mesh": {"cells": cells},
        "support": {"kind": "edge", "edge": "outline"},
        "load": {"gravity": 0.0, "wind": wind},
    }
    scene = read_scene(tables)
    problem = make_problem(scene, ClothLaw(), build_mesh(scene, None))
    X = problem.disc.nodes
    rim = np.hypot(X[:, 0], X[:, 1]) > DISK * np.cos(np.pi / (8 * cells)) - 1e-6
    mask = np.column_stack([X[:, 0] < 1e-9, X[:, 1] < 1e-9, rim])
    places = np.where(mask, 0.0, np.column_stack([X, np.zeros(len(X))]))
    supports = Supports((), mask, places, Sliding.none(3), Sliding.none(3))
    return replace(problem, supports=supports, fem=supports.fem(problem.disc))


def measured(solution):
    """Radius, thickness and volume of the whole balloon."""
    x, disc = solution.x, solution.problem.disc
    rim = solution.problem.supports.mask[:, 2]
    up = np.cross(solution.F[:, :, 0], solution.F[:, :, 1])[:, 2] * disc.weight  # P1: one point per cell
    volume = 8.0 * float(up @ x[disc.cell_dofs, 2].mean(axis=1))
    return np.hypot(x[rim, 0], x[rim, 1]).mean(), 2.0 * x[:, 2].max(), volume


def test_pressure_pushes_along_the_surface_and_its_resultant_is_that_of_the_rim():
    """The vector area of any surface is that of its rim; the force of a uniform pressure is pressure times it."""
    problem = quarter(3)
    rng = np.random.default_rng(5)
    x = problem.fem.reference + rng.normal(scale=5.0, size=(problem.disc.n_nodes, 3))
    force = load_vector(problem.disc, wind_density(problem, x))
    flat = load_vector(problem.disc, wind_density(problem, problem.fem.reference))
    area = problem.disc.weight.sum()
    assert flat.sum(axis=0) == pytest.approx([0.0, 0.0, PRESSURE * area], abs=1e-12)
    mesh = problem.mesh.mesh
    ends = mesh.facets[:, mesh.boundary_facets()]
    middle = mesh.p[:, ends].mean(axis=1).T - mesh.p.mean(axis=1)
    along = (mesh.p[:, ends[1]] - mesh.p[:, ends[0]]).T
    turn = np.sign(middle[:, 0] * along[:, 1] - middle[:, 1] * along[:, 0])
    rim = 0.5 * (turn[:, None] * np.cross(x[ends[0]], x[ends[1]])).sum(axis=0)
    assert force.sum(axis=0) == pytest.approx(PRESSURE * rim, rel=1e-9)


@pytest.mark.slow
def test_half_of_a_mylar_balloon_on_a_coarse_mesh():
    solution = solve_problem(quarter(4))
    assert solution.status == "converged", solution.message
    assert solution.settling.is_settled
    radius, thickness, volume = measured(solution)
    assert radius == pytest.approx(RADIUS, rel=0.01)
    assert thickness == pytest.approx(THICKNESS, rel=0.03)
    assert 0.93 * VOLUME < volume < VOLUME
    push = solution.problem.force.sum(axis=0) + solution.reactions.sum(axis=0)
    assert np.abs(push).max() < 1e-8 * np.abs(solution.problem.force).sum()


@pytest.mark.release
def test_mylar_balloon_to_one_percent_with_ten_cells_per_radius():
    coarse, fine = (measured(solve_problem(quarter(cells))) for cells in (5, 10))
    assert np.abs(np.array(fine) / np.array([RADIUS, THICKNESS, VOLUME]) - 1.0).max() < 0.01
    assert VOLUME - fine[2] < 0.4 * (VOLUME - coarse[2])
