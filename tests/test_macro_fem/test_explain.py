"""What a curtain leaves out: the same answer with it forced, and words that agree with what was done."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from homogenize.io import default_law
from homogenize.laws.net import ring_net
from macro_fem.bounds.interval import BoundOptions
from macro_fem.cli import main
from macro_fem.curtain import CurtainOptions, solve_problem
from macro_fem.fem.rotated import RotatedLaw
from macro_fem.output.explain import decisions
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.schema import read_scene
from macro_fem.solution import gathered_start, make_problem, spread_tension, unit_tensors
from macro_fem.solvers.central_path import solve_path
from macro_fem.solvers.clarabel import ClarabelOptions
from macro_fem.solvers.cones import facets_of, same_cones
from macro_fem.solvers.options import CutOptions, PathOptions, StepOptions
from macro_fem.solvers.stretch_limit import StretchOptions
from rve.common.errors import InputError, OldName

LAW = default_law()
TOML = '[curtain]\nwidth = 1000.0\nheight = 1000.0\n[mesh]\ncells = 4\n[support]\nkind = "corners"\n'


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
    return make_problem(scene, law, build_mesh(scene, law.cell))


def said(solution):
    return {one.feature: one for one in decisions(solution, bounds=False, picture=False)}


def height_tolerance(solution):
    """The potential is good to `tolerance` times load and size, the mean height to this part of the size."""
    return solution.problem.scene.solver.tolerance * solution.problem.mesh.size


def test_the_solver_tells_what_it_did(scene_tables):
    """A coarse start is told where one was made, and why where none was."""
    few = solve_problem(problem(cells=8))
    coarse = solve_problem(problem(cells=8), options=CurtainOptions(coarse_from=0, coarse_ratio=2))
    assert not said(few)["coarse-start"].used
    assert said(few)["coarse-start"].why == f"{few.problem.disc.n_points} points are fewer than 4000"
    assert said(coarse)["coarse-start"].used
    assert abs(coarse.mean_height() - few.mean_height()) < height_tolerance(few)
    small = solve_problem(problem(cells=3), options=CurtainOptions(coarse_from=0))
    assert (said(small)["coarse-start"].used, said(small)["coarse-start"].why) == (
        False,
        "this mesh has no coarser one",
    )
    assert said(solve_problem(problem(kind="clarabel")))["coarse-start"].why == "clarabel takes no start"
    hooks = scene_tables(width=1000.0, height=1000.0, mesh={"cells": 20}, support={"kind": "hooks", "pitch": 50.0})
    scene = read_scene(hooks | {"solver": {"max_iterations": 1}})  # decided before the first step
    dense = make_problem(scene, LAW, build_mesh(scene, LAW.cell))
    told = said(solve_problem(dense, options=CurtainOptions(coarse_from=0)))["coarse-start"]
    assert (told.used, told.why) == (False, "the coarser mesh does not fit hooks or patches")


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
    assert said(warm)["last-step"].used
    assert "last-step" not in said(cold)


def test_ties_are_told():
    assert said(solve_problem(problem(support="top", load={"bar": {"mass": 1.0}})))["ties"].used
    assert not said(solve_problem(problem(support="top")))["ties"].used


def test_nodes_that_may_leave_the_plane_stay_in_it_and_a_push_takes_them_out():
    rest = solve_problem(problem(space=True))
    assert rest.status == "converged"
    assert said(rest)["third-coordinate"].why == "[solver] space = true asks for it"
    assert np.abs(rest.x[:, 2]).max() < 1e-6 * rest.problem.mesh.size
    pushed = solve_problem(problem(load={"gravity": [0.0, -9.81, -4.9]}))
    assert pushed.status == "converged"
    assert said(pushed)["third-coordinate"].used
    assert np.abs(pushed.x[:, 2]).max() > 0.1 * pushed.problem.mesh.height


def test_half_spaces_agree_with_the_cones():
    """And all of them from the start give the same potential."""
    plane = problem(cells=3)
    plain = solve_problem(plane)
    facets, points = facets_of(LAW), plane.disc.n_points
    told = said(plain)["all-half-spaces"].why
    assert told.startswith(f"{len(plain.cones) / points:.1f} of the law's {len(facets.h)} ")
    load = plane.fem.gather(plane.force) + plane.fem.force(spread_tension(plane) * unit_tensors(plane))
    start, size = plane.fem.unknowns(gathered_start(plane)), plane.mesh.size
    every = PathOptions(cones=same_cones(facets, points), cuts=CutOptions(pruned_at=()))
    few, all_of = (solve_path(plane.fem, LAW, load, start, size, one) for one in (PathOptions(), every))
    assert len(all_of.cones) == len(facets.h) * points
    assert abs(few.primal - all_of.primal) < 3e-9 * float(np.abs(plane.force).sum()) * size


def test_half_spaces_of_a_turned_law():
    E = np.random.default_rng(1).normal(size=(50, 3))
    for law in (LAW, RotatedLaw(LAW, 30.0)):
        facets = facets_of(law)
        worst = (E @ (facets.S * [1.0, 2.0, 1.0]).T - facets.h).max(axis=1)
        assert worst == pytest.approx(law.cut(E).violation, abs=1e-12)


def test_a_law_without_a_list_of_half_spaces_says_so():
    net = ring_net(LAW.cell)
    assert facets_of(net) is None
    assert "infinitely many" in said(solve_problem(problem(law=net)))["all-half-spaces"].why


@pytest.mark.parametrize("options", [PathOptions(cuts=CutOptions(pruned_at=())), PathOptions(corrector=False)])
def test_options_of_the_cone_solver_change_its_way_and_not_its_answer(options):
    plane = problem(cells=8)
    load = plane.fem.gather(plane.force) + plane.fem.force(spread_tension(plane) * unit_tensors(plane))
    start = plane.fem.unknowns(gathered_start(plane))
    plain, other = (solve_path(plane.fem, LAW, load, start, plane.mesh.size, one) for one in (PathOptions(), options))
    assert plain.converged
    assert other.converged
    assert abs(other.primal - plain.primal) < 3e-9 * float(np.abs(plane.force).sum()) * plane.mesh.size
    if options.corrector:
        assert len(other.cones) > len(plain.cones)
    else:
        assert other.iterations > 1.2 * plain.iterations


@pytest.mark.parametrize(
    ("record", "values", "message"),
    [
        (PathOptions, {"gap": -1e-9}, "gap = -1e-09: must be greater than 0"),
        (PathOptions, {"violation": float("nan")}, "violation = nan: is not a finite number"),
        (PathOptions, {"max_iterations": 0}, "max_iterations = 0: must be from 1"),
        (StepOptions, {"boundary": 1.0}, "boundary = 1.0: must be at most"),
        (CutOptions, {"pruned_at": (0.1, -1.0)}, "pruned_at = .* holds -1.0"),
        (CurtainOptions, {"coarse_ratio": 1}, "coarse_ratio = 1: must be from 2"),
        (ClarabelOptions, {"max_rounds": 0}, "max_rounds = 0"),
        (StretchOptions, {"gives": ()}, "at least 1"),
        (BoundOptions, {"inward": 0.0}, "inward = 0.0"),
    ],
)
def test_options_refuse_nonsense(record, values, message):
    with pytest.raises(InputError, match=f"^{record.__name__}: .*{message}"):
        record(**values)


def test_force_is_an_unknown_word_or_without_effect():
    with pytest.warns(OldName, match=r"\[solver\] force: has no effect"):
        forced = problem(force=["ties"])
    assert forced.fem.tie is None


def run(tmp_path, *arguments, toml=TOML):
    scene = tmp_path / "scene.toml"
    scene.write_text(toml)
    return CliRunner().invoke(main, ["run", str(scene), "--out", str(tmp_path / "out"), "--no-picture", *arguments])


def test_the_command_explains_every_feature(tmp_path):
    result = run(tmp_path, "--explain", toml=TOML + "[solver]\nbounds = true\n")
    assert result.exit_code == 0, result.output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    told = {one["feature"]: one for one in summary["features"]}
    features = {"third-coordinate", "all-half-spaces", "ties", "coarse-start", "bounds"}
    assert set(told) == features | {"slack-cells", "picture"}
    for feature, one in told.items():
        assert f"{feature:<16} {'used' if one['used'] else 'left out':<9} {one['why']}" in result.output.splitlines()
    assert told["bounds"]["used"]
    assert "bounds" in summary
    assert not told["picture"]["used"]


@pytest.mark.parametrize(("option", "solver"), [(("--force", "ties"), ""), ((), '[solver]\nforce = ["ties"]\n')])
def test_force_is_accepted_with_a_warning(tmp_path, option, solver):
    plain, forced = run(tmp_path), run(tmp_path, *option, toml=TOML + solver)
    assert forced.exit_code == 0, forced.output
    assert forced.stdout.splitlines()[1] == plain.stdout.splitlines()[1]
    assert forced.stderr.count("has no effect") == 1
    assert "left out" not in forced.stdout
    told = {
        one["feature"]: one["used"] for one in json.loads((tmp_path / "out" / "summary.json").read_text())["features"]
    }
    assert not told["ties"]
    assert not told["bounds"]
