"""Problems with answers from elsewhere: the gathered net."""

import pytest

from homogenize import diagonal_net
from macro_fem import read_scene
from macro_fem.curtain import solve_scene
from tests.test_macro_fem.sheets import sheet


def gathered_net_height(element, n):
    """Mean height of the inextensible net, 40 x 40 mm gathered to 70 %: two stiffnesses, extrapolated to rigid."""
    mesh, solver = {"element": element, "pattern": "diagonal"}, {"kind": "elastic", "stabilising_tension": 0.0}
    scene = read_scene(sheet(40.0, 40.0, n, {"kind": "top", "gather": 0.7}, mesh, (), solver, areal_mass=100.0))
    solutions = [solve_scene(scene, diagonal_net(1.0, stiffness)) for stiffness in (1e3, 1e4)]
    assert [one.status for one in solutions] == ["converged"] * 2
    soft, stiff = (one.mean_height() for one in solutions)
    return stiff + (stiff - soft) / 9.0


@pytest.mark.parametrize(
    ("element", "n", "mean_potential"), [("P1", 8, 23664.7), ("P1", 16, 23453.0), ("P2", 4, 23005.0)]
)
def test_gathered_net_on_every_element(element, n, mean_potential):
    """The cone programs of another author, as the integral of the height over 1600 mm2, to their printed digit."""
    assert 1600.0 * gathered_net_height(element, n) == pytest.approx(mean_potential, abs=0.06)


def test_gathered_net_comes_down_to_the_exact_height():
    exact = 14.187635
    above = [gathered_net_height(e, n) - exact for e, n in (("P1", 8), ("P1", 16), ("P2", 4), ("P2", 8))]
    assert above[0] > above[1] > above[3] > 0.0
    assert above[2] > above[3]
