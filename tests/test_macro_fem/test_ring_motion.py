"""Every ring in motion: free motion against closed forms, conservation, the energy account, links and files."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from homogenize import default_law
from macro_fem.cli import main
from macro_fem.motion.files import COLUMNS, account_error
from macro_fem.motion.masses import TONNE
from macro_fem.motion.scheme import Moment
from macro_fem.motion.stage import scene_at
from macro_fem.rings.every_ring import EveryRing
from macro_fem.rings.motion import RingStage, first_ring_frame, next_ring_frame, solve_ring_motion
from macro_fem.rings.motion_files import ring_row
from macro_fem.rings.ring_scene import ring_scene
from macro_fem.scene.schema import read_scene
from rve import slack_rings
from rve.common.errors import InputError

G = 9810.0
CELL = default_law().cell
W, H = 3 * CELL.b_x_mm, 2 * CELL.b_y_mm
CURTAIN = {"curtain": {"width": W, "height": H}}
CORNERS = [
    {"kind": "point", "at": [0.0, H], "move": [0.05 * W, 0.0]},
    {"kind": "point", "at": [W, H], "move": [-0.05 * W, 0.0]},
]


def moved(tables, *, space=True):
    """The run of a scene and its rows by name: every step is solved, the account closes, no link and no gap is lost."""
    found = solve_ring_motion(read_scene(CURTAIN | tables), EveryRing(space=space))
    assert found.status == "converged", found.message
    rows = np.array([ring_row(frame) for frame in found.frames])
    assert account_error(rows) < 1e-8
    for frame in found.frames:
        assert frame.rings.contacts.links_intact
        assert frame.rings.contacts.min_gap_mm > 0.0
    assert np.diff(rows[:, COLUMNS.index("lost_by_locking_N_mm")]).min() >= 0.0
    assert np.diff(rows[:, COLUMNS.index("lost_by_damping_N_mm")]).min() >= 0.0
    return found, dict(zip(COLUMNS, rows.T, strict=True))


def test_a_sheet_without_supports_falls_freely():
    support = {"kind": "top", "release": 0.0}
    found, told = moved({"support": support, "motion": {"duration": 0.06, "step": 0.01, "start": "reference"}})
    t, fallen = told["t_s"][-1], told["mean_y_mm"][0] - told["mean_y_mm"][-1]
    start = 0.75 * (1.0 - 3.0**-6) * 0.01**2 * G  # what Euler's first step goes too far
    assert fallen - start == pytest.approx(0.5 * G * t * t, rel=1e-8)
    assert told["support_force_N"] == pytest.approx(0.0, abs=1e-9)
    assert found.frames[-1].rings.normal == pytest.approx(found.frames[0].rings.normal, abs=1e-9)


def tossed(scheme, steps, duration, speed):
    """Momentum and angular momentum (steps + 1, 3) of a sheet without supports and weight, of random velocities in mm/s
    and turns, and its last frame."""
    tables = {"support": {"kind": "top", "release": 0.0}, "load": {"gravity": 0.0}, "motion": {"duration": 1.0}}
    scene = scene_at(read_scene(CURTAIN | tables), 0.0)
    stage = RingStage(scene, ring_scene(scene))
    asked = stage.at(duration)
    frame = first_ring_frame(asked, slack_rings(asked.mesh))
    n, rng = len(asked.mass), np.random.default_rng(0)
    spin = np.array([10.0, 20.0, 40.0])
    v = np.cross(np.concatenate([np.tile(spin, (n, 1)), spin + rng.normal(0.0, 20.0, (n, 3))]), frame.moment.x)
    v[:n] += rng.normal(0.0, speed, (n, 3))
    frame = replace(frame, moment=Moment(0.0, frame.moment.x, v))
    mass = TONNE * np.tile(asked.mass, 2)[:, None]
    moments, before = [frame.moment], None
    for _ in range(steps):
        frame = next_ring_frame(stage, 0.0, frame, before, duration / steps)
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


def test_rings_that_collide_keep_momentum_and_links_and_lose_energy():
    momentum, angular, last = tossed("euler", 12, 0.02, 300.0)
    assert last.account.lost_by_locking > 0.05 * last.account.kinetic
    assert np.abs(momentum - momentum[0]).max() < 1e-8 * np.abs(momentum).max()
    assert np.abs(angular - angular[0]).max() < 0.05 * np.abs(angular[0]).max()


def test_rest_stays_rest_and_supports_carry_the_weight():
    found, told = moved({"support": CORNERS, "motion": {"duration": 0.01, "step": 2e-3}}, space=False)
    weight = 1e3 * TONNE * 9.81 * found.frames[0].asked.mass.sum()
    assert told["support_force_N"] == pytest.approx(weight, rel=1e-4)
    assert np.ptp(told["mean_y_mm"]) < 1e-6
    assert np.abs(found.frames[-1].rings.centre[:, 2]).max() == 0.0


def test_a_moved_support_works_and_damping_loses():
    """A top that is raised by a history: its work is what the sheet gains, and what damping and the scheme lose."""
    support = {"kind": "top", "move": [0.0, 2.0], "history": [[0.0, 0.0], [0.02, 1.0]]}
    _, told = moved({"support": support, "motion": {"duration": 0.02, "step": 2e-3, "damping": 20.0}}, space=False)
    assert told["work_N_mm"][-1] > told["potential_N_mm"][-1] - told["potential_N_mm"][0] > 0.0
    assert told["lost_by_damping_N_mm"][-1] > 0.0


def test_a_falling_sheet_lands_on_a_floor():
    floor = {"kind": "floor", "height": -5.0}
    motion = {"duration": 0.04, "step": 4e-3, "start": "reference"}
    found, told = moved({"support": {"kind": "top", "release": 0.0}, "obstacle": [floor], "motion": motion})
    last = found.frames[-1].rings
    assert last.wall_force[0][1] > 0.0
    assert last.centre[:, 1].min() > -5.0
    assert told["lost_by_locking_N_mm"][-1] > 0.0


@pytest.mark.parametrize(
    ("tables", "says"),
    [
        ({"support": CORNERS, "motion": {"duration": 1.0, "start": "reference"}}, "use 'hung'"),
        (
            {"support": CORNERS, "motion": {"duration": 1.0}, "load": {"wind": {"speed": 3.0, "direction": [0, 0, 1]}}},
            "pressure",
        ),
        (
            {
                "support": CORNERS,
                "motion": {"duration": 1.0},
                "body": [{"kind": "sphere", "radius": 5.0, "mass": 1.0, "at": [0.0, 0.0, 30.0]}],
            },
            "no bodies",
        ),
        ({"support": CORNERS}, "is missing"),
    ],
)
def test_what_rings_in_motion_cannot_do_is_refused_in_a_sentence(tables, says):
    with pytest.raises(InputError, match=says) as error:
        solve_ring_motion(read_scene(CURTAIN | tables))
    assert "\n" not in str(error.value)


def test_rings_with_motion_writes_its_files(tmp_path):
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    scene.write_text(
        f'[curtain]\nwidth = {W}\nheight = {H}\n[[support]]\nkind = "top"\n[[support]]\nkind = "point"\n'
        f"at = [0.0, 0.0]\nmove = [0.0, 1.0]\nrelease = 0.002\n[motion]\nduration = 0.01\nstep = 0.002\n"
    )
    result = CliRunner().invoke(main, ["rings", str(scene), "--out", str(out), "--plane"])
    assert result.exit_code == 0, result.output
    summary = json.loads((out / "summary.json").read_text())
    assert summary["status"] == "converged"
    assert summary["links_intact"]
    assert summary["account_error"] < 1e-8
    with (out / "motion.csv").open() as file:
        rows = list(csv.reader(file))
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) == 7
    assert {one.name for one in out.iterdir()} == {
        *("summary.json", "motion.csv", "motion.pvd", "motion.png"),
        *(f"motion_{k:04d}.vtu" for k in range(6)),
    }
