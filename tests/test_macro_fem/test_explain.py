"""What a curtain leaves out: the same answer with it forced, and words that agree with what was done."""

import numpy as np

from homogenize import HalfSpaces, default_law
from macro_fem.curtain import solve_problem
from macro_fem.problem import gathered_start, make_problem, stabilising_tension, unit_tensors
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.schema import read_scene
from macro_fem.solvers.central_path import solve_path
from macro_fem.solvers.cones import same_cones
from macro_fem.solvers.path import PathOptions
from tests.test_macro_fem.sheets import posed

LAW = default_law()


def problem(law=LAW, cells=4, support="corners", load=None, hang="y", **solver):
    scene = read_scene(
        {
            "curtain": {"width": 1000.0, "height": 1000.0, "weave_angle": hang},
            "mesh": {"cells": cells},
            "support": {"kind": support},
            "load": load or {},
            "solver": solver,
        }
    )
    return posed(scene, law)


def height_tolerance(solution):
    """The potential is good to `tolerance` times load and size, the mean height to this part of the size."""
    return solution.problem.scene.solver.tolerance * solution.problem.mesh.size


def test_a_coarse_start_leads_to_the_same_answer():
    few = solve_problem(problem(cells=8))
    coarse = solve_problem(problem(cells=8), coarse_from=0)
    assert abs(coarse.mean_height() - few.mean_height()) < height_tolerance(few)


def test_a_load_step_starts_from_the_last_one():
    """Its half-spaces spare steps, its factor pattern is kept, and the answer is the same."""
    load = {"steps": 2, "point": {"at": [500.0, 0.0], "force": [0.1, -0.5]}}
    scene = problem(cells=8, load=load).scene
    mesh = build_mesh(scene, LAW.cell)
    half, full = (make_problem(scene, LAW, mesh, factor) for factor in (0.5, 1.0))
    last = solve_problem(half)
    cold, warm = solve_problem(full), solve_problem(full, last)
    assert warm.status == cold.status == "converged"
    assert abs(warm.mean_height() - cold.mean_height()) < height_tolerance(cold)
    assert warm.iterations < cold.iterations
    assert warm.problem.fem.pattern is last.problem.fem.pattern


def test_all_half_spaces_from_the_start_give_the_same_potential():
    plane = problem(cells=3)
    facets, points = HalfSpaces(LAW.S, LAW.h), plane.disc.n_points
    load = plane.fem.gather(plane.force) + plane.fem.force(stabilising_tension(plane) * unit_tensors(plane))
    start, size = plane.fem.unknowns(gathered_start(plane)), plane.mesh.size
    every = PathOptions(cones=same_cones(facets, points), pruned_at=())
    few, all_of = (solve_path(plane.fem, LAW, load, start, size, one) for one in (PathOptions(), every))
    assert len(all_of.cones) == len(facets.h) * points
    assert abs(few.primal - all_of.primal) < 3e-9 * float(np.abs(plane.force).sum()) * size
