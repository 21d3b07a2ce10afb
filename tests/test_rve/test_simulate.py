"""`rve.simulate` and its command: every cell, loads one after the other and in time, what is written and refused."""

import json

import numpy as np
import pandas as pd
import pytest

from rve import Cell, DirectOptions, InputError, LoadHistory, SimulationOptions, simulate, solve_table
from rve.common import checksum
from rve.geometry.pose import turns_of
from rve.simulation import read_history
from rve.simulation.dynamics import Dynamics
from tests.commands import run

FAST = SimulationOptions(h_max=10.0)


@pytest.mark.parametrize(
    "seed", [pytest.param(i, marks=pytest.mark.release if i > 7 else pytest.mark.slow) for i in range(20)]
)
def test_random_cells_rest_where_the_direct_solver_locks_them(seed):
    """To the order of load over contact stiffness, 2.5e-6 here; twice that in strain."""
    rng = np.random.default_rng(seed)
    weave, least = (("6-in-1", 6.2), ("6-in-1", 6.2), ("4-in-1", 4.2))[seed % 3]
    r1 = np.exp(rng.uniform(np.log(0.5), np.log(150.0)))
    cell = Cell(r1, r1 / rng.uniform(least, 20.0), weave=weave, grain="yx"[seed % 2])
    loads = rng.uniform(-45.0, 45.0, 2), rng.uniform(5.0, 85.0, 2)
    found, locked = simulate(cell, loads, FAST), solve_table(cell, loads, DirectOptions(branches="first"))
    assert found.status.tolist() == ["converged"] * 2
    assert locked.unique.all()
    assert pytest.approx(locked.E, abs=5e-6) == found.E
    assert np.abs(found.E).max() > 1e-3


def test_rings_of_several_sizes_tilt_as_fast_as_they_move():
    """Drag of a tilt is that of a motion of the ring's centre line by as much."""
    cell = Cell(6.0, 0.6, "japanese-4-in-1")
    dynamics = Dynamics.of(cell, SimulationOptions(damping=3.0, rotational_damping=5.0))
    for ring, (radius, wire) in enumerate(zip(cell.weave.radii, cell.weave.wires, strict=True)):
        places = int((cell.weave.rings[:, 0] == ring).sum())
        expected = places * 3.0 / 2.5 * radius * wire**2 * 5.0 * radius**2
        turns = turns_of(cell.weave, ring)
        assert dynamics.drag[turns, turns] == pytest.approx(expected * np.eye(3))


@pytest.mark.slow
@pytest.mark.parametrize("centres", ["plane", "space"])
def test_a_larger_cell_rests_like_the_primitive_one(centres):
    one = simulate(Cell(), ([20.0], [45.0]), FAST)
    two = simulate(Cell(cells=(2, 1), centres=centres), ([20.0], [45.0]), FAST)
    assert two.status[0] == "converged"
    assert pytest.approx(one.E, abs=5e-6) == two.E


@pytest.mark.slow
def test_loads_that_follow_each_other_rest_where_each_does_alone():
    stages = np.array([[60.0, 30.0, 60.0]])
    found = simulate(Cell(grain="x"), (10.0 + 0.0 * stages, stages), FAST)
    alone = simulate(Cell(grain="x"), ([10.0, 10.0], [60.0, 30.0]), FAST)
    E = found.strain(found.lattice)[0]
    assert E[[0, 1]] == pytest.approx(alone.E, abs=1e-8)
    assert E[[2]] == pytest.approx(E[[0]], abs=1e-8)
    assert found.E[0] == pytest.approx(E[2], abs=0.0)


@pytest.mark.slow
def test_a_load_in_time_is_met_at_its_times_and_rests_at_its_end():
    history = LoadHistory([0.0, 7.3, 30.0], [20.0, 20.0, 0.0], [45.0, 80.0, 45.0], [0.5, 2.0, 1.0])
    found = simulate(Cell(), history)
    rows, E = found.path(0)
    time, s = found.history.time[rows], found.history.s[rows]
    assert {7.3, 30.0} <= set(time)
    assert s[time == 7.3] == pytest.approx(history.s[[1]], abs=1e-12)
    middle = np.flatnonzero((time > 7.3) & (time < 30.0))[5]
    share = (time[middle] - 7.3) / 22.7
    assert s[middle] == pytest.approx((1.0 - share) * history.s[1] + share * history.s[2])
    assert time[-1] > 30.0
    assert pytest.approx(simulate(Cell(), ([0.0], [45.0])).E, abs=1e-8) == found.E
    assert E[-1] == pytest.approx(found.E[0], abs=0.0)


def test_a_load_that_is_let_go_leaves_the_rings_where_they_are():
    """Rigid rings store nothing: without a load damping stops them within a blink, and they rest when it comes back."""
    history = LoadHistory([0.0, 100.0, 101.0, 150.0, 151.0], [0.0] * 5, [60.0] * 5, [1.0, 1.0, 0.0, 0.0, 1.0])
    found = simulate(Cell(), history)
    rows, E = found.path(0)
    time = found.history.time[rows]
    assert found.status[0] == "converged"
    assert np.ptp(E[time >= 100.0], axis=0).max() < 1e-5


def test_a_case_that_does_not_rest_says_so_and_keeps_its_last_state():
    found = simulate(Cell(), ([0.0, 0.0], [45.0, 60.0]), SimulationOptions(max_steps=5))
    assert found.status.tolist() == ["step-limit"] * 2
    assert np.isnan(found.lattice).all()
    assert np.isfinite(found.E).all()
    assert found.rest.steps.tolist() == [5, 5]


@pytest.mark.parametrize(
    ("loads", "words"),
    [
        (([0.0], [120.0]), "cannot push"),
        (([0.0], [np.nan]), "finite"),
        (([0.0], ["much"]), "numbers"),
        (([], []), "^alpha and beta must be finite"),
        (([0.0, 1.0], [1.0, 2.0, 3.0]), "as many"),
    ],
)
def test_loads_that_make_no_sense_are_refused(loads, words):
    with pytest.raises(InputError, match=words):
        simulate(Cell(), loads)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("0,0,45,1\n0,0,60,1\n", "rise"),
        ("1,0,45,1\n", "begin at 0"),
        ("0,0,45,1\n5,0,45,0\n", "last one"),
        ("0,0,95,1\n", "cannot push"),
        ("0,360.5,45,1\n", "from -360 to 360"),
        ("0,0,45,x\n", "line 2"),
    ],
)
def test_histories_that_make_no_sense_are_refused_by_their_file(rows, words, tmp_path):
    path = tmp_path / "history.csv"
    path.write_text("time_s,alpha_deg,beta_deg,size\n" + rows)
    with pytest.raises(InputError, match=words) as refused:
        read_history(path)
    assert "history.csv" in str(refused.value)


@pytest.mark.slow
def test_the_command_writes_the_path_and_the_end_beside_the_direct_solver(tmp_path):
    out = tmp_path / "run.csv"
    words = ("--alpha", "20", "--beta", "45,60", "--set", "h_max=10", "--r1", "6", "--r2", "0.7")
    done = run("rve", "simulate", *words, "--out", out, "--plot", tmp_path / "run.png")
    frame, record = pd.read_csv(out), json.loads((tmp_path / "run.json").read_text())
    assert list(frame)[:8] == ["case", "t_s", "h_s", "E11", "E12", "E22", "R", "kinetic_N_mm"]
    assert record["files"] == {"run.csv": checksum(out)}
    assert record["options"]["h_max"] == 10.0
    for number, (end, (_, steps)) in enumerate(zip(record["ends"], frame.groupby("case"), strict=True), 1):
        last = steps.iloc[-1]
        assert len(steps) == end["steps"]
        assert last.t_s == pytest.approx(steps.h_s.sum())
        assert last.R < 1e-9
        for name in ("E11", "E12", "E22"):
            assert last[name] == pytest.approx(end[name], abs=1e-12)
            assert end[name] == pytest.approx(end[f"{name}_direct"], abs=5e-6)
        assert f"beta {[45, 60][number - 1]}: converged" in done.output
    assert (tmp_path / "run.png").stat().st_size > 20_000


def test_the_command_takes_a_history_and_says_what_does_not_rest(tmp_path):
    history = tmp_path / "history.csv"
    history.write_text("time_s,alpha_deg,beta_deg,size\n0,0,90,1\n20,0,45,1\n")
    words = ("--history", history, "--set", "max_steps=9", "--out", tmp_path / "run.csv")
    done = run("rve", "simulate", *words, codes=(1,))
    assert "step-limit" in done.stderr
    assert len(pd.read_csv(tmp_path / "run.csv")) == 9


@pytest.mark.slow
def test_the_command_prints_the_loop(tmp_path):
    words = ("--alpha", "0", "--beta", "45", "--to", "0,60", "--friction", "0.05", "--set", "tolerance=1e-4")
    done = run("rve", "simulate", *words, "--out", tmp_path / "run.csv", "--plot", tmp_path / "loop.png", "--json")
    loop = json.loads(done.stdout)["loop"]
    assert 0.0 < loop["friction_N_per_mm"] == pytest.approx(loop["area_N_per_mm"], rel=0.1)
    assert 0.05 < loop["damping_ratio"] < 1.0
    assert loop["band"]["E11"] > 0.01
