"""Every ring in motion: free motion against closed forms, conservation, the energy account, links and files."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from homogenize import default_law
from macro_fem import EveryRing, read_scene
from macro_fem.cli import main
from macro_fem.motion import COLUMNS, TONNE, Moment, MovingRings, account_error
from macro_fem.output import in_turn, parts
from rve import InputError
from rve.finite import slack_rings
from tests.films import film_of
from tests.test_macro_fem.sheets import fallen, still_air

G = 9810.0
CELL = default_law().cell
W, H = 3 * CELL.b_x_mm, 2 * CELL.b_y_mm
CURTAIN = {"curtain": {"width": W, "height": H}}
FREE = {"support": {"kind": "top", "release": 0.0}, "motion": {"duration": 1.0, "start": "reference"}}
CORNERS = [
    {"kind": "point", "at": [0.0, H], "move": [0.05 * W, 0.0]},
    {"kind": "point", "at": [W, H], "move": [-0.05 * W, 0.0]},
]


def moved(tables, *, space=True):
    """The run of a scene and its rows by name: every step is solved, the account closes, no link and no gap is lost."""
    found = MovingRings(read_scene(CURTAIN | tables), EveryRing(space=space)).solve()
    assert found.status == "converged", found.message
    rows = np.array([frame.row for frame in found.frames])
    assert account_error(rows) < 1e-8
    assert all(one.rings.contacts.links_intact and one.rings.contacts.min_gap_mm > 0.0 for one in found.frames)
    assert np.diff(rows[:, COLUMNS.index("lost_by_locking_N_mm")]).min() >= 0.0
    assert np.diff(rows[:, COLUMNS.index("lost_by_damping_N_mm")]).min() >= 0.0
    return found, dict(zip(COLUMNS, rows.T, strict=True))


@pytest.mark.parametrize("support", [FREE["support"] | {"gather": 0.9}, []])
def test_a_sheet_without_supports_falls_freely(support):
    found, told = moved({"support": support, "motion": {"duration": 0.06, "step": 0.01, "start": "reference"}})
    t, fallen = told["t_s"][-1], told["mean_y_mm"][0] - told["mean_y_mm"][-1]
    start = 0.75 * (1.0 - 3.0**-6) * 0.01**2 * G  # what Euler's first step goes too far
    assert fallen - start == pytest.approx(0.5 * G * t * t, rel=1e-8)
    assert told["support_force_N"] == pytest.approx(0.0, abs=1e-9)
    assert found.frames[-1].rings.normal == pytest.approx(found.frames[0].rings.normal, abs=1e-9)


@pytest.mark.parametrize(
    ("resists", "wind"),
    [
        pytest.param("damping", {}, marks=pytest.mark.release),
        pytest.param("drag", {"speed": 0.0, "direction": [0.0, 0.0, 1.0]}, marks=pytest.mark.slow),
    ],
)
def test_rings_fall_with_damping_and_in_still_air_to_second_order(resists, wind):
    errors, load = [], {"gravity": [0.0, 0.0, -9.81]} | ({"wind": wind} if wind else {})
    for step in (0.04, 0.02, 0.01):
        motion = {"duration": 0.4, "step": step, "start": "reference"} | ({} if wind else {"damping": 3.0})
        _, told = moved({"support": FREE["support"], "load": load, "motion": motion})
        exact = fallen(0.4, **{resists: still_air() if wind else 3.0})[0]
        errors.append(-told["mean_z_mm"][-1] / exact - 1.0)
    assert 0.0 < 11.0 * errors[2] < errors[0]
    assert errors[2] < (1.1e-3 if wind else 1.95e-4)  # wind is shared among rings by the nearest nodes


def test_start_lays_the_slack_weave_in_space():
    laid = {"origin": [30.0, 100.0, 10.0], "x_axis": [0.0, 0.0, 1.0], "y_axis": [0.6, 0.8, 0.0]}
    one, two = (MovingRings(read_scene(CURTAIN | FREE | more)).first_frame().rings for more in ({"start": laid}, {}))
    turn = np.array([[0.0, 0.6, -0.8], [0.0, 0.8, 0.6], [1.0, 0.0, 0.0]])
    assert one.centre == pytest.approx(two.centre @ turn.T + [30.0, 100.0, 10.0])
    assert one.normal == pytest.approx(two.normal @ turn.T)
    assert one.contacts.min_gap_mm == pytest.approx(two.contacts.min_gap_mm)


def tossed(scheme, steps, duration, speed):
    """Momentum and angular momentum (steps + 1, 3) of a sheet without supports and weight, of random velocities in mm/s
    and turns, and its last frame."""
    moving = MovingRings(read_scene(CURTAIN | FREE | {"load": {"gravity": 0.0}}), EveryRing())
    asked = moving.at(duration)
    frame = moving.frame_of(slack_rings(asked.mesh))
    n, rng = len(asked.mass), np.random.default_rng(0)
    spin = np.array([10.0, 20.0, 40.0])
    v = np.cross(np.concatenate([np.tile(spin, (n, 1)), spin + rng.normal(0.0, 20.0, (n, 3))]), frame.moment.x)
    v[:n] += rng.normal(0.0, speed, (n, 3))
    frame = replace(frame, moment=Moment(0.0, frame.moment.x, v))
    mass = TONNE * np.tile(asked.mass, 2)[:, None]
    moments, before = [frame.moment], None
    for _ in range(steps):
        frame = moving.next_frame(frame, before, duration / steps)
        before = moments[-1] if scheme == "bdf2" else None
        moments.append(frame.moment)
        assert frame.rings.contacts.links_intact
        assert frame.rings.contacts.min_gap_mm > 0.0
    momentum = np.array([(mass * one.v)[:n].sum(axis=0) for one in moments])
    return momentum, np.array([np.cross(one.x, mass * one.v).sum(axis=0) for one in moments]), frame


@pytest.mark.parametrize(("scheme", "order"), [("euler", 1), ("bdf2", 2)])
def test_momentum_is_kept_and_angular_momentum_to_the_order_of_the_scheme(scheme, order):
    """Rings that turn freely and do not meet: halved steps lose a half and a quarter of the angular momentum."""
    lost = []
    for steps in (8, 16):
        momentum, angular, _ = tossed(scheme, steps, 4e-3, 60.0)
        assert np.abs(momentum - momentum[0]).max() < 1e-12 * np.abs(momentum).max()
        lost.append(np.abs(angular - angular[0]).max() / np.abs(angular[0]).max())
    assert lost[0] < 1e-4
    assert np.log2(lost[0] / lost[1]) == pytest.approx(order, abs=0.15)


@pytest.mark.slow
def test_rings_that_collide_keep_momentum_and_links_and_lose_energy():
    momentum, angular, last = tossed("euler", 12, 0.02, 300.0)
    assert last.account.lost_by_locking > 0.05 * last.account.kinetic
    assert np.abs(momentum - momentum[0]).max() < 1e-8 * np.abs(momentum).max()
    assert np.abs(angular - angular[0]).max() < 0.05 * np.abs(angular[0]).max()


@pytest.mark.slow
def test_rest_stays_rest_and_supports_carry_the_weight():
    """Also in steps so short that places to round-off leave a larger residual than the tolerance."""
    held = [one | {"history": [[0.0, 1.0], [1.0, 1.0 + 1e-9]]} for one in CORNERS]  # without, no step would be solved
    found, told = moved({"support": held, "motion": {"duration": 0.01, "step": 2e-3}}, space=False)
    moved({"support": held, "motion": {"duration": 5e-5, "step": 1e-5}}, space=False)
    assert told["support_force_N"] == pytest.approx(1e3 * TONNE * 9.81 * found.frames[0].asked.mass.sum(), rel=1e-4)
    assert np.ptp(told["mean_y_mm"]) < 1e-6
    assert np.abs(found.frames[-1].rings.centre[:, 2]).max() == 0.0


@pytest.mark.slow
def test_a_moved_support_works_and_damping_loses():
    """A top that is raised by a history: its work is what the sheet gains, and what damping and the scheme lose."""
    support = {"kind": "top", "move": [0.0, 2.0], "history": [[0.0, 0.0], [0.02, 1.0]]}
    _, told = moved({"support": support, "motion": {"duration": 0.02, "step": 2e-3, "damping": 20.0}}, space=False)
    assert told["work_N_mm"][-1] > told["potential_N_mm"][-1] - told["potential_N_mm"][0] > 0.0
    assert told["lost_by_damping_N_mm"][-1] > 0.0


def test_a_falling_sheet_lands_on_a_floor():
    motion = {"motion": {"duration": 0.04, "step": 4e-3, "start": "reference"}}
    floor = FREE | motion | {"obstacle": [{"kind": "floor", "height": -5.0}]}
    found, told = moved(floor)
    last = found.frames[-1].rings
    assert last.wall_force[0][1] > 0.0
    assert last.centre[:, 1].min() > -5.0
    assert told["lost_by_locking_N_mm"][-1] > 0.0
    ball = {"kind": "sphere", "radius": 5.0, "mass": 1.0, "at": [99.0, 2.0, 0.0]}
    ended = MovingRings(read_scene(CURTAIN | floor | {"body": ball})).solve()
    assert (ended.status, ended.message[:29]) == ("stalled", "ball meets floor before 0.019")


@pytest.mark.slow
def test_a_ball_that_strikes_a_sheet_without_supports_keeps_momentum_and_links():
    """And none of its wires is inside the ball, by sampling: the ball is kept off, not through a hole."""
    ball = {"kind": "sphere", "radius": 8.0, "mass": 0.02, "at": [0.5 * W, 0.5 * H, 14.0], "velocity": [0, 0, -1500.0]}
    motion = {"duration": 0.008, "step": 2e-3, "start": "reference"}
    found, told = moved(FREE | {"load": {"gravity": 0.0}, "body": [ball], "motion": motion})
    mass = TONNE * np.append(found.frames[0].asked.mass, 0.02)[:, None]
    n = len(mass) - 1
    momentum = np.array([(mass * np.delete(one.moment.v, np.s_[n : 2 * n], 0)).sum(axis=0) for one in found.frames])
    assert np.abs(momentum - momentum[0]).max() < 1e-10 * np.abs(momentum).max()
    assert momentum[-1, 2] == pytest.approx(-TONNE * 0.02 * 1500.0)
    last = found.frames[-1].rings
    gap = np.linalg.norm(last.drawn.circles(720)[0] - last.walls[-1].place, axis=2).min() - 8.0 - CELL.r2_mm
    assert -1e-9 < gap < 0.1
    assert told["mean_z_mm"][-1] < -0.5
    assert told["lost_by_locking_N_mm"][-1] > 0.0
    drawn = replace(last, walls=last.walls * 2).drawn  # two of one name are two
    ax = drawn.plot()
    assert [one.center for one in ax.patches] == [pytest.approx(found.frames[-1].moment.x[-1, :2])] * 2
    ax.collections[0].update_scalarmappable()
    assert len(np.unique(ax.collections[0].get_edgecolor(), axis=0)) > 2  # by their forces
    assert {"ball", "ball 2"} <= set(parts(drawn.draw()))
    views = MovingRings(read_scene(CURTAIN | FREE)).views([found.frames[0], found.frames[-1]])
    first, last = (plotter.camera.focal_point for _, plotter in in_turn(zip("ab", views, strict=True)))
    assert first == last  # one camera for all moments


def test_wind_with_a_speed_acts_by_the_velocity_relative_to_the_rings():
    """A sheet without supports and weight that flies along the wind at a share of its speed: |e_n| (2 e+ - e_n) of the
    force, e being what is left of the speed; still air, too, resists."""
    wind = {"speed": 20.0, "direction": [0.0, 0.6, -0.8], "history": [[0.0, 1.0], [1.0, 1.0], [2.0, 0.0]]}
    scene = read_scene(CURTAIN | FREE | {"load": {"gravity": 0.0, "wind": wind}})
    moving, h = MovingRings(scene, EveryRing()), 1e-3
    asked = moving.at(1e-3)
    start = moving.frame_of(slack_rings(asked.mesh))
    n, v = len(asked.mass), np.zeros_like(start.moment.v)
    along = np.array([0.0, 0.6, -0.8])
    for t, share, last in ((0.0, 0.25, 0.75), (0.0, 1.5, -0.5), (2.0, 0.5, -0.5)):
        v[:n] = share * 20e3 * along
        end = moving.next_frame(replace(start, moment=Moment(t, start.moment.x, v)), None, h)
        gained = (TONNE * asked.mass[:, None] * (end.moment.v - v)[:n]).sum(axis=0)
        left = abs(last) * (2.0 * (last + share - (end.moment.v[:n] @ along).mean() / 20e3) - last)
        assert left == pytest.approx(last * abs(last), rel=0.02)
        assert gained == pytest.approx(left * h * np.linalg.norm(asked.force.sum(axis=0)) * along, rel=1e-7, abs=1e-12)


@pytest.mark.parametrize(
    ("tables", "says"),
    [
        ({"support": CORNERS, "motion": {"duration": 1.0, "start": "reference"}}, "use 'hung'"),
        (FREE | {"body": [{"kind": "sphere", "radius": 5.0, "mass": 1.0, "at": [9.0, 9.0, 6.0]}]}, "inside a body"),
        ({"support": CORNERS}, "is missing"),
    ],
)
def test_what_rings_in_motion_cannot_do_is_refused_in_a_sentence(tables, says):
    with pytest.raises(InputError, match=says) as error:
        MovingRings(read_scene(CURTAIN | tables)).solve()
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_rings_with_motion_writes_its_files(tmp_path):
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    scene.write_text(
        f'[curtain]\nwidth = {W}\nheight = {H}\n[[support]]\nkind = "top"\n[[support]]\nkind = "point"\n'
        f"at = [0.0, 0.0]\nmove = [0.0, 1.0]\nrelease = 0.002\n[motion]\nduration = 0.01\nstep = 0.002\n"
    )
    result = CliRunner().invoke(main, ["rings", str(scene), "--out", str(out), "--plane", "--animation"])
    assert result.exit_code == 0, result.output
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["status"], summary["links_intact"]) == ("converged", True)
    assert summary["account_error"] < 1e-8
    rows = list(csv.reader((out / "motion.csv").read_text().splitlines()))
    assert (tuple(rows[0]), len(rows)) == (COLUMNS, 7)
    frames, changed = film_of(out / "motion.gif")
    assert (frames, changed > 1e-3) == (6, True)
    names = ("summary.json", "motion.csv", "motion.pvd", "motion.png", "motion.npz", "motion.gif", "support_forces.csv")
    written = {one.name for one in out.iterdir()} - {"motion.mp4"}  # where ffmpeg is installed
    assert written == {*names, *(f"motion_{k:04d}.vtu" for k in range(6))}


@pytest.mark.slow
def test_a_run_of_rings_goes_on_as_if_it_had_not_ended(tmp_path):
    """A ball falls on a hung sheet: places, forces, bodies and peaks of one run, and of two with --continue."""
    whole, part = tmp_path / "whole.toml", tmp_path / "part.toml"
    text = (
        f'[curtain]\nwidth = {W}\nheight = {H}\n[[support]]\nkind = "top"\n[[body]]\nkind = "sphere"\nradius = 7.0\n'
        f"mass = 0.01\nat = [{0.5 * W}, 5.0, 9.0]\nvelocity = [0.0, 0.0, -900.0]\n[motion]\n"
        "duration = 0.006\nstep = 0.002\n"
    )
    whole.write_text(text)
    part.write_text(text.replace("0.006\nstep", "0.004\nstep"))
    for scene, out, more in ((whole, "one", ()), (part, "two", ()), (whole, "two", ("--continue",))):
        result = CliRunner().invoke(main, ["rings", str(scene), "--out", str(tmp_path / out), "--no-picture", *more])
        assert result.exit_code == 0, result.output
    rows = [np.loadtxt(tmp_path / out / "motion.csv", delimiter=",", skiprows=1) for out in ("one", "two")]
    assert rows[1] == pytest.approx(rows[0], rel=1e-6, abs=1e-6)
    one, two = (json.loads((tmp_path / out / "summary.json").read_text()) for out in ("one", "two"))
    assert two["bodies"][0]["end_mm"] == pytest.approx(one["bodies"][0]["end_mm"], abs=1e-6)
    assert two["peak_contact_force_N"] == pytest.approx(one["peak_contact_force_N"], rel=1e-6)
    assert two["links_intact"]
    assert {"bodies.csv", "bodies_0003.vtu", "motion_0003.vtu"} <= {path.name for path in (tmp_path / "two").iterdir()}
    for other in (part, tmp_path / "another.toml"):
        other.write_text(other.read_text() if other is part else text.replace('"top"', '"top"\nrelease = 9.0'))
        again = CliRunner().invoke(main, ["rings", str(other), "--out", str(tmp_path / "two"), "--continue"])
        assert again.exit_code == 2
        assert ("longer duration" if other is part else "another scene") in again.output
