"""Problems with answers from elsewhere: the gathered net."""

import pytest

from homogenize import diagonal_net
from macro_fem import read_scene
from tests.test_macro_fem.sheets import sheet, solve_scene


def gathered_net_height(element, n):
    """Mean height of the inextensible net, 40 x 40 mm gathered to 70 %: two stiffnesses, extrapolated to rigid."""
    mesh, solver = {"element": element, "pattern": "diagonal"}, {"kind": "elastic", "stabilising_tension": 0.0}
    scene = read_scene(sheet(40.0, 40.0, n, {"kind": "top", "gather": 0.7}, mesh, (), solver, areal_mass=100.0))
    solutions = [solve_scene(scene, diagonal_net(1.0, stiffness)) for stiffness in (1e3, 1e4)]
    assert [one.status for one in solutions] == ["converged"] * 2
    soft, stiff = (one.mean_height() for one in solutions)
    return stiff + (stiff - soft) / 9.0


@pytest.mark.slow
def test_the_gathered_net_is_that_of_another_author_and_comes_down_to_the_exact_height():
    """Their cone programs give the integral of the height over 1600 mm2, to its printed digit."""
    one, other, coarse, fine = (gathered_net_height(*mesh) for mesh in (("P1", 8), ("P1", 16), ("P2", 4), ("P2", 8)))
    theirs = [23664.7, 23453.0, 23005.0]
    assert [1600.0 * height for height in (one, other, coarse)] == pytest.approx(theirs, abs=0.06)
    assert one > other > fine > 14.187635
    assert coarse > fine
