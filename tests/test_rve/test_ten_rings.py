"""All ten rings with every constraint, and the periodic form: one trajectory."""

from dataclasses import replace

import numpy as np
import pytest

from rve.equilibrium.system import Equations
from rve.geometry.kinematics import cauchy_line_load
from rve.geometry.weave import FOUR_IN_ONE
from rve.paper import stewart_trinkle as st
from rve.paper.dynamics import StewartTrinkleOptions
from tests.test_rve import ten_rings as ten

EQUATIONS = Equations.of(FOUR_IN_ONE, 0.1)
OPTIONS = StewartTrinkleOptions()


def walk(s, options, steps):
    """States of both forms after the same number of accepted steps."""
    motion = st.begin(s[None], EQUATIONS, options)
    rings = ten.start(FOUR_IN_ONE, options)
    dynamics = st.Dynamics.of(EQUATIONS, options)
    for _ in range(steps):
        motion, h, rise = st.advanced(motion, EQUATIONS, options, dynamics)
        rings, rise_ten = ten.advanced(rings, s, FOUR_IN_ONE, EQUATIONS.wire, options)
        yield motion, h[0], rise[0], rings, rise_ten


def all_rings(motion, dynamics, options):
    """The first case of the periodic form as ten rings."""
    pose, kind = motion.pose, FOUR_IN_ONE.rings[:, 0]
    plane = pose.centres[0, kind] + FOUR_IN_ONE.rings[:, 1:] @ np.stack([pose.a1[0], pose.a2[0]])
    centres = options.r1_mm * np.column_stack([plane, np.zeros(len(kind))])
    speed = options.r1_mm * np.column_stack([dynamics.ring_maps @ motion.v[0], np.zeros(len(kind))])
    spin = motion.v[0, 6:].reshape(2, 3)[kind]
    return ten.TenRings(centres, pose.normals[0][kind], np.concatenate([speed, spin], axis=1), motion.h[0])


CASES = [(0.0, 45.0), (20.0, 30.0), (10.0, 10.0), (45.0, 90.0), (0.0, 90.0)]


BOTH = [*((case, True) for case in CASES), *((case, False) for case in CASES[1:3])]


@pytest.mark.parametrize(("case", "curvature"), BOTH)
def test_every_step_is_the_same_to_round_off(case, curvature):
    """Forces are stiffness times gap: a round-off of a gap, 1e-16, times the largest stiffness over load, 1.6e6."""
    options = replace(OPTIONS, curvature=curvature)
    s = cauchy_line_load([case[0]], [case[1]])
    dynamics = st.Dynamics.of(EQUATIONS, options)
    kind = FOUR_IN_ONE.rings[:, 0]
    motion = st.begin(s, EQUATIONS, options)
    for _ in range(40):
        before = all_rings(motion, dynamics, options)
        rings, rise_ten = ten.advanced(before, s[0], FOUR_IN_ONE, EQUATIONS.wire, options)
        motion, h, rise = st.advanced(motion, EQUATIONS, options, dynamics)
        after = all_rings(motion, dynamics, options)
        assert rings.time == h[0]
        assert rings.centres == pytest.approx(after.centres, abs=1e-9)
        assert rings.normals == pytest.approx(motion.pose.normals[0][kind], abs=1e-9)
        assert rings.v == pytest.approx(after.v, abs=1e-8)
        assert pytest.approx(motion.R[0], rel=1e-8) == rings.R
        assert rise_ten / (options.load * options.r1_mm**2) == pytest.approx(rise[0], abs=1e-9)  # force times way


@pytest.mark.parametrize("case", CASES[1:4])
def test_both_forms_take_the_same_way(case):
    """Where minima merge the way is sensitive: round-off grows to 1e-8 before it dies out in the locked state."""
    s = cauchy_line_load([case[0]], [case[1]])[0]
    kind = FOUR_IN_ONE.rings[:, 0]
    times = []
    for motion, _, _, rings, _ in walk(s, OPTIONS, 40):
        x = rings.centres[:, :2] / OPTIONS.r1_mm
        assert rings.time == motion.time[0]
        lattice = np.array([x[1, 0] - x[0, 0], x[2, 1] - x[0, 1]])
        assert lattice == pytest.approx(motion.pose.lattice[0, :2], abs=1e-7)
        assert x[kind == 1][0] == pytest.approx(motion.pose.centres[0, 1], abs=1e-7)
        assert rings.normals == pytest.approx(motion.pose.normals[0][kind], abs=1e-7)
        assert rings.rejected == motion.rejected[0]
        times.append(rings.time)
    assert len(times) == 40
    assert times[-1] > 1.0


def test_bilateral_constraints_hold_all_the_way():
    s = cauchy_line_load([30.0], [50.0])[0]
    before = ten.start(FOUR_IN_ONE, OPTIONS)
    for _, _, _, rings, _ in walk(s, OPTIONS, 30):
        assert ten.bilateral(before, FOUR_IN_ONE) @ rings.v.ravel() == pytest.approx(0.0, abs=1e-9)
        before = rings
        a1, a2 = (rings.centres[i, :2] - rings.centres[0, :2] for i in (1, 2))
        assert a1[1] * a2[1] == pytest.approx(a1[0] * a2[0], abs=1e-10)
        base = np.where(FOUR_IN_ONE.rings[:, 0] == 0, 0, np.flatnonzero(FOUR_IN_ONE.rings[:, 0] == 1)[0])
        grid = rings.centres[base, :2] + FOUR_IN_ONE.rings[:, 1:] @ np.stack([a1, a2])
        assert rings.centres[:, :2] == pytest.approx(grid, abs=1e-10)
        assert rings.centres[:, 2] == pytest.approx(0.0, abs=1e-12)
        assert np.linalg.norm(rings.normals, axis=1) == pytest.approx(1.0, abs=1e-12)


def test_gyroscopic_torques_vanish_in_motion_but_not_for_a_spinning_ring():
    s = cauchy_line_load([30.0], [50.0])[0]
    *_, (_, _, _, rings, _) = walk(s, OPTIONS, 10)
    M = ten.mass_matrix(rings, 0.1, OPTIONS)
    assert np.abs(rings.v[:, 3:]).max() > 1e-3
    assert np.abs(ten.gyroscopic(rings, M)).max() < 1e-15
    spinning = replace(rings, v=rings.v + np.concatenate([0.0 * rings.normals, rings.normals], axis=1))
    assert np.abs(ten.gyroscopic(spinning, M)).max() > 1e-6


def test_corner_forces_are_in_balance_and_work_like_a_line_load():
    rings = ten.start(FOUR_IN_ONE, OPTIONS)
    s = np.array([2.0, 0.7, 1.1])
    f = ten.corner_forces(rings, FOUR_IN_ONE, s).reshape(-1, 6)
    assert f.sum(axis=0) == pytest.approx(0.0, abs=1e-12)
    torque = np.cross(rings.centres, f[:, :3])[:, 2].sum()
    assert torque == pytest.approx(0.0, abs=1e-9)
    # Virtual work of a stretch along x: s_xx times the area of the cell.
    x2, y3 = 5.0 * FOUR_IN_ONE.start_lattice[:2]
    assert f[:, 0] @ rings.centres[:, 0] == pytest.approx(2.0 * x2 * y3)


def test_kinetic_energy_agrees():
    s = cauchy_line_load([20.0], [30.0])[0]
    dynamics = st.Dynamics.of(EQUATIONS, OPTIONS)
    *_, (motion, _, _, rings, _) = walk(s, OPTIONS, 12)
    v = rings.v.ravel()
    energy = 0.5 * v @ ten.mass_matrix(rings, 0.1, OPTIONS) @ v
    scaled = st.kinetic_energy(motion.v, dynamics)[0] * OPTIONS.load * OPTIONS.r1_mm**2
    assert energy == pytest.approx(scaled, rel=1e-6)
