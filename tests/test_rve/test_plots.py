"""The locked cell in space: its forces are those of the load, and its way ends where the solver locks."""

import numpy as np
import pytest
from click.testing import CliRunner

from rve.cli import main
from rve.common.drawing.space import parts
from rve.common.errors import NotConverged
from rve.geometry.cell import Cell
from rve.geometry.kinematics import cauchy_line_load
from rve.plots import FRAMES, corner_forces, draw_case, draw_cell_in_space, locking_motion
from rve.solve import solve_table
from tests.films import film_of


@pytest.fixture(scope="module", params=["y", "x"])
def table(request):
    return solve_table(Cell(4.0, 0.4, grain=request.param), ([20.0], [30.0]))


def test_forces_on_the_corners_are_the_line_load(table):
    """Sum of x f / area is the Cauchy line load, of size 1 N/mm, in the axes x, y of the mesh."""
    at, force = corner_forces(table.states)
    force = 4.0 * force
    sides = at[1, :2], at[2, :2]
    area = abs(np.linalg.det(np.array(sides)))
    s = np.einsum("ni,nj->ij", at, force)[:2, :2] / area
    wanted = cauchy_line_load(np.array([20.0]), np.array([30.0]))[0]
    wanted = wanted / np.sqrt(wanted @ [wanted[0], 2.0 * wanted[1], wanted[2]])
    np.testing.assert_allclose([s[0, 0], s[0, 1], s[1, 0], s[1, 1]], wanted[[0, 1, 1, 2]], atol=1e-9)
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-12)


def test_the_way_goes_from_the_slack_to_the_locked_pose(table):
    motion = locking_motion(table)
    assert 10 <= len(motion) <= FRAMES
    ends = motion[0][0], motion[-1][0]
    sides = [parts(draw_cell_in_space(states))["periodic cell"][0].points for states in ends]
    weave = table.states.cell.weave
    first, last = (np.sort(np.linalg.norm(np.diff(s, axis=0), axis=1)[:2]) for s in (sides[0], sides[-1]))
    slack = np.sort([4.0 * weave.start_lattice[0], 4.0 * weave.start_lattice[1]])
    np.testing.assert_allclose(first, slack, rtol=1e-6)  # pyvista draws in single precision
    locked = np.sort([np.linalg.norm(table.x2_mm[0]), np.linalg.norm(table.x3_mm[0])])
    np.testing.assert_allclose(last, locked, rtol=2e-3)  # contacts of the scheme give way
    assert motion[0][1] == 0


def test_a_cell_that_does_not_lock_has_no_views():
    table = solve_table(Cell(), ([0.0], [100.0]))
    for make in (draw_case, locking_motion):
        with pytest.raises(NotConverged, match="compressive"):
            make(table)


def test_case_writes_a_page(tmp_path):
    done = CliRunner().invoke(main, ["case", "--alpha", "0", "--beta", "45", "--html", str(tmp_path / "cell.html")])
    assert done.exit_code == 0, done.output
    assert [file.name for file in tmp_path.iterdir()] == ["cell.html"]
    assert "force between rings" in (tmp_path / "cell.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_case_writes_an_animation(tmp_path):
    words = ["case", "--alpha", "0", "--beta", "45", "--animation", str(tmp_path / "cell.gif")]
    assert CliRunner().invoke(main, words).exit_code == 0
    frames, changed = film_of(tmp_path / "cell.gif")
    assert 10 <= frames <= FRAMES
    assert changed > 0.02
