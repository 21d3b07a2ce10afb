"""All ten rings with every constraint, and the periodic form: the same steps."""

from dataclasses import replace

import numpy as np
import pytest

from rve import Cell
from rve.geometry import FOUR_IN_ONE, cauchy_line_load
from rve.simulation import Dynamics, SimulationOptions
from rve.simulation import stewart_trinkle as st
from tests.test_rve import ten_rings as ten

OPTIONS = SimulationOptions()


def all_rings(motion, dynamics):
    """The first case of the periodic form as ten rings."""
    pose = motion.pose
    plane = pose.centres[0, ten.KIND] + ten.SHIFT @ np.stack([pose.a1[0], pose.a2[0]])
    speed = dynamics.ring_maps @ motion.v[0]
    flat = [ten.R1 * np.column_stack([part, np.zeros(ten.N)]) for part in (plane, speed)]
    spin = motion.v[0, 6:].reshape(2, 3)[ten.KIND]
    return ten.TenRings(flat[0], pose.normals[0, ten.KIND], np.concatenate([flat[1], spin], axis=1))


LOADS = [(20.0, 30.0, True), (45.0, 90.0, True), (0.0, 90.0, True), (20.0, 30.0, False)]
CASES = [pytest.param(*case, marks=pytest.mark.slow) for case in LOADS]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("alpha", "beta", "curvature"), [(0.0, 45.0, True), (10.0, 10.0, True), (10.0, 10.0, False), *CASES]
)
def test_every_step_is_the_same_to_round_off(alpha, beta, curvature):
    """Forces are stiffness times gap: a round-off of a gap, 1e-16, times the largest stiffness over load, 1.6e6.

    Gyroscopic torques vanish on the way, and velocities obey every constraint.
    """
    options = replace(OPTIONS, curvature=curvature)
    s, dynamics = cauchy_line_load([alpha], [beta]), Dynamics.of(Cell(), options)
    motion = st.begin(s, dynamics)
    for _ in range(40):
        before, tried = all_rings(motion, dynamics), motion.h[0]
        while not (step := ten.advanced(before, s[0], tried, options)).is_allowed:
            tried *= 0.5
        good = [False]
        while not good[0]:
            h = motion.h
            motion, good, rise = st.advance(motion, dynamics)
        after, found = all_rings(motion, dynamics), step.rings
        assert tried == h[0]
        assert found.centres == pytest.approx(after.centres, abs=1e-9)
        assert found.normals == pytest.approx(after.normals, abs=1e-9)
        assert found.v == pytest.approx(after.v, abs=1e-8)
        assert pytest.approx(motion.R[0], rel=1e-8) == step.R
        assert step.rise / (options.load * ten.R1**2) == pytest.approx(rise[0], abs=1e-9)  # force times way
        assert ten.bilateral(before) @ found.v.ravel() == pytest.approx(0.0, abs=1e-9)
        assert np.abs(ten.gyroscopic(found, ten.mass_matrix(found))).max() < 1e-15


def test_corner_forces_are_in_balance_and_work_like_a_line_load():
    s = np.array([2.0, 0.7, 1.1])
    dynamics = Dynamics.of(Cell(), OPTIONS)
    rings = all_rings(st.begin(s[None], dynamics), dynamics)
    f = ten.corner_forces(rings, s).reshape(-1, 6)
    assert f.sum(axis=0) == pytest.approx(0.0, abs=1e-12)
    assert np.cross(rings.centres, f[:, :3])[:, 2].sum() == pytest.approx(0.0, abs=1e-9)
    # Virtual work of a stretch along x: s_xx times the area of the cell.
    x2, y3 = ten.R1 * FOUR_IN_ONE.start_lattice[:2]
    assert f[:, 0] @ rings.centres[:, 0] == pytest.approx(2.0 * x2 * y3)
