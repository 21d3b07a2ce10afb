"""A sheet between two parallel rails closer than its locked length hangs as a catenary of that length.

Loads uniform per reference area, weight and dead wind together, act along their resultant: the catenary hangs in the
plane across the rails, downwards along the resultant. Potentials converge with the square of the mesh size.
"""

import numpy as np
import pytest
from scipy.optimize import brentq

from homogenize import ClothLaw, default_law
from macro_fem import load_scene, read_scene, solve
from tests.commands import run
from tests.test_macro_fem.clarabel_oracle import curtain_by_clarabel
from tests.test_macro_fem.sheets import sheet, solve_scene

RINGS = default_law()
LENGTH, WIDTH, GRAVITY, MASS = 1000.0, 250.0, 9.81, 2.0
CASES = {
    "y-level": ("y", [0.0, 1000.0, 600.0], 0.0),
    "y-slanted": ("y", [0.0, 800.0, 600.0], 0.0),
    "x-level": ("x", [0.0, 1000.0, 1000.0], 0.0),
    "x-slanted": ("x", [0.0, 700.0, 1000.0], 0.0),
    "y-wind": ("y", [0.0, 900.0, 700.0], 10.0),
    "x-wind": ("x", [0.0, 1100.0, 1200.0], -12.0),
    "cloth": ("cloth", [0.0, 950.0, 700.0], 10.0),
}


class Catenary:
    """A rope of a length between two points, the second at `span` and `rise` from the first, under a unit load."""

    def __init__(self, length, span, rise):
        straight = np.sqrt(length**2 - rise**2)
        self.a = brentq(lambda a: 2.0 * a * np.sinh(0.5 * span / a) - straight, span / 40.0, 1e4 * span, xtol=1e-12)
        lowest = 0.5 * span - self.a * np.arctanh(rise / length)
        x = np.linspace(-lowest, span - lowest, 2)
        u, v = x / self.a
        first = self.a * np.cosh(u)
        # integral of y ds = a^2 integral of cosh^2
        integral = self.a**2 * (0.5 * (v - u) + 0.25 * (np.sinh(2.0 * v) - np.sinh(2.0 * u)))
        self.mean = integral / length - first
        steepest = np.arcsinh(rise / span)  # where it is parallel to the chord, farthest below it
        self.sag = rise / span * (lowest + self.a * steepest) - (self.a * np.cosh(steepest) - first)
        self.low = (self.a if u < 0.0 < v else min(first, self.a * np.cosh(v))) - first


def law_of(name):
    """The law of a case, the angle of its weave, and its locked stretch along y. Sideways it may shrink."""
    if name == "cloth":
        return ClothLaw(), "y", 1.0
    load = np.array([[1.0, 0.0, 0.0]]) if name == "x" else np.array([[0.0, 0.0, 1.0]])
    return RINGS, name, float(np.sqrt(1.0 + 2.0 * RINGS.support(load)[0]))


def hammock(name, cells, width=WIDTH, pattern="diagonal", **solver):
    """The sheet of a case. Rails hold it at its reference width; with the weave along x it slides on them.

    Cloth is gathered: at its full width it would be taut along the rails.
    """
    weave, move, wind = CASES[name]
    law, angle, _ = law_of(weave)
    rail = {"kind": "edge", "held": "yz" if weave == "x" else "both", "gather": 0.9 if weave == "cloth" else 1.0}
    held = [rail | {"edge": "top"}, rail | {"edge": "bottom", "move": move}]
    load = {"gravity": GRAVITY, "wind": {"pressure": wind, "direction": [0.0, 0.0, 1.0]}}
    more = {"weave_angle": angle, "areal_mass": MASS}
    return solve_scene(read_scene(sheet(width, LENGTH, cells, held, {"pattern": pattern}, load, solver, **more)), law)


def exact(name):
    """Unit vectors across and against the resultant in (y, z), load per area in N/mm2, and the catenary."""
    weave, move, wind = CASES[name]
    _, _, stretch = law_of(weave)
    load = 1e-6 * np.array([-MASS * GRAVITY, wind])
    up = -load / np.linalg.norm(load)
    chord = np.array([move[1] - LENGTH, move[2]])
    across = np.array([up[1], -up[0]])
    across *= np.sign(across @ chord)
    return across, up, float(np.linalg.norm(load)), Catenary(stretch * LENGTH, across @ chord, up @ chord)


def errors(name, found):
    """Errors of the mean and the least height along the resultant over the sag, and relative of the pull across."""
    across, up, load, rope = exact(name)
    x, force = found.x[:, 1:] - [LENGTH, 0.0], found.problem.force[:, 1:]
    mean = float((force * x).sum() / (force @ up).sum())
    top = np.isclose(found.problem.disc.nodes[:, 1], LENGTH)
    pull = -float(found.reactions[top, 1:].sum(axis=0) @ across)
    width, (_, _, stretch) = float(np.ptp(found.problem.disc.nodes[:, 0])), law_of(CASES[name][0])
    return np.array([(mean - rope.mean) / rope.sag, ((x @ up).min() - rope.low) / rope.sag]), pull / (
        load * width * rope.a / stretch
    ) - 1.0


QUICK = [(name, (4, 8)) for name in ("x-slanted", "y-wind")]
ALL = [pytest.param(name, (2, 4, 8, 16), marks=pytest.mark.release) for name in CASES]
ALL += [pytest.param(name, (2, 4, 8), marks=pytest.mark.slow) for name in list(CASES)[::2]]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "meshes"), [*QUICK, *ALL])
def test_a_hammock_is_a_catenary(name, meshes):
    """Eight cells of a quarter's width are 32 along the length; the order of the mean height is 2.00."""
    found = [hammock(name, cells) for cells in meshes]
    assert [one.status for one in found] == ["converged"] * len(meshes)
    mean = np.abs([errors(name, one)[0][0] for one in found])
    order = np.log2(mean[:-1] / mean[1:])
    assert order.min() > 1.9
    both, pull = errors(name, found[-1])
    assert np.abs(both).max() < 1e-3
    assert abs(pull) < 5e-3


NET = f"""
curtain = {{width = {WIDTH}, height = {LENGTH}, weave_angle = "y", areal_mass = {MASS}}}
mesh = {{cells = 8, pattern = "diagonal"}}
support = [{{kind = "top"}}, {{kind = "edge", edge = "bottom", move = [0.0, 400.0, 0.0]}}]
load = {{gravity = [0.0, 0.0, {-GRAVITY}]}}
"""


@pytest.mark.slow
def test_a_net_across_its_weight_tells_its_sag(tmp_path):
    """A catenary below two level rails in the plane of the flat sheet; heights say nothing, so the sag is told."""
    (tmp_path / "net.toml").write_text(NET)
    answer = solve(load_scene(tmp_path / "net.toml"))
    rope, told = Catenary(law_of("y")[2] * LENGTH, LENGTH - 400.0, 0.0), answer.summary
    assert told.mean_sag_mm == pytest.approx(-rope.mean, rel=1e-3)
    assert told.largest_sag_mm == pytest.approx(-rope.low, rel=1e-3)
    assert told.largest_sag_mm == pytest.approx(-answer.loaded.x[:, 2].min(), rel=1e-12)
    said = f"mean sag {told.mean_sag_mm:.3f} mm, largest {told.largest_sag_mm:.3f} mm, largest line load"
    text = run("macro_fem", "run", tmp_path / "net.toml", "--out", tmp_path / "out", "--no-picture").output
    assert said in text
    words = ["compare-designs", tmp_path / "net.toml", "--out", tmp_path / "all", "--no-picture"]
    text += (compared := run("macro_fem", *words).output)
    assert f"mean sag {told.mean_sag_mm:.4g} mm" in compared
    assert "lowest point" not in text
    assert "mean height" not in text
    assert hammock("cloth", 2).sag() is None


def test_clarabel_and_our_solver_agree_for_cloth():
    ours = hammock("cloth", 2)
    theirs = curtain_by_clarabel(ours.problem)
    assert ours.status == theirs.status == "converged"
    unit = np.abs(ours.problem.force).sum() * ours.problem.mesh.size
    assert abs(ours.primal - theirs.primal) < 1e-7 * unit
