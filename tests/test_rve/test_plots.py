"""The picture of a locked cell: its forces are those of the load."""

import numpy as np
import pytest
from click.testing import CliRunner

from rve import Cell, solve_table
from rve.cli import main
from rve.geometry import cauchy_line_load
from rve.plots import corner_forces


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


def test_a_cell_that_does_not_lock_has_no_picture(tmp_path):
    words = ["case", "--alpha", "0", "--beta", "100", "--plot", str(tmp_path / "cell.png")]
    failed = CliRunner().invoke(main, words)
    assert (failed.exit_code, "compressive" in failed.output, [*tmp_path.iterdir()]) == (1, True, [])
