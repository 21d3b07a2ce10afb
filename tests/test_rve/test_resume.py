"""A sweep that is killed goes on where it was; blocks, order and workers change no bit."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rve.common.errors import InputError
from rve.equilibrium.system import Equations
from rve.geometry.kinematics import cauchy_line_load
from rve.geometry.weave import FOUR_IN_ONE
from rve.paper import checkpoints as resume
from rve.paper.checkpoints import SweepOptions, sweep
from rve.paper.stewart_trinkle import StewartTrinkleOptions, solve

OPTIONS = StewartTrinkleOptions(max_steps=45)
LOADS = cauchy_line_load(np.array([0.0, 10.0, 20.0, 30.0, 45.0]), np.array([90.0, 40.0, 55.0, 20.0, 5.0]))


@pytest.fixture(scope="module")
def whole():
    return solve(LOADS, Equations.of(FOUR_IN_ONE, 0.1), OPTIONS)


def assert_same(one, two):
    for name in ("lattice", "centres", "normals"):
        assert np.array_equal(getattr(one.pose, name), getattr(two.pose, name))
    for name in ("R", "steps", "rejected", "time", "lam", "status"):
        assert np.array_equal(getattr(one, name), getattr(two, name))


@pytest.mark.parametrize("block", [1, 2, 5])
def test_blocks_change_no_bit(whole, block):
    assert_same(sweep(LOADS, FOUR_IN_ONE, 0.1, OPTIONS, SweepOptions(block=block)), whole)


def test_order_changes_no_bit(whole):
    order = np.array([3, 0, 4, 2, 1])
    turned = sweep(LOADS[order], FOUR_IN_ONE, 0.1, OPTIONS, SweepOptions(block=2))
    assert np.array_equal(turned.pose.lattice, whole.pose.lattice[order])
    assert np.array_equal(turned.lam, whole.lam[order])


def test_workers_change_no_bit(whole, tmp_path):
    how = SweepOptions(folder=tmp_path / "new", block=3, workers=2)
    assert_same(sweep(LOADS, FOUR_IN_ONE, 0.1, OPTIONS, how), whole)
    assert len(list((tmp_path / "new").iterdir())) == 2


@pytest.mark.parametrize("stop", [1, 8])
def test_a_stopped_sweep_goes_on(whole, tmp_path, monkeypatch, stop):
    how = SweepOptions(folder=tmp_path, block=2, save_every=10)
    real, calls = resume.continued, []

    def fragile(*args):
        calls.append(args)
        if len(calls) > stop:
            raise KeyboardInterrupt
        return real(*args)

    monkeypatch.setattr(resume, "continued", fragile)
    with pytest.raises(KeyboardInterrupt):
        sweep(LOADS, FOUR_IN_ONE, 0.1, OPTIONS, how)
    before = len(calls) - 1
    calls.clear()
    monkeypatch.setattr(resume, "continued", lambda *args: calls.append(args) or real(*args))
    assert_same(sweep(LOADS, FOUR_IN_ONE, 0.1, OPTIONS, how), whole)
    assert before + len(calls) == 15  # three blocks of 45 steps, ten at a time, none twice
    assert not [path for path in tmp_path.iterdir() if not path.name.startswith("block-")]


def test_a_finished_sweep_is_only_read(whole, tmp_path, monkeypatch):
    how = SweepOptions(folder=tmp_path, block=5)
    sweep(LOADS, FOUR_IN_ONE, 0.1, OPTIONS, how)
    monkeypatch.setattr(resume, "continued", None)
    assert_same(sweep(LOADS, FOUR_IN_ONE, 0.1, OPTIONS, how), whole)


def test_a_file_of_another_sweep_is_refused(tmp_path):
    how = SweepOptions(folder=tmp_path, block=5)
    quick = replace(OPTIONS, max_steps=2)
    sweep(LOADS, FOUR_IN_ONE, 0.1, quick, how)
    for other in ((LOADS[::-1], 0.1, quick), (LOADS, 0.09, quick), (LOADS, 0.1, replace(quick, stiffness=1e5))):
        with pytest.raises(InputError, match=r"block-0000.npz: belongs to other loads, radii or options"):
            sweep(other[0], FOUR_IN_ONE, other[1], other[2], how)


def test_a_damaged_file_is_named(tmp_path):
    (tmp_path / "block-0000.npz").write_bytes(b"PK\x03\x04 not an archive")
    with pytest.raises(InputError, match=r"block-0000.npz: is not a checkpoint"):
        sweep(LOADS, FOUR_IN_ONE, 0.1, OPTIONS, SweepOptions(folder=tmp_path, block=5))


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="cannot be made"):
        sweep(LOADS, FOUR_IN_ONE, 0.1, OPTIONS, SweepOptions(folder=tmp_path / "file" / "x"))


@pytest.mark.slow
def test_a_killed_process_loses_nothing_but_its_last_steps(whole, tmp_path):
    code = "import sys, numpy as np; from tests_loads import go; go(sys.argv[1])"
    (tmp_path / "tests_loads.py").write_text(
        "import numpy as np\n"
        "from rve.geometry.kinematics import cauchy_line_load\n"
        "from rve.paper.checkpoints import SweepOptions, sweep\n"
        "from rve.paper.stewart_trinkle import StewartTrinkleOptions\n"
        "from rve.geometry.weave import FOUR_IN_ONE\n"
        "def go(folder):\n"
        f"    s = np.array({LOADS.tolist()!r})\n"
        "    how = SweepOptions(folder=folder, block=2, save_every=1)\n"
        "    sweep(s, FOUR_IN_ONE, 0.1, StewartTrinkleOptions(max_steps=45), how)\n"
    )
    folder = tmp_path / "files"
    root = Path(resume.__file__).parents[1]
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join([str(root), str(tmp_path)]))
    process = subprocess.Popen([sys.executable, "-c", code, str(folder)], env=environment)
    for _ in range(600):
        if (folder / "block-0001.npz").exists():
            break
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert (folder / "block-0001.npz").exists()
    assert not (folder / "block-0002.npz").exists()
    assert_same(sweep(LOADS, FOUR_IN_ONE, 0.1, OPTIONS, SweepOptions(folder=folder, block=2, save_every=1)), whole)
