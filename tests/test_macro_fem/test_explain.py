"""What a curtain leaves out: the same answer with it forced, and words that agree with what was done."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from homogenize.io import default_law
from homogenize.laws.net import ring_net
from macro_fem.cli import main
from macro_fem.curtain import solve_problem
from macro_fem.fem.space import in_space, out_of_plane
from macro_fem.fem.turned import TurnedLaw
from macro_fem.job import with_force
from macro_fem.output.explain import decisions
from macro_fem.scene.mesh import build_mesh
from macro_fem.scene.schema import FEATURES, read_scene
from macro_fem.solution import gathered_start, make_problem, spread_tension, unit_tensors
from macro_fem.solvers.cones import facets_of
from macro_fem.solvers.central_path import solve_path
from macro_fem.solvers.options import PathOptions
from rve.common.errors import InputError

LAW = default_law()
TOML = '[curtain]\nwidth = 1000.0\nheight = 1000.0\n[mesh]\ncells = 4\n[support]\nkind = "corners"\n'


def problem(law=LAW, cells=4, support="corners", load=None, hang="y", **solver):
    scene = read_scene(
        {
            "curtain": {"width": 1000.0, "height": 1000.0, "hang": hang},
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


@pytest.mark.parametrize(
    ("feature", "cells"), [("third-coordinate", 6), ("all-half-spaces", 3), ("ties", 6), ("coarse-start", 8)]
)
def test_a_forced_feature_changes_no_height(feature, cells):
    plain, forced = solve_problem(problem(cells=cells)), solve_problem(problem(cells=cells, force=[feature]))
    assert plain.status == forced.status == "converged"
    assert abs(forced.mean_height() - plain.mean_height()) < height_tolerance(plain)
    assert not said(plain)[feature].used
    assert said(forced)[feature].used
    assert said(forced)[feature].why.startswith("forced")


def test_the_third_coordinate_with_a_straight_bar():
    load = {"bar": {"mass": 1.0}}
    plain = solve_problem(problem(support="top", load=load))
    forced = solve_problem(problem(support="top", load=load, force=["third-coordinate"]))
    assert forced.mean_height() == pytest.approx(plain.mean_height(), abs=height_tolerance(plain))
    assert said(plain)["ties"].used
    assert said(plain)["ties"].why == "a bar keeps an edge straight"


def test_nodes_that_may_leave_the_plane_stay_in_it_and_a_push_takes_them_out():
    plane = problem()
    fem = in_space(plane.fem)
    start = np.column_stack([gathered_start(plane), np.zeros(plane.disc.n_nodes)])
    lifted = replace(plane, fem=fem)
    pull = np.column_stack([plane.force, np.zeros(len(plane.force))])
    load = fem.gather(pull) + fem.force(spread_tension(plane) * unit_tensors(lifted))
    rest = solve_path(fem, plane.law, load, fem.unknowns(start), plane.mesh.size)
    assert rest.converged
    assert out_of_plane(fem, rest.z) < 1e-6 * plane.mesh.size
    pull[:, 2] = 0.5 * pull[:, 1]
    pushed = solve_path(
        fem, plane.law, load + fem.gather(pull) - fem.gather(pull * [1, 1, 0]), rest.z, plane.mesh.size
    )
    assert pushed.converged
    assert out_of_plane(fem, pushed.z) > 0.1 * plane.mesh.height


def test_a_coarse_start_that_cannot_be_is_not_told_as_used():
    told = said(solve_problem(problem(cells=4, force=["coarse-start"])))["coarse-start"]
    assert not told.used
    assert told.why == "this mesh has no coarser one"


def test_the_other_solver_has_no_coarse_start():
    conic = problem(cells=8, kind="conic")
    told = said(solve_problem(problem(cells=8, kind="conic", force=["all"])))["coarse-start"]
    assert (told.used, told.why) == (False, "clarabel takes no start")
    with pytest.raises(InputError, match=r"force = 'coarse-start': needs kind = 'rigid' or 'newton', not 'conic'"):
        with_force(conic.scene, ("coarse-start",))


def test_half_spaces_agree_with_the_cones():
    plain, forced = solve_problem(problem()), solve_problem(problem(force=["all-half-spaces"]))
    all_of = len(facets_of(LAW).h)
    points = plain.problem.disc.n_points
    assert len(forced.cones) == all_of * points
    assert said(plain)["all-half-spaces"].why.startswith(f"{len(plain.cones) / points:.1f} of the law's {all_of} ")


def test_half_spaces_of_a_turned_law():
    E = np.random.default_rng(1).normal(size=(50, 3))
    for law in (LAW, TurnedLaw(LAW, 30.0)):
        facets = facets_of(law)
        worst = (E @ (facets.S * [1.0, 2.0, 1.0]).T - facets.h).max(axis=1)
        assert worst == pytest.approx(law.cut(E).violation, abs=1e-12)


def test_a_law_without_a_list_of_half_spaces_says_so():
    net = ring_net(LAW.cell)
    assert facets_of(net) is None
    with pytest.raises(InputError, match="has no finite list"):
        solve_problem(problem(law=net, force=["all-half-spaces"]))
    with pytest.raises(InputError, match="use fewer cells"):
        solve_problem(problem(cells=16, force=["all-half-spaces"]))
    assert "infinitely many" in said(solve_problem(problem(law=net)))["all-half-spaces"].why


@pytest.mark.parametrize("options", [PathOptions(drop_idle=False), PathOptions(corrector=False)])
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


def test_only_features_that_go_with_the_scene():
    elastic = read_scene(
        {"curtain": {"width": 1.0, "height": 1.0}, "support": {"kind": "top"}, "solver": {"kind": "newton"}}
    )
    assert with_force(elastic, ("all",)).solver.forces("ties")
    with pytest.raises(InputError, match=r"\[solver\] force = 'third-coordinate': needs kind = 'rigid', not 'newton'"):
        with_force(elastic, ("third-coordinate",))
    with pytest.raises(InputError, match=r"--force = 'inertia': known are all, third-coordinate"):
        with_force(elastic, ("inertia",))
    with pytest.raises(InputError, match=r"\[solver\] force = \['drape'\]: holds 'drape'"):
        problem(force=["drape"])
    with pytest.raises(InputError, match="is not a list of words"):
        problem(force="ties")


def run(tmp_path, *arguments, toml=TOML):
    scene = tmp_path / "scene.toml"
    scene.write_text(toml)
    return CliRunner().invoke(main, ["run", str(scene), "--out", str(tmp_path / "out"), "--no-picture", *arguments])


def test_the_command_explains_every_feature(tmp_path):
    result = run(tmp_path, "--explain", "--force", "bounds")
    assert result.exit_code == 0, result.output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    told = {one["feature"]: one for one in summary["features"]}
    assert set(told) == {*FEATURES, "slack-cells", "picture"}
    for feature, one in told.items():
        assert f"{feature:<16} {'used' if one['used'] else 'left out':<9} {one['why']}" in result.output.splitlines()
    assert told["bounds"]["used"]
    assert "bounds" in summary
    assert not told["picture"]["used"]


def test_the_scene_may_force_and_bounds_are_left_out_by_themselves(tmp_path):
    result = run(tmp_path, toml=TOML + '[solver]\nforce = ["ties"]\n')
    assert result.exit_code == 0, result.output
    assert "left out" not in result.output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    told = {one["feature"]: one["used"] for one in summary["features"]}
    assert told["ties"]
    assert not told["bounds"]
    assert "bounds" not in summary


def test_an_unknown_feature_ends_in_one_sentence(tmp_path):
    result = run(tmp_path, "--force", "drape")
    assert result.exit_code == 2
    assert result.stderr.startswith("Error: --force = 'drape': known are all, ")
    assert not (tmp_path / "out").exists()
