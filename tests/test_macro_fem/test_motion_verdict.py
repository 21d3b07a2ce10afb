"""Scenes in motion by `macro_fem.solve`: whether they hold, against the same curtains at rest; progress and files."""

import csv
import json

import numpy as np
import pytest

import macro_fem
from homogenize import ClothLaw, default_law
from macro_fem import EveryRing, Scene, Sphere, read_scene
from macro_fem.motion import MotionSolution, MovingCurtain
from macro_fem.motion_summary import CurtainMotionSummary
from macro_fem.output import motion_lines, motion_verdict
from rve import InputError

STRIP = {"curtain": {"width": 125.0, "height": 500.0}, "mesh": {"cells": 1}, "solver": {"kind": "elastic"}}
HOOKS = {"kind": "hooks", "count": 2, "capacity": 5.0}
PULL = {"edge": "bottom", "force": [0.0, -0.3, 0.0]}
BALL = {"kind": "sphere", "radius": 60.0, "mass": 0.1, "at": [150.0, 100.0, 65.0], "velocity": [0.0, 0.0, -4e3]}
STRUCK = {
    "curtain": {"width": 300.0, "height": 300.0},
    "mesh": {"cells": 4},
    "support": {"kind": "top"},
    "body": BALL,
    "motion": {"duration": 0.02, "step": 0.005},
}


def moved(scene: Scene, **how) -> tuple[MotionSolution, CurtainMotionSummary]:
    """The answer to a scene in motion, and its summary."""
    answer: object = macro_fem.solve(scene, **how)
    assert isinstance(answer, MotionSolution)
    assert isinstance(answer.summary, CurtainMotionSummary)
    return answer, answer.summary


@pytest.fixture(scope="module")
def struck() -> tuple[MotionSolution, list[str]]:
    """A ball that strikes a sheet of rigid rings, and what was told of its progress."""
    told = list[str]()
    return moved(read_scene(STRUCK), progress=told.append)[0], told


@pytest.mark.parametrize("support", [HOOKS, pytest.param({"kind": "top"}, marks=pytest.mark.slow)])
def test_a_strip_pulled_slowly_ends_with_the_factor_that_it_has_at_rest(support):
    rest = macro_fem.solve(read_scene(STRIP | {"support": support, "load": {"edge": [PULL]}})).summary
    slowly = {"load": {"edge": [PULL | {"history": [[0.0, 0.0], [0.5, 1.0]]}]}}
    motion = {"motion": {"duration": 0.5, "step": 0.1, "damping": 20.0}}
    _, told = moved(read_scene(STRIP | {"support": support} | slowly | motion))
    assert told.smallest_factor == pytest.approx(rest.governing_factor, rel=1e-3)
    assert told.weakest == rest.governing_link
    assert (told.holds, told.at_s, told.verdict_note) == (rest.holds, 0.5, None)
    forces = [one.largest_nodal_force_N for one in told.support_forces]
    assert forces == pytest.approx([one.largest_nodal_force_N for one in rest.support_forces], rel=1e-3)


@pytest.mark.slow
def test_a_strip_dropped_into_its_edge_has_a_larger_peak_the_farther_it_falls():
    """From rest, let go at once: more than twice what it bears hanging, as of a load that comes on at once."""
    heavy = STRIP | {"curtain": STRIP["curtain"] | {"areal_mass": 100.0}}
    factor = [macro_fem.solve(read_scene(heavy | {"support": {"kind": "top"}})).summary.governing_factor]
    for lift in (5.0, 20.0):
        bottom = {"kind": "edge", "edge": "bottom", "move": [0.0, lift, 0.0], "release": 0.0}
        motion = {"motion": {"duration": 0.09, "step": 0.005}}
        factor.append(moved(read_scene(heavy | motion | {"support": [{"kind": "top"}, bottom]}))[1].smallest_factor)
    assert factor[0] > 1.9 * factor[1] > 2.5 * factor[2]


@pytest.mark.slow
def test_what_rigid_rings_do_not_tell_of_a_blow_is_said(struck):
    answer, _ = struck
    told = answer.summary
    assert told.impacts > 0
    assert (told.holds, told.smallest_factor > 1.0, answer.status) == (None, True, "converged")
    assert f"the largest at {told.largest_impact_at_s:.6g} s" in told.verdict_note
    assert motion_verdict(told).startswith("not known whether it holds: smallest factor")
    lines = "\n".join(motion_lines(told, "out"))
    assert f"weakest at {told.at_s:.4g} s: holds with a factor" in lines
    assert "of the largest kinetic energy" in lines
    used = [frame[-1] for frame in answer.series.rows]
    assert told.smallest_factor == pytest.approx(1.0 / max(used))
    assert told.safety_factor == answer.safety_factor == pytest.approx(told.smallest_factor)


@pytest.mark.slow
def test_a_load_that_no_ring_bears_does_not_hold_and_a_law_without_rings_does_not_know():
    weak = STRUCK | {"material": {"yield": 1e-3}, "motion": {"duration": 0.01, "step": 0.005}}
    assert moved(read_scene(weak))[1].holds is False
    cloth = STRUCK["curtain"] | {"areal_mass": 1.0}
    motion = {"duration": 0.01, "step": 0.005, "start": "reference"}
    still = read_scene(STRUCK | {"curtain": cloth, "body": [], "solver": {"space": True}, "motion": motion})
    answer: object = macro_fem.solve(still, ClothLaw())
    assert isinstance(answer, MotionSolution)
    told = answer.summary
    assert (told.holds, told.smallest_factor, told.weakest) == (None, None, None)
    assert motion_verdict(told) == "whether it holds is not known"
    assert any("strength of the rings not known" in line for line in motion_lines(told, "out"))


@pytest.mark.slow
def test_a_ball_is_pushed_as_it_pushes_and_is_named_where_it_is():
    found = MovingCurtain(read_scene(STRUCK), default_law()).solve()
    pushed = 0.0
    for frame in found.frames[1:]:
        push = frame.pushed[-1].sum(axis=0)
        assert frame.forces is not None
        assert push == pytest.approx(-frame.forces.push[-1], abs=1e-9)
        (ball,) = (one.obstacle for one in frame.obstacles)
        assert isinstance(ball, Sphere)
        assert (ball.name, *ball.centre) == ("ball", *frame.moment.x[-1])
        pushed = max(pushed, float(np.linalg.norm(push)))
    assert pushed > 1.0


def test_progress_tells_steps_and_time(struck):
    """Of every step; the solver's own words come as a part of them."""
    _, told = struck
    steps = [str(one) for one in told if " in motion, step " in one.work and "curtain of" not in one.work]
    assert len({one.split("; ")[0] for one in steps}) == 4
    assert "cells in motion, step 4 of about 4, 0.015 of 0.02 s; " in steps[-1]
    assert " used, about " in steps[-1]


def test_a_motion_is_saved_as_the_command_saves_it(struck, tmp_path):
    answer, _ = struck
    summary = answer.save(tmp_path, picture=False)
    written = json.loads((tmp_path / "summary.json").read_text())
    assert written.pop("files").keys() == {one.name for one in tmp_path.iterdir()} - {"summary.json"}
    assert written == json.loads(json.dumps(summary.to_dict()))
    rows = list(csv.DictReader((tmp_path / "motion.csv").read_text().splitlines()))
    assert [float(row["t_s"]) for row in rows] == pytest.approx([0.0, 0.005, 0.01, 0.015, 0.02])
    held = list(csv.DictReader((tmp_path / "support_forces.csv").read_text().splitlines()))
    assert len(held) == len(answer.support_forces()) == 5
    assert {"motion.pvd", "motion_0004.vtu", "bodies_0004.vtu", "bodies.csv"} <= {
        one.name for one in tmp_path.iterdir()
    }
    force = answer.plot().lines[0].get_ydata()
    assert max(force) == pytest.approx(summary["peak_support_force_N"])
    with pytest.raises(InputError, match="EveryRing"):
        answer.rings()


@pytest.mark.slow
def test_every_ring_in_motion_is_an_answer_too(tmp_path):
    cell = default_law().cell
    assert cell is not None
    tables = {"curtain": {"width": 3 * cell.b_x_mm, "height": 2 * cell.b_y_mm}}
    top = {"kind": "top", "move": [0.0, 1.0], "history": [[0.0, 0.0], [0.01, 1.0]]}
    answer: object = macro_fem.solve(
        read_scene(tables | {"support": top, "motion": {"duration": 0.004, "step": 0.002}}), EveryRing(space=False)
    )
    assert isinstance(answer, MotionSolution)
    assert answer.rings().centre.shape == (answer.summary["ring_count"], 3)
    assert (answer.summary.holds, answer.safety_factor) == (None, None)
    assert "every ring is rigid" in (answer.summary.verdict_note or "")
    assert answer.summary.at_s > 0.0  # pulled up, it bears more
    force = [frame.rings.contacts.force.max() for frame in answer.series.shown.values()]
    assert answer.summary["peak_contact_force_at_s"] == 0.002 * np.argmax(force) > 0.0
    answer.save(tmp_path, picture=False)
    assert {"motion_0002.vtu", "support_forces.csv"} <= {one.name for one in tmp_path.iterdir()}
