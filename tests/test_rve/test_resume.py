"""A sweep that is killed goes on with the blocks it has not solved; blocks, order and workers change no bit."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rve
from rve.common.errors import InputError
from rve.equilibrium.system import Equations
from rve.geometry.kinematics import cauchy_line_load
from rve.geometry.weave import FOUR_IN_ONE
from rve.paper.checkpoints import SweepOptions, sweep
from rve.paper.dynamics import StewartTrinkleOptions
from rve.paper.stewart_trinkle import solve

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


def test_a_sweep_goes_on_from_the_blocks_that_are_there(whole, tmp_path):
    """One of three blocks is missing: it alone is solved, the others are read and keep their files."""
    how = SweepOptions(folder=tmp_path, block=2)
    sweep(LOADS, FOUR_IN_ONE, 0.1, OPTIONS, how)
    (tmp_path / "block-0001.json").unlink()
    before = {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert_same(sweep(LOADS, FOUR_IN_ONE, 0.1, OPTIONS, how), whole)
    after = {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert set(before) == {"block-0000.json", "block-0002.json"}
    assert after.keys() - before.keys() == {"block-0001.json"}
    assert before.items() <= after.items()


def test_what_is_read_is_what_was_kept(tmp_path):
    """A number changed in a file comes back changed: finished blocks are not solved again."""
    how = SweepOptions(folder=tmp_path, block=5)
    sweep(LOADS, FOUR_IN_ONE, 0.1, OPTIONS, how)
    path = tmp_path / "block-0000.json"
    content = json.loads(path.read_text())
    content["time"][3] = 123.5
    path.write_text(json.dumps(content))
    assert sweep(LOADS, FOUR_IN_ONE, 0.1, OPTIONS, how).time[3] == 123.5


def test_a_file_of_another_sweep_is_refused(tmp_path):
    how = SweepOptions(folder=tmp_path, block=5)
    quick = replace(OPTIONS, max_steps=2)
    sweep(LOADS, FOUR_IN_ONE, 0.1, quick, how)
    for other in ((LOADS[::-1], 0.1, quick), (LOADS, 0.09, quick), (LOADS, 0.1, replace(quick, stiffness=1e5))):
        with pytest.raises(InputError, match=r"block-0000.json: belongs to other loads, radii or options"):
            sweep(other[0], FOUR_IN_ONE, other[1], other[2], how)


def test_a_damaged_file_is_named(tmp_path):
    how = SweepOptions(folder=tmp_path, block=5)
    sweep(LOADS, FOUR_IN_ONE, 0.1, OPTIONS, how)
    path = tmp_path / "block-0000.json"
    whole = path.read_text()
    content = json.loads(whole)
    content["normals"][0][0] = [0.6, 0.0, 0.0]
    for text, words in (
        (whole[:100], "is not JSON"),
        (json.dumps({"key": content["key"]}), "lam: is missing|lattice: is missing"),
        (json.dumps(content), "not of length 1"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=f"block-0000.json: .*({words})"):
            sweep(LOADS, FOUR_IN_ONE, 0.1, OPTIONS, how)


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match=r"cannot be made|is a file"):
        sweep(LOADS, FOUR_IN_ONE, 0.1, OPTIONS, SweepOptions(folder=tmp_path / "file" / "x"))


@pytest.mark.slow
def test_a_killed_process_loses_nothing_but_its_last_block(whole, tmp_path):
    code = "import sys, numpy as np; from tests_loads import go; go(sys.argv[1])"
    (tmp_path / "tests_loads.py").write_text(
        "import numpy as np\n"
        "from rve.geometry.kinematics import cauchy_line_load\n"
        "from rve.paper.checkpoints import SweepOptions, sweep\n"
        "from rve.paper.stewart_trinkle import StewartTrinkleOptions\n"
        "from rve.geometry.weave import FOUR_IN_ONE\n"
        "def go(folder):\n"
        f"    s = np.array({LOADS.tolist()!r})\n"
        "    how = SweepOptions(folder=folder, block=2)\n"
        "    sweep(s, FOUR_IN_ONE, 0.1, StewartTrinkleOptions(max_steps=45), how)\n"
    )
    folder = tmp_path / "files"
    root = Path(rve.__file__).parents[1]
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join([str(root), str(tmp_path)]))
    process = subprocess.Popen([sys.executable, "-c", code, str(folder)], env=environment)
    for _ in range(600):
        if (folder / "block-0001.json").exists():
            break
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert (folder / "block-0001.json").exists()
    assert not (folder / "block-0002.json").exists()
    assert_same(sweep(LOADS, FOUR_IN_ONE, 0.1, OPTIONS, SweepOptions(folder=folder, block=2)), whole)
