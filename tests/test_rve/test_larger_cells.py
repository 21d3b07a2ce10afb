"""Larger cells with centres in space: exact derivatives, symmetries, and never less work than the planar cell."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from rve import WEAVES, Cell, DirectOptions, solve_table, support, with_rings
from rve.cli import main
from rve.common import WEIGHT, double_dot
from rve.directions import product
from rve.geometry import SIX_IN_ONE, moved, start_pose, strain_of, supercell, tiled, unlisted_gap, weave_sides
from rve.locking import DeadLoad, Equations, unit_loads
from rve.locking.dead_load import RESTART
from rve.locking.global_search import in_cell
from rve.locking.limits import balanced, loose_motions
from rve.solve import reference_sides

LOADS = np.array([[0.9, 0.05, 0.1], [0.6, 0.2, 0.4], [0.2, -0.1, 0.8]])
THIN = Cell(5.0, 0.25, SIX_IN_ONE)
SPACE = replace(THIN, cells=(2, 1), centres="space")


@pytest.fixture(scope="module")
def planar():
    return support(THIN, LOADS)


@pytest.fixture(scope="module")
def beyond():
    return support(SPACE, LOADS)


@pytest.mark.parametrize("name", WEAVES)
def test_gaps_and_residuals_in_space_have_exact_derivatives(name):
    weave = supercell(WEAVES[name], 2, 2, "space")
    count = 4 * WEAVES[name].classes
    assert weave.coordinates == 3 + 3 * (count - 1) + 2 * count
    equations = Equations.of(weave, 0.1, load=DeadLoad((2.2, 2.7)))
    rng = np.random.default_rng(0)
    pose = moved(start_pose(weave, 1), 0.02 * rng.uniform(-1.0, 1.0, (1, weave.coordinates)))
    contacts, S = equations.contacts(pose), np.array([[0.5, 0.1, 0.5]])
    assert np.ptp(pose.centres[0, :, 2]) > 0.01
    lam = np.where(contacts.present, 0.1, 0.0)
    system = equations.assemble(pose, contacts, lam, S)
    way, step = rng.uniform(-1.0, 1.0, (1, weave.coordinates)), 1e-6

    def at(t):
        there = moved(pose, t * way)
        found = equations.contacts(there)
        np.testing.assert_array_equal(found.present, contacts.present)
        return found.gap[found.present]

    slope = (at(step) - at(-step)) / (2.0 * step)
    np.testing.assert_allclose((system.G[0] @ way[0])[contacts.present.ravel()], slope, atol=1e-8)
    np.testing.assert_allclose(system.J[0], system.J[0].T, atol=1e-12)


@pytest.mark.slow
def test_planar_states_are_states_of_the_larger_cell_balanced_in_space(planar):
    mesh = SPACE.stages[-1]
    sides = weave_sides(mesh, reference_sides(THIN, DirectOptions()))
    pose = tiled(planar.states.pose, mesh.weave)
    np.testing.assert_allclose(strain_of(pose, sides), planar.E, atol=1e-14)
    equations = Equations.of(mesh.weave, THIN.wire, load=DeadLoad(sides))
    found = balanced(pose, unit_loads(planar.S), equations)
    assert found.contacts.links_intact.all()
    assert np.abs(found.contacts.min_gap).max() < 1e-10
    assert found.R.max() < 1e-8  # along z as well
    again = in_cell(replace(found, pose=planar.states.pose), unit_loads(planar.S), equations)
    np.testing.assert_array_equal(again.pose.centres, pose.centres)


def test_rings_that_leave_the_plane_do_more_work_and_never_less(planar, beyond):
    assert (beyond.status == "converged").all()
    assert beyond.R.max() < 1e-9
    assert beyond.min_gap_mm.min() > -1e-12
    assert (beyond.h >= planar.h - 1e-12).all()
    assert (beyond.h - planar.h).max() > 0.01
    depth = np.ptp(beyond.states.pose.centres[..., 2], axis=1)
    assert (depth[beyond.h - planar.h > 1e-6] > 1e-3).all()
    mesh = SPACE.stages[-1]
    assert unlisted_gap(beyond.states.pose, mesh.weave, mesh.wire).min() > 0.0
    assert beyond.row(0)["cells"] == [2, 1]
    assert beyond.row(0)["centres"] == "space"


@pytest.mark.slow
def test_the_weave_of_thick_wire_stays_in_the_plane_and_its_chains_share_their_load():
    cell, chain = Cell(5.0, 0.5), ([30.0], [0.0])
    larger = replace(cell, cells=(2, 2), centres="space")
    assert support(larger, LOADS[1:2]).h == pytest.approx(support(cell, LOADS[1:2]).h, abs=1e-9)
    one, side_by_side = (with_rings(solve_table(each, chain), each).strength for each in (cell, larger))
    assert side_by_side == pytest.approx(one, rel=1e-4)


def test_states_give_way_out_of_the_plane_where_wire_is_thin(planar):
    """Not at the load whose planar state is the largest."""
    mesh = SPACE.stages[-1]
    equations = Equations.of(mesh.weave, THIN.wire, load=DeadLoad(weave_sides(mesh, (planar.b_x_mm, planar.b_y_mm))))
    found = balanced(tiled(planar.states.pose, mesh.weave), unit_loads(planar.S), equations)
    for _, stiffness, motions in loose_motions(equations, found, unit_loads(planar.S)):
        across = motions[3:12, stiffness < RESTART.unstable].reshape(3, 3, -1)[:, 2]
        assert not across.size or np.abs(across).max() > 0.01


@pytest.mark.release
def test_a_table_of_a_larger_cell_is_normal_and_does_no_less_work():
    loads = product(np.array([-10.0, -5.0, 0.0, 45.0]), np.array([0.0, 5.0, 45.0]))
    flat, table = solve_table(THIN, loads), solve_table(SPACE, loads)
    assert flat.converged.all()
    assert table.converged.all()
    S = table.S / (table.S[:, :1] + table.S[:, 2:])
    work = double_dot(S, table.E)
    assert (work[:, None] - (S * WEIGHT) @ table.E.T).min() > -1e-9
    assert (work[:, None] - (S * WEIGHT) @ flat.E.T).min() > -1e-9
    assert table.origin.notes["branches"]["rows_beyond_the_primitive_cell"] > 0
    assert (table.origin.notes["cells"], table.origin.notes["centres"]) == ([2, 1], "space")
    assert flat.origin.notes["bound_note"]
    assert not table.origin.notes["bound_note"]


@pytest.mark.slow
def test_options_of_larger_cells(tmp_path):
    out = tmp_path / "table.csv"
    asked = ["table", "--out", str(out), "--weave", "6-in-1", "--r2", "0.25", "--alpha", "0", "--beta", "45"]
    done = CliRunner().invoke(main, asked)
    assert done.exit_code == 0
    assert "--cells 2x2 --centres space" in done.output
    done = CliRunner().invoke(main, [*asked, "--cells", "2x1", "--centres", "space"])
    assert done.exit_code == 0
    assert "--cells 2x2 --centres space" not in done.output
    record = json.loads(out.with_suffix(".json").read_text())
    assert (record["weave"], record["cells"], record["centres"]) == ("6-in-1", [2, 1], "space")
