"""What a curtain leaves out: the same answer with it forced."""

import pytest

from benchmarks.omissions import curtains
from benchmarks.problems import square
from homogenize import default_law
from macro_fem import read_scene
from macro_fem.curtain import make_problem, solve_problem
from macro_fem.scene import build_mesh

LAW = default_law()


@pytest.mark.slow
def test_forced_features_of_curtains_change_no_result(monkeypatch):
    """All half-spaces from the start, nodes that may leave the plane, unneeded ties."""
    monkeypatch.setattr(curtains, "least_seconds", lambda call, **how: (call(), 1.0))
    forced = (curtains.all_half_spaces(LAW, 3), curtains.ties(LAW, 4))
    assert all(row["same"] for row in (*forced, curtains.third_coordinate(LAW, "corners", 4)))


def test_a_load_step_starts_from_the_last_one():
    """Its half-spaces spare steps, its factor pattern is kept, and the answer is the same."""
    load = {"steps": 2, "point": {"at": [500.0, 0.0], "force": [0.1, -0.5]}}
    scene = read_scene(square(8, load=load))
    mesh = build_mesh(scene, LAW.cell)
    half, full = (make_problem(scene, LAW, mesh, factor) for factor in (0.5, 1.0))
    last = solve_problem(half)
    cold, warm = solve_problem(full), solve_problem(full, last)
    assert warm.status == cold.status == "converged"
    assert abs(warm.mean_height() - cold.mean_height()) < scene.solver.tolerance * mesh.size
    assert warm.iterations < cold.iterations
    assert warm.problem.fem.pattern is last.problem.fem.pattern
