"""Scenes in motion from their files to their results, and against closed forms."""

import csv
import itertools
import json
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.interpolate import CubicSpline
from scipy.special import ellipk

import macro_fem
from homogenize import default_law, with_material
from macro_fem import read_scene
from macro_fem.cli import main
from macro_fem.modes import find_modes
from macro_fem.motion import (
    COLUMNS,
    Moment,
    MovingCurtain,
    account_error,
    files,
    kinetic_energy,
    masses_of,
    mesh_masses,
    pace,
    scene_at,
)
from macro_fem.output import winds
from macro_fem.rings import ring_scene
from macro_fem.scene import wind_pressure
from rve import Cell, InputError
from tests.commands import run
from tests.test_macro_fem.sheets import fallen, solve_scene, still_air

G = 9810.0
SHEET = {"curtain": {"width": 400.0, "height": 400.0}, "mesh": {"cells": 4}, "solver": {"space": True}}
TOP = {"kind": "top"}
FREE = {"support": TOP | {"release": 0.0}}
LET_GO = """
curtain = {width = 400.0, height = 400.0}
mesh = {cells = 4}
solver = {space = true}
support = [{kind = "point", at = [0.0, 400.0]}, {kind = "point", at = [400.0, 400.0], release = 0.01}]
motion = {duration = 0.06, step = 0.01}
"""


def moved(tables):
    """The run of a scene, its rows, and the names of its columns; every step is solved and its account closes."""
    found = MovingCurtain(read_scene(SHEET | tables), default_law()).solve()
    assert found.status == "converged", found.message
    rows = np.array([frame.row for frame in found.frames])
    assert account_error(rows) < 1e-8
    assert rows[:, -1].max() < 1e-6
    largest = np.abs(rows[:, 5:12] - rows[0, 5:12]).max()
    for name in ("lost_by_locking_N_mm", "lost_by_damping_N_mm"):
        assert np.diff(rows[:, COLUMNS.index(name)]).min() > -1e-8 * largest
    return found, dict(zip(COLUMNS, rows.T, strict=True))


def test_rest_stays_rest_until_something_acts():
    wind = {"pressure": 20.0, "direction": [0.0, 0.0, -1.0], "history": [[0.02, 0.0], [0.04, 1.0]]}
    late = TOP | {"release": 0.04}
    found, told = moved({"support": late, "load": {"wind": [wind]}, "motion": {"duration": 0.04, "step": 0.01}})
    assert found.message == "every step is solved; [support] (top) release = 0.04: is not reached"
    assert [frame.iterations > 0 for frame in found.frames] == [False, False, False, True, True]
    assert np.array_equal(found.frames[2].moment.x, found.frames[0].moment.x)
    assert told["mean_z_mm"][-1] < -0.1


@pytest.mark.parametrize("release", [0.0, 0.015])
def test_a_sheet_let_go_falls_freely(release):
    """Also from a release between steps, where one of them ends, or at once, which holds nothing."""
    motion = {"duration": release + 0.06, "step": 0.01, "start": "hung" if release else "reference"}
    _, told = moved({"support": TOP | {"gather": 0.95, "release": release}, "motion": motion})
    t, fallen = told["t_s"][-1] - release, told["mean_y_mm"][0] - told["mean_y_mm"][-1]
    start = 0.75 * (1.0 - 3.0**-6) * 0.01**2 * G  # what Euler's first step goes too far
    assert fallen - start == pytest.approx(0.5 * G * t * t, rel=1e-8)
    assert told["support_force_N"][told["t_s"] > release] == pytest.approx(0.0, abs=1e-8)


def test_a_corner_let_go_swings_about_the_other():
    supports = [{"kind": "point", "at": [0.0, 400.0]}, {"kind": "point", "at": [400.0, 400.0], "release": 0.0}]
    found, told = moved({"support": supports, "motion": {"duration": 0.1, "step": 0.01}})
    assert told["mean_x_mm"][-1] < told["mean_x_mm"][0] - 1.0
    assert np.abs(found.frames[-1].moment.x[:, 2]).max() < 1e-6
    corner = np.linalg.norm(found.frames[0].problem.disc.nodes - [0.0, 400.0], axis=1).argmin()
    assert found.frames[-1].moment.x[corner] == pytest.approx([0.0, 400.0, 0.0], abs=1e-9)


@pytest.mark.parametrize(
    ("begin", "step"), [(0.0, {"step": 0.0025}), pytest.param(2.0, {"accuracy": 1e-6}, marks=pytest.mark.slow)]
)
def test_a_gust_pushes_as_its_history_says(begin, step):
    """Also one that comes late, when steps of their own length have grown longer than it."""
    history = [[begin, 0.0], [begin + 0.02, 1.0], [begin + 0.02 + 1e-8, 1.0], [begin + 0.04, 0.0]]
    wind = {"pressure": 2.0, "direction": [0.0, 0.0, 1.0], "history": history}
    found, told = moved(FREE | {"load": {"wind": wind}, "motion": {"duration": begin + 0.06} | step})
    masses = masses_of(found.frames[-1].problem, ())
    assert masses.sum() == pytest.approx(1e-9 * default_law().cell.areal_mass_kg_per_m2 * 400.0**2, rel=1e-9)
    momentum = float(masses @ found.frames[-1].moment.v[:, 2])
    assert momentum == pytest.approx(2e-6 * 400.0**2 * 0.02, rel=2e-2)  # pressure times area times mean time
    assert told["work_N_mm"][-1] > 0.0
    assert np.diff(told["t_s"]).min() > 4e-7  # no step between two times that are nearly one


@pytest.mark.slow
def test_still_air_after_a_gust_slows_the_sheet():
    """1/v grows by k t, where the gust of speed U presses with k U^2 times the mass."""
    wind = {"speed": 10.0, "direction": [0.0, 0.0, 1.0], "history": [[0.0, 1.0], [0.02, 1.0], [0.021, 0.0]]}
    motion = {"duration": 0.08, "step": 2e-3, "start": "reference"}
    found, told = moved(FREE | {"load": {"gravity": 0.0, "wind": wind}, "motion": motion})
    late = np.searchsorted(told["t_s"], 0.03)
    slowness = 1.0 / np.array([found.frames[k].moment.v[:, 2].mean() for k in (late, -2)])
    problem = found.frames[0].problem
    k = wind_pressure(problem.winds[0], problem.law.cell) * 400.0**2 / masses_of(problem, ()).sum() / 1e4**2
    assert np.diff(slowness)[0] == pytest.approx(k * (told["t_s"][-2] - told["t_s"][late]), rel=5e-5)
    last = found.frames[-1]
    resists = -k * masses_of(problem, ()) @ last.moment.v[:, 2] ** 2
    assert winds(last)[1].sum(axis=0) == pytest.approx([0.0, 0.0, resists], rel=1e-4)


STILL = {"wind": {"speed": 0.0, "direction": [0.0, 0.0, 1.0]}}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("motion", "wind"), [({"damping": 3.0}, {}), ({}, STILL), ({}, {"wind": STILL["wind"] | {"follows": True}})]
)
def test_falls_with_damping_and_in_still_air_are_of_second_order(motion, wind):
    """Places against closed forms, and of damping its work."""
    errors = []
    for step in (0.04, 0.02, 0.01):
        fall = {"duration": 0.4, "start": "reference", "step": step} | motion
        found, told = moved(FREE | {"load": {"gravity": [0.0, 0.0, -9.81]} | wind, "motion": fall})
        exact, work = fallen(0.4, **(motion or {"drag": still_air()}))
        work *= masses_of(found.frames[0].problem).sum()
        errors.append([-told["mean_z_mm"][-1] / exact - 1.0, told["lost_by_damping_N_mm"][-1] - work])
    assert errors[2][0] < (1.95e-4 if motion else 9.5e-4)  # without damping and air 9.4e-4, of the first step
    assert abs(errors[2][1]) < 1.5e-3 * work + 1e-12
    for coarse, _, fine in np.abs(errors).T[: 1 + bool(motion)]:
        assert coarse > 11.0 * fine


@pytest.mark.slow
def test_stiff_drag_takes_a_light_sheet_along_and_wind_of_no_speed_does_nothing():
    """Also in steps far longer than the sheet needs to go with the wind."""
    light, wind = SHEET["curtain"] | {"areal_mass": 1e-3}, {"speed": 30.0, "direction": [0.0, 0.6, 0.8]}
    for follows in (False, True):
        motion = {"duration": 8.0, "step": 1.0, "start": "reference"}
        load = {"gravity": 0.0, "wind": wind | {"follows": follows}}
        found, _ = moved(FREE | {"curtain": light, "load": load, "motion": motion})
        speed = np.array([frame.moment.v @ [0.0, 0.6, 0.8] for frame in found.frames]).mean(axis=1) / 3e4
        normal = 1.0 if not follows else 0.8  # a sheet turns no wind aside but along its normal
        assert np.all(np.diff(speed) > -1e-3)
        assert 0.9 * normal**2 < speed[-1] < 1.001
    none = {"load": {"wind": {"speed": 1e-300, "direction": [0.0, 0.0, 1.0]}}}
    motion = {"motion": {"duration": 0.06, "step": 0.02, "start": "reference"}}
    ends = [moved(FREE | motion | load)[0].frames[-1].moment.x for load in (none, {})]
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)


def test_start_lays_a_sheet_in_space_that_is_let_go():
    start = {"origin": [30.0, 100.0, 10.0], "x_axis": [0.0, 0.0, 1.0], "y_axis": [0.6, 0.8, 0.0]}
    scene = FREE | {"start": start, "motion": {"duration": 0.05, "step": 0.01, "start": "reference"}}
    found, _ = moved(scene)
    X, way = found.frames[0].problem.disc.nodes, found.frames[-1].moment.x - found.frames[0].moment.x
    laid = np.column_stack([30.0 + 0.6 * X[:, 1], 100.0 + 0.8 * X[:, 1], 10.0 + X[:, 0]])
    assert found.frames[0].moment.x == pytest.approx(laid, abs=1e-9)
    fall = -0.5 * G * (0.05**2 + 1.5 * 0.01**2 * (1.0 - 3.0**-5))
    assert way == pytest.approx(np.tile([0.0, fall, 0.0], (len(X), 1)), abs=2e-3)
    assert way.mean(axis=0) == pytest.approx([0.0, fall, 0.0], abs=2e-4)
    with pytest.raises(InputError, match="floor: the curtain is 20 mm inside it at the start"):
        moved(scene | {"obstacle": {"kind": "floor", "height": 120.0}})


@pytest.mark.slow
@pytest.mark.parametrize("step", [{"step": 0.01}, {}])
def test_a_wall_that_sets_off_at_once_takes_the_sheet_along(step):
    """Differences over the kinks of its history would throw the sheet ahead, with up to 4/3 of its speed."""
    history = [[0.0, 0.0], [0.1, 0.3], [0.2, 1.0]]
    wall = {"kind": "wall", "facing": [0.0, 0.0, 1.0], "move": [0.0, 0.0, 60.0], "history": history}
    motion = {"duration": 0.25, "start": "reference"} | step
    found, _ = moved(FREE | {"load": {"gravity": 0.0}, "obstacle": wall, "motion": motion})
    assert found.frames[-1].moment.v[:, 2] == pytest.approx(420.0, rel=1e-3)


@pytest.mark.slow
def test_a_falling_sheet_comes_to_rest_on_the_floor():
    floor = {"obstacle": {"kind": "floor", "height": -20.0}}
    _, told = moved(FREE | floor | {"motion": {"duration": 0.45, "step": 0.015, "scheme": "euler"}})
    assert told["lowest_point_mm"].min() > -20.0 - 1e-6
    assert told["kinetic_N_mm"][-1] < 1e-3 * told["kinetic_N_mm"].max()
    assert told["mean_y_mm"][-1] == pytest.approx(-20.0, abs=1.0)


@pytest.mark.parametrize(
    "step", [pytest.param({"step": 0.03}, marks=pytest.mark.slow), pytest.param({}, marks=pytest.mark.release)]
)
def test_a_fast_ball_is_not_passed_by(step):
    sheet = {"curtain": {"width": 300.0, "height": 300.0}, "mesh": {"cells": 6}, "support": TOP | {"gather": 0.9}}
    ball = {"kind": "sphere", "radius": 40.0, "mass": 0.1, "at": [150.0, 100.0, 300.0], "velocity": [0.0, 0.0, -4e3]}
    found, _ = moved(sheet | {"body": ball, "motion": {"duration": 0.15, **step}})
    assert found.frames[-1].moment.v[-1, 2] == pytest.approx(-2400.0, rel=0.15)  # steps of 0.001 s


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["rigid", "elastic"])
def test_an_obstacle_moved_far_in_one_step_takes_the_sheet_along(kind):
    bar = {"kind": "cylinder", "axis": [1.0, 0.0, 0.0], "point": [0.0, 200.0, -60.0], "radius": 45.0}
    moving = bar | {"move": [0.0, 0.0, 150.0], "history": [[0.0, 0.0], [0.1, 1.0]]}
    rings, motion = {"space": True, "kind": kind}, {"duration": 0.1, "step": 0.1}
    found, told = moved({"support": TOP, "obstacle": moving, "motion": motion, "solver": rings})
    assert np.hypot(*(found.frames[-1].moment.x[:, 1:] - [200.0, 90.0]).T).min() > 44.9
    assert told["mean_z_mm"][-1] == pytest.approx(85.94, rel=0.02)  # steps of 0.002 s


@pytest.mark.slow
def test_balls_fall_on_a_floor_and_strike_each_other():
    ball = {"kind": "sphere", "radius": 50.0, "mass": 1.0, "at": [0.0, 0.0, 300.0], "velocity": [1000.0, 0.0, 0.0]}
    other = ball | {"mass": 0.5, "at": [195.0, 0.0, 300.0], "velocity": [0.0, 0.0, 0.0]}
    free = FREE | {"obstacle": {"kind": "floor", "height": -55.0}}
    motion = {"duration": 0.2, "step": 0.01, "start": "reference", "damping": 3.0}  # of the mesh, not of balls
    tables = free | {"body": [ball, other], "motion": motion}
    assert [one.name for one in read_scene(SHEET | tables).of(macro_fem.Ball)] == [
        "ball 1",
        "ball 2",
    ]  # by which results go
    found, _ = moved(tables)
    x, v = found.frames[-1].moment.x[-2:], found.frames[-1].moment.v[-2:]
    assert x[:, 1] == pytest.approx(-5.0)  # at rest on the floor
    assert v[:, 0] == pytest.approx(1000.0 / 1.5, rel=1e-2)  # together, as tautening
    assert v[:, 0] @ [1.0, 0.5] == pytest.approx(1000.0)


@pytest.mark.slow
@pytest.mark.parametrize("z", [(-30.0,), (-50.0,), (-30.0, -15.0)])
def test_balls_stop_at_a_wall_at_the_end_of_a_step_within_the_first_and_one_after_another(z):
    ball = {"kind": "sphere", "radius": 40.0, "mass": 0.05, "velocity": [0.0, 0.0, -3000.0]}
    balls = [ball | {"at": [1e3 * k, 2e3, height]} for k, height in enumerate(z)]
    wall = {"kind": "wall", "facing": [0.0, 0.0, 1.0], "point": [0.0, 0.0, -100.0]}
    found, _ = moved({"support": TOP, "body": balls, "obstacle": wall, "motion": {"duration": 0.04, "step": 0.005}})
    assert np.abs(found.frames[-1].moment.v[:, 2]).max() < 1.0


def test_a_history_draws_the_curtain_along_its_track():
    track = {"kind": "track", "radius": 600.0, "fullness": 1.3, "height": 500.0, "count": 5, "drawn": 1.0}
    drawing = track | {"history": [[0.0, 1.0], [0.2, 0.5]], "side": "end"}
    tables = {"support": drawing, "motion": {"duration": 0.2, "step": 0.02}}
    assert vars(scene_at(read_scene(SHEET | tables), 0.1).support[0])["drawn"] == pytest.approx(0.75)
    held = [frame.problem.supports for frame in moved(tables)[0].frames]
    wide = [np.ptp(one.positions[one.mask.any(axis=1), 0]) for one in held]
    assert wide[-1] == pytest.approx(0.5 * wide[0], rel=0.05)


def test_solvers_at_rest_refuse_motion():
    scene = read_scene(SHEET | {"support": TOP, "motion": {"duration": 1.0}})
    on_demand = macro_fem.OnDemand(Cell())
    for solve in (ring_scene, lambda scene: macro_fem.solve(scene, on_demand), macro_fem.compare):
        with pytest.raises(InputError, match=r"\[motion\]"):
            solve(scene)


@pytest.mark.slow
def test_a_run_writes_its_files_and_goes_on_as_if_it_had_not_ended(tmp_path):
    """A longer run in one, and in two with --continue, differ by the accuracy of a step only."""
    whole, part = tmp_path / "whole.toml", tmp_path / "part.toml"
    whole.write_text(LET_GO)
    part.write_text(LET_GO.replace("0.06", "0.03"))
    for scene, out, more in ((whole, "one", ()), (part, "two", ()), (whole, "two", ("--continue", "--html"))):
        result = CliRunner().invoke(main, ["run", str(scene), "--out", str(tmp_path / out), "--no-picture", *more])
        assert result.exit_code == 0, result.output
    tables = [list(csv.reader((tmp_path / out / "motion.csv").read_text().splitlines())) for out in ("one", "two")]
    assert tables[0][0] == tables[1][0] == list(COLUMNS)
    one, two = (np.array(table[1:], float) for table in tables)
    assert one.shape == (7, 14)
    assert np.abs(one[:, :5] - two[:, :5]).max() < 1e-5
    summary = json.loads((tmp_path / "two" / "summary.json").read_text())
    assert summary["reached_s"] == pytest.approx(0.06)
    assert {"motion.csv", "motion.pvd", "motion.npz", "motion_0006.vtu"} <= set(summary["files"])
    assert '"sliders":[' in (tmp_path / "two" / "motion.html").read_text()
    again = CliRunner().invoke(main, ["run", str(whole), "--out", str(tmp_path / "two"), "--continue"])
    assert (again.exit_code, "longer duration" in again.output) == (2, True)
    kept = tmp_path / "two" / "motion.npz"
    data = kept.read_bytes()
    pieces = b"", b"PK", data[:500], data[: len(data) // 2], data[:200] + bytes(400) + data[600:], data + b"0"
    for broken, sums in (*((piece, summary["files"]) for piece in pieces), (data, None)):
        kept.write_bytes(broken)
        kept.with_name("summary.json").write_text(json.dumps({"files": sums}))
        again = CliRunner().invoke(main, ["run", str(whole), "--out", str(tmp_path / "two"), "--continue"])
        assert (again.exit_code, "run again without --continue" in again.output) == (2, True)


def test_a_stopped_run_keeps_its_steps_and_ends_with_130(tmp_path, monkeypatch):
    scene = tmp_path / "scene.toml"
    scene.write_text(LET_GO)
    told = []

    def stop(work, *counted):
        told.append(work)
        if len(told) > 2:
            raise KeyboardInterrupt
        return nullcontext()

    monkeypatch.setattr(pace, "part_of", stop)
    result = CliRunner().invoke(main, ["run", str(scene), "--out", str(tmp_path / "out"), "--no-picture"])
    assert result.exit_code == 130
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary["status"], summary["steps"]) == ("stopped", 2)


class Killed(BaseException):
    """Ends a run where it is, as a signal that cannot be caught does."""


@pytest.mark.parametrize(
    "command", [pytest.param("run", marks=pytest.mark.slow), pytest.param("rings", marks=pytest.mark.release)]
)
def test_a_run_that_is_killed_loses_no_step_and_goes_on_to_the_same_end(command, tmp_path, monkeypatch):
    """Steps of their own length, released, blown at and damped; killed before the 5th file it writes, the 10th, ..."""
    scene, count = tmp_path / "scene.toml", itertools.count(1)
    text = LET_GO.replace("400.0", "44.0" if command == "rings" else "400.0").replace(
        ", step = 0.01", ", damping = 1.0"
    )
    scene.write_text(
        text + "load.wind = {speed = 6.0, direction = [0.0, 0.0, 1.0], history = [[0.0, 0.0], [0.02, 1.0]]}"
    )
    words = ["macro_fem", command, scene, "--no-picture", "--out"]
    run(*words, tmp_path / "whole")
    whole = np.loadtxt(tmp_path / "whole" / "motion.csv", delimiter=",", skiprows=1)
    write, out, kills = files.atomic_path, tmp_path / "out", 0

    @contextmanager
    def killed(path):
        if next(count) % (5 + 5 * kills) == 0:
            raise Killed
        with write(path) as temporary:
            yield temporary

    monkeypatch.setattr(files, "atomic_path", killed)
    while True:
        try:
            run(*words, out, *(["--continue"] if kills else []))
            break
        except Killed:
            kills += 1
            rows = np.loadtxt(out / "motion.csv", delimiter=",", skiprows=1, ndmin=2)
            assert rows == pytest.approx(whole[: len(rows)], rel=1e-9, abs=1e-9)
            assert json.loads((out / "summary.json").read_text())["steps"] >= len(rows) - 2
            series = [one.attrib["file"] for one in ElementTree.parse(out / "motion.pvd").iter("DataSet")]
            assert all(len(meshio.read(out / name).points) for name in series)
    assert kills > 5
    ends = [json.loads((folder / "summary.json").read_text()) for folder in (tmp_path / "whole", out)]
    assert ends[1]["files"].keys() == ends[0]["files"].keys() == {one.name for one in out.iterdir()} - {"summary.json"}
    assert np.loadtxt(out / "motion.csv", delimiter=",", skiprows=1) == pytest.approx(whole, rel=1e-9, abs=1e-9)
    assert ends[1]["frames"] == ends[0]["frames"]
    assert [ends[1][key] for key in ("at_s", "weakest")] == [ends[0][key] for key in ("at_s", "weakest")]
    whole_factor, factor = (end["smallest_factor"] for end in ends)
    if command == "rings":  # whose motion tells no factor
        assert (whole_factor, factor) == (None, None)
    else:
        assert factor == pytest.approx(whole_factor, rel=1e-6)


@pytest.mark.slow
def test_another_scene_does_not_go_on(tmp_path):
    scene = tmp_path / "scene.toml"
    plane = LET_GO.replace("space = true", "space = false").replace("[0.0, 400.0]", "[0.0, 400.0], release = 0.01")
    scene.write_text(plane.replace("0.06", "0.02"))
    files.run_motion(scene, None, tmp_path / "out")  # with a picture of what nothing holds any more
    with_material(default_law(), {"young": 7e4}).save(soft := tmp_path / "soft.json")
    for law, cells, out in ((None, 5, "out"), (soft, 4, "out"), (None, 4, "none")):
        scene.write_text(plane.replace("cells = 4", f"cells = {cells}"))
        with pytest.raises(InputError, match="another scene or law" if out == "out" else "there is no run"):
            files.run_motion(scene, law, tmp_path / out, picture=False, goes_on=True)


def test_a_straight_bar_turns_with_the_inertia_of_a_rod():
    tables = SHEET | {"support": TOP, "load": {"bar": {"mass": 3.0}}, "motion": {"duration": 1.0}}
    problem = MovingCurtain(read_scene(tables), default_law()).at(0.0)[0]
    s, of_bar = problem.disc.nodes[:, 0] / 400.0 - 0.5, 1e3 * (masses_of(problem) - mesh_masses(problem))
    assert [of_bar.sum(), of_bar @ s, of_bar @ s**2] == pytest.approx([3.0, 0.0, 0.25], abs=1e-9)


@pytest.mark.slow
def test_modes_prints_one_object_with_ascending_frequencies(tmp_path):
    scene = tmp_path / "scene.toml"
    text = "[curtain]\nwidth = 60.0\nheight = 1000.0\n[mesh]\ncells = 2\n[support]\nkind = 'top'\n"
    text += "[load.wind]\nspeed = 0.01\ndirection = [0, 0, 1]\n"
    scene.write_text(text + "[[combination]]\nname = 'a'\n")
    result = CliRunner().invoke(main, ["modes", str(scene), "--number", "2", "--json", "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    exact = [0.25 * j / np.pi * np.sqrt(G / 1000.0) for j in (2.404826, 5.520078)]
    assert json.loads(result.stdout)["frequencies_Hz"] == pytest.approx(exact, rel=1e-2)
    assert "as the curtain moves; the partial factors of [[combination]]" in result.stdout
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["modes.json", "modes.png", "modes.vtu"]


def thrown(tables, velocity, duration, step):
    """The run of a scene that begins with these velocities (n_nodes, 3) in mm/s."""
    scene = read_scene(tables | {"motion": tables.get("motion", {}) | {"duration": duration, "step": step}})
    moving = MovingCurtain(scene, default_law())
    first = moving.first_frame()
    energy = kinetic_energy(masses_of(first.problem, ()), velocity)
    first = replace(first, account=replace(first.account, kinetic=energy), h=step)
    found = moving.solve(replace(first, moment=Moment(0.0, first.moment.x, velocity)))
    assert found.status == "converged", found.message
    return found


@pytest.mark.parametrize(
    "speed", [pytest.param(0.0, marks=pytest.mark.release), pytest.param(60.0, marks=pytest.mark.slow)]
)
def test_a_bar_dropped_into_an_elastic_strip_swings_as_one_mass(speed):
    """T = 2 pi sqrt(m/k), peak m g + sqrt((m g)^2 + k m v^2) with v where the strip is not yet stretched.

    The run begins at rest's place with the speed that the bar has there.
    """
    length, mass = 1000.0, 0.02
    tables = {"curtain": {"width": 125.0, "height": length}, "mesh": {"cells": 1}}
    tables |= {"support": TOP, "solver": {"kind": "elastic"}}
    bars = [{"load": {"bar": {"mass": 1e3 * share * mass}}} for share in (0.9, 1.1)]
    hung = [solve_scene(read_scene(tables | bar), default_law()) for bar in bars]
    k = 0.2 * mass * G / (hung[0].x[:, 1].min() - hung[1].x[:, 1].min())
    tables["load"] = {"bar": {"mass": 1e3 * mass}}
    own = 1e-9 * default_law().cell.areal_mass_kg_per_m2 * 125.0 * length
    moving = mass + own / 3.0
    period = 2.0 * np.pi * np.sqrt(moving / k)
    X = hung[0].problem.disc.nodes
    drop = mass * G / k
    velocity = np.column_stack([0.0 * X[:, 0], -(length - X[:, 1]) / length])
    begin = np.sqrt(speed**2 + k * drop**2 / moving)
    found = thrown(tables, begin * velocity, 1.2 * period, period / 80)
    y = np.array([frame.moment.x[:, 1].min() for frame in found.frames])
    t = np.array([frame.moment.t for frame in found.frames])
    crossing = CubicSpline(t, y - y[0]).roots(extrapolate=False)
    assert crossing[2] == pytest.approx(period, rel=1e-2)
    peak = max(frame.supports[:, 1].sum() for frame in found.frames) - found.frames[0].supports[:, 1].sum()
    assert peak == pytest.approx(np.sqrt((mass * G) ** 2 + k * moving * speed**2), rel=1e-2)


@pytest.mark.release
def test_a_hanging_chain_swings_with_its_frequency_to_second_order():
    tables = {"curtain": {"width": 125.0, "height": 1000.0}, "mesh": {"cells": 2}, "support": TOP}
    modes = find_modes(solve_scene(read_scene(tables), default_law()), 1)
    period, shape = 1.0 / modes.frequencies_Hz[0], modes.shapes[0]
    errors, kept = [], []
    for steps in (25, 50, 100):
        velocity = 2.0 * 2.0 * np.pi / period * shape
        found = thrown(tables | {"solver": {"space": True}}, velocity, 1.55 * period, period / steps)
        weight = masses_of(found.frames[0].problem, ()) * shape[:, 2]
        z = np.array([weight @ frame.moment.x[:, 2] for frame in found.frames]) / (weight @ shape[:, 2])
        path = CubicSpline([frame.moment.t for frame in found.frames], z)
        crossing = [t for t in path.roots(extrapolate=False) if t > 0.1 * period]
        errors.append((crossing[2] - crossing[0]) / period - 1.0)
        kept.append(np.abs(path(path.derivative().roots(extrapolate=False)))[:3])
    assert 3.0 < (errors[0] - errors[1]) / (errors[1] - errors[2]) < 5.0
    assert abs(errors[2]) < 2.5e-3
    assert kept[2][2] == pytest.approx(kept[2][0], rel=1e-3)


@pytest.mark.release
def test_a_taut_strip_with_a_bar_swings_as_a_pendulum_of_large_amplitude():
    """T = 4 sqrt(l/g) K(sin^2(60 deg / 2)) for a strip m with a mass M at its end, l = L (M + m/3) / (M + m/2)."""
    bar, aim = 20.0, np.radians(60.0)
    tables = {"curtain": {"width": 125.0, "height": 1000.0}, "mesh": {"cells": 1}, "support": TOP}
    tables |= {"load": {"bar": {"mass": bar}}, "solver": {"space": True}}
    own = default_law().cell.areal_mass_kg_per_m2 * 0.125
    x = solve_scene(read_scene(tables), default_law()).x
    top, low = x[:, 1].max(), x[:, 1].argmin()
    length = (top - x[low, 1]) * (bar + own / 3.0) / (bar + own / 2.0)
    period = 4.0 * np.sqrt(length / G) * ellipk(np.sin(0.5 * aim) ** 2)
    velocity = np.zeros_like(x)
    velocity[:, 2] = np.sqrt(2.0 * G / length * (1.0 - np.cos(aim))) * (top - x[:, 1])
    late, low_by = [], []
    for steps in (50, 100, 200):
        found = thrown(tables, velocity, 1.05 * period, period / steps)
        path = CubicSpline(*np.array([(frame.moment.t, frame.moment.x[low, 2]) for frame in found.frames]).T)
        crossing = [t for t in path.roots(extrapolate=False) if t > 0.05 * period]
        late.append(abs(crossing[1] / period - 1.0))
        swing = np.abs(path(path.derivative().roots(extrapolate=False))).max()
        low_by.append(abs(swing / ((top - x[low, 1]) * np.sin(aim)) - 1.0))
    assert late[0] > 3.0 * late[1]
    assert late[2] < 2e-3
    assert low_by[0] > 3.0 * low_by[1] > 9.0 * low_by[2]
    assert low_by[2] < 3e-3


def test_the_work_of_a_moved_support_closes_the_account():
    top = TOP | {"move": [30.0, 20.0], "history": [[0.0, 0.0], [0.04, 1.0]]}
    _, told = moved({"support": top, "solver": {}, "motion": {"duration": 0.06, "step": 0.01}})
    assert told["work_N_mm"][-1] > 0.1 * (np.abs(told["work_N_mm"]) + told["kinetic_N_mm"]).max()
