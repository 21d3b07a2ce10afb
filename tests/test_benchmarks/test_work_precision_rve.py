"""The rings of the report: one problem for all methods, a reference that two agree on, ladders that fall."""

from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest

from benchmarks.work_precision import peers
from benchmarks.work_precision.generic import SOLVERS, Programme
from benchmarks.work_precision.rve import (
    ERROR,
    PUBLISHED,
    absent,
    cells,
    curves_of,
    direct,
    direct_alone,
    extrapolated,
    generic,
    problem,
    run_table,
    runs,
    scheme,
)
from rve.geometry.kinematics import second_pk
from rve.geometry.pose import deformation

LOADS = ((0.0, 45.0), (20.0, 30.0))


@pytest.fixture(scope="module")
def given():
    return problem(LOADS)


def programme(given, case):
    F = deformation(given.found.pose, given.sides)
    S = second_pk(F, given.s) * given.sides[0] * given.sides[1]
    return Programme(S[case], given.equations, given.sides)


def test_the_reference_is_agreed_by_the_scheme(given):
    """The scheme extrapolated to rigid contact shares only the contact search with the direct solver."""
    assert (given.found.status == "converged").all()
    soft, stiff = runs(given, "", "steps", extrapolated, {"soft": 1e4, "stiff": 1e5})
    assert soft["solved"] == stiff["solved"] == f"{len(LOADS)} of {len(LOADS)}"
    assert stiff[ERROR] < 5e-9
    assert stiff[ERROR] < 0.05 * soft[ERROR]  # second order in 1/k


def test_ladders_of_the_direct_solver_fall_to_round_off(given):
    for solve, mus in ((direct, (1e-4, 1e-7, 1e-10, 1e-13)), (direct_alone, (1e-4, 1e-7))):
        ladder = runs(given, "", "iterations", solve, {str(mu): mu for mu in mus})
        errors = [run[ERROR] for run in ladder]
        assert {run["solved"] for run in ladder} == {f"{len(LOADS)} of {len(LOADS)}"}
        assert all(fine < 0.01 * coarse for coarse, fine in pairwise(errors))
        assert errors[-1] < 1e3 * mus[-1]


def test_the_scheme_errs_like_its_compliance(given):
    options = {f"{k:g}": replace(PUBLISHED, stiffness=k) for k in (1e4, 1e5)}
    soft, stiff = runs(given, "", "steps", scheme, options)
    assert soft[ERROR] / stiff[ERROR] == pytest.approx(10.0, rel=0.02)


@pytest.mark.parametrize("case", range(len(LOADS)))
def test_the_programme_is_the_same_cell_and_load(given, case):
    """In its chart: the answer's strain, gaps that are closed or open, derivatives, and a loss that nothing beats."""
    other = programme(given, case)
    q = other.coordinates(given.found.pose, case)
    np.testing.assert_allclose(other.strain(q)[0], given.E[case], atol=1e-12)
    gap, slope = other.gaps(q)
    assert abs(gap.min()) < 1e-10
    assert (gap < 1e-8).sum() >= 4
    step = 1e-6 * np.random.default_rng(case).normal(size=9)
    smooth = gap < 0.5  # far pairs may have no isolated minimum
    ahead, behind = other.gaps(q + step)[0], other.gaps(q - step)[0]
    np.testing.assert_allclose((ahead - behind)[smooth], 2.0 * (slope @ step)[smooth], atol=2e-10)
    assert other.loss(q + step) - other.loss(q - step) == pytest.approx(2.0 * other.slope(q) @ step, abs=1e-11)
    found = SOLVERS["SLSQP"](other, q + 1e-3, 1e-14)
    assert other.loss(found) == pytest.approx(other.loss(q), abs=1e-7)


def test_generic_runs_count_only_what_is_right(given):
    (run,) = runs(given, "", "calls", partial(generic, name="SLSQP", start="near"), {"": 1e-12})
    assert run["solved"].endswith(f" of {len(LOADS)}")
    assert run["_share"] < 1.0 or run[ERROR] < 0.1
    assert run["work per case"] > 0


def test_failures_do_not_count():
    errors, good = np.array([1e-3, 5.0, 1e-4]), np.array([True, True, False])
    run = cells(errors, good, 3.0, 9, "steps")
    assert (run["solved"], run[ERROR], run["ms per case"], run["work per case"]) == ("1 of 3", 1e-3, 1e3, 3.0)
    assert np.isnan(cells(errors, ~good & False, 1.0, 1, "steps")[ERROR])


def test_mujoco_nears_the_same_state(given):
    """The more capsules, the nearer; the start is our slack pose, before any load. It is an optional peer."""
    if not peers.has_mujoco():
        with pytest.raises(ImportError):
            peers.run_mujoco(given.cell, (1.0, 1.0), peers.MujocoOptions(24, 100))
        return
    reference = given.found.pose.lattice[0, :2] * given.cell.r1
    off = []
    for capsules in (24, 96):
        answer = peers.run_mujoco(given.cell, (0.5**0.5, 0.5**0.5), peers.MujocoOptions(capsules, 10_000, dt=0.02))
        off.append(np.abs(np.array([answer.x2_mm, answer.y3_mm]) - reference).max())
    assert off[1] < 0.25 * off[0]
    assert off[1] < 0.1
    still = peers.run_mujoco(given.cell, (0.0, 0.0), peers.MujocoOptions(24, 100))
    start = given.cell.r1 * given.cell.weave.start_lattice[:2]
    np.testing.assert_allclose([still.x2_mm, still.y3_mm], start, atol=1e-9)


def test_mujoco_keeps_the_lattice(given):
    """Rings of one class keep their places in the lattice and one tilt, but for ties that give while they speed up."""
    if not peers.has_mujoco():
        return
    import mujoco

    model = mujoco.MjModel.from_xml_string(peers.mujoco_xml(given.cell, peers.MujocoOptions(24)))
    data = mujoco.MjData(model)
    data.qfrc_applied[[model.joint(name).dofadr[0] for name in "XY"]] = 3.0, 2.0
    mujoco.mj_step(model, data, 200)
    moved = np.array([data.joint(name).qpos[0] for name in "XY"])
    assert np.abs(moved).min() > 0.15
    side = given.cell.r1 * given.cell.weave.start_lattice[:2] + moved
    for kind, i, j in given.cell.weave.rings.tolist():
        ring, first = data.body(f"ring{kind}{i}{j}"), data.body(f"ring{kind}00")
        place = [i * side[0], j * side[1], 0.0]
        np.testing.assert_allclose(ring.xpos - first.xpos, place, atol=0.02)
        np.testing.assert_allclose(ring.xmat, first.xmat, atol=0.01)


def test_absent_peers_are_named():
    (row,) = run_table("Runs", absent("MuJoCo", "pip install mujoco")).rows
    assert row[:4] == ("MuJoCo", "not installed (`pip install mujoco`)", "-", "-")


def test_the_diagram_names_failures_and_leaves_out_who_solves_nothing():
    bad, good = np.array([1e-3, 5.0]), np.array([1e-3, 1e-4])
    errors = {"half": (bad, bad < 9.0), "all": (good, good < 1.0), "none": (bad, bad > 9.0)}
    half, whole = curves_of([{"method": name} | cells(*two, 2.0, 1, "steps") for name, two in errors.items()])
    assert (half.label, half.x, half.y) == ("half (1 of 2)", (1e-3,), (1.0,))
    assert (whole.label, whole.x) == ("all", (1e-3,))
