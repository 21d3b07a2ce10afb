"""Rings that flow until they are strings: length and work of a strip, force over way of a net, and where it breaks."""

import json
from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from homogenize import default_law, fit
from homogenize.laws import plastic_law
from macro_fem import read_scene, solve
from macro_fem.bounds import admissible_problem, bound, curtain_limit
from macro_fem.curtain import solve_problem
from macro_fem.judged import find_rupture, string_stress
from macro_fem.scene import build_mesh
from rve import Cell, InputError, named_material, solve_table, with_rings
from rve.common import digits
from rve.common.tensor import double_dot
from rve.locking import string_states
from tests.commands import run
from tests.test_macro_fem.sheets import posed, sheet
from tests.test_macro_fem.test_plastic import ALONG, capacity, pulled

LAW = default_law()

STRINGS = {"kind": "plastic", "strings": True}
ELASTIC = STRINGS | {"strings": "elastic"}
IN_Y = {"support": {"kind": "edge", "edge": "top", "held": "y"}}
"""Strings that are pulled lie side by side."""


def net(force, cells=4, steps=1, radius=100.0, **solver):
    """Tables of a net of 600 mm held along all of its edges, pushed across by a patch in its middle."""
    return {
        "curtain": {"width": 600.0, "height": 600.0},
        "mesh": {"cells": cells},
        "support": [{"kind": "edge", "edge": edge} for edge in ("left", "right", "top", "bottom")],
        "load": {
            "gravity": 0.0,
            "steps": steps,
            "patch": [{"at": [300.0, 300.0], "radius": radius, "force": [0.0, 0.0, force]}],
        },
        "solver": STRINGS | {"space": True} | solver,
    }


@pytest.mark.parametrize(
    "times",
    [
        pytest.param(0.99, marks=pytest.mark.release),
        pytest.param(1.01, marks=pytest.mark.slow),
        pytest.param(4.0, marks=pytest.mark.slow),
    ],
)
def test_a_strip_flows_until_it_is_as_long_as_its_strings(times):
    """Held along y only, as strings that are pulled lie side by side. Its load does not grow while it flows."""
    tables = pulled([0.0, -times * capacity()])
    tables |= {"support": {"kind": "edge", "edge": "top", "held": "y"}, "solver": STRINGS}
    found, law = solve(read_scene(tables), LAW), LAW
    way = 300.0 * (np.sqrt(1.0 + 2.0 * string_states(law.cell.cell(), ALONG, law.cell.sides_mm).h[0]) - 1.0)
    way *= times > 1.0
    assert found.status == "converged"
    assert -found.solution.x[:, 1].min() == pytest.approx(way, abs=1e-4)
    assert found.summary.plastic_work_N_mm == pytest.approx(capacity() * 200.0 * way, rel=1e-6, abs=1e-2)
    assert (string_stress(found.solution) > 1e-3) == (times > 1.0)
    assert (found.summary.limit_factor < 1.0) == (times > 1.0)


def stiff(times):
    """The default law of wire so many times as stiff; no material is so stiff, so that its record does not check."""
    law, material = LAW, LAW.strength.material
    material = copy(material)
    object.__setattr__(material, "young_N_per_mm2", times * material.young_N_per_mm2)
    return replace(law, strength=replace(law.strength, material=material))


def lengthened(line_load):
    """Stretch along the grain, and by N/mm beyond collapse, of rings in closed form: half of the wire of a ring."""
    cell, (b_x, b_y) = LAW.cell, LAW.cell.sides_mm
    area, young = np.pi * cell.r2_mm**2, LAW.strength.material.young_N_per_mm2
    tension = 0.5 * b_x * line_load
    ring = np.pi * cell.r1_mm * (1.0 + tension / (young * area)) - 2.0 * (np.pi - 1.0) * cell.r2_mm
    return 2.0 * ring / b_y, tension / area


@pytest.mark.parametrize("times", [4.0, pytest.param(40.0, marks=pytest.mark.slow)])
def test_strings_lengthen_as_their_wire_under_what_is_beyond_collapse(times):
    found = solve_problem(posed(pulled([0.0, -times * capacity()]) | IN_Y | {"solver": ELASTIC}))
    beyond = (times - 1.0) * capacity()
    (rigid, _), (stretch, tension) = lengthened(0.0), lengthened(beyond)
    assert found.status == "converged"
    assert -found.x[:, 1].min() == pytest.approx(300.0 * (stretch - 1.0), rel=1e-6)
    energy = capacity() * (stretch - 1.0) + 0.5 * beyond * (stretch - rigid)
    assert found.plastic_work == pytest.approx(200.0 * 300.0 * energy, rel=1e-5)
    assert string_stress(found) == pytest.approx(tension, rel=1e-5)


@pytest.mark.parametrize("height", [300.0, pytest.param(100.0, marks=pytest.mark.slow)])
def test_supports_draw_elastic_strings_longer_where_those_that_stretch_no_more_have_no_answer(height):
    """Of strips side by side whose strings are drawn as much longer each bears by its stiffness: 1 over its height."""
    beyond = 15000.0 / height
    stretch, _ = lengthened(beyond)
    sides = [{"kind": "edge", "edge": "top", "held": "y"}, {"kind": "edge", "edge": "bottom", "held": "y"}]
    sides[1]["move"] = [0.0, -height * (stretch - 1.0)]
    tables = sheet(200.0, height, 4, sides, load={"gravity": 0.0})
    rigid, found = (solve_problem(posed(tables | {"solver": solver})) for solver in (STRINGS, ELASTIC))
    assert rigid.status == "infeasible"
    assert found.status == "converged"
    assert found.reactions[:, 1].clip(0.0).sum() == pytest.approx(200.0 * (capacity() + beyond), rel=1e-5)


@pytest.mark.slow
def test_stiffer_strings_come_to_those_that_stretch_no_more():
    """The potential rises as much as they take up less."""
    tables = net(8000.0, 2)
    rigid = solve_problem(posed(tables))
    found = [solve_problem(posed(tables | {"solver": ELASTIC | {"space": True}}, stiff(t))) for t in (1.0, 1e2, 1e6)]
    below = np.array([(rigid.primal - one.primal) / abs(rigid.primal) for one in found])
    assert [one.status for one in found] == ["converged"] * 3
    assert below[0] > 1e-5
    assert below[:2] == pytest.approx(below[0] * np.array([1.0, 1e-2]), rel=0.02)
    assert abs(below[2]) < 1e-8
    assert found[2].plastic_work == pytest.approx(rigid.plastic_work, rel=1e-5)


@pytest.mark.slow
def test_the_energy_of_a_net_is_force_times_way_and_no_strain_is_beyond_its_strings():
    found, law, rng = solve(read_scene(net(8000.0, steps=10)), LAW), LAW, np.random.default_rng(5)
    steps = found.summary.steps
    force, way, work = (
        np.array([getattr(one, key) for one in steps]) for key in ("factor", "way_mm", "plastic_work_N_mm")
    )
    taken = np.concatenate([[0.0], np.cumsum(0.5 * 8000.0 * (force[1:] + force[:-1]) * np.diff(way))])
    assert work - work[0] == pytest.approx(taken, rel=0.01)  # the trapezoidal rule
    assert (np.diff(work) > 0.0).all()
    assert (np.diff(way) > 0.0).all()
    stress = [one.strings_stress_N_per_mm2 for one in steps]
    assert stress[0] < 1e-6
    assert stress[-1] > 10.0
    principal = rng.normal(size=(8, 2, 2))
    S = (principal @ principal.transpose(0, 2, 1)).reshape(8, 4)[:, [0, 1, 3]]
    S /= S[:, [0, 2]].sum(axis=1)[:, None]
    h = string_states(law.cell.cell(), S, law.cell.sides_mm).h
    assert (double_dot(S[:, None], found.solution.E[None]) - h[:, None]).max() < 0.01  # 0.004 between the rows


@pytest.mark.slow
@pytest.mark.parametrize(("cells", "strings"), [(4, True), (2, "elastic")])
def test_a_net_breaks_at_the_band_of_its_strings(cells, strings):
    summary = solve(read_scene(net(3000.0, cells, strings=strings)), LAW).summary
    first, last = summary.rupture_factor
    assert first < last
    assert np.diff(summary.way_at_rupture_mm)[0] > 0.0
    assert np.diff(summary.energy_until_rupture_N_mm)[0] > 0.0
    broken = solve(read_scene(net(3000.0 * first, cells, strings=strings)), LAW).summary
    assert broken.strings_stress_N_per_mm2 == pytest.approx(summary.rupture_stress_N_per_mm2[0], rel=0.05)
    assert broken.plastic_work_N_mm == pytest.approx(summary.energy_until_rupture_N_mm[0], rel=0.01)


@pytest.mark.slow
def test_the_limit_of_a_net_of_one_cell_that_is_pushed_across_is_found():
    """Its dual vectors begin without tails, and a step that left their cones was taken for one that never does."""
    limit = curtain_limit(posed(net(3500.0, 1)))
    assert limit.status == "converged"
    assert 1.0 < limit.lower <= limit.factor <= limit.upper < 4.0


@pytest.mark.parametrize(
    "solver", [pytest.param({}, marks=pytest.mark.slow), pytest.param({"bounds": True}, marks=pytest.mark.release)]
)
def test_factors_are_those_of_the_loads_alone_on_the_mesh_and_with_the_moves_of_the_answer(solver):
    """Of a net between two sides that are drawn apart, pushed across: strings in a plane share a load in other ways."""

    def pushed(force):
        tables = net(force, 2, **solver)
        left, right, *_ = tables["support"]
        return solve(read_scene(tables | {"support": [left, right | {"move": [60.0, 0.0, 0.0]}]}), LAW).summary

    summary = pushed(3000.0)
    broken = pushed(3000.0 * summary.rupture_factor[1])
    assert broken.strings_stress_N_per_mm2 == pytest.approx(summary.rupture_stress_N_per_mm2[1], rel=5e-3)
    assert broken.plastic_work_N_mm == pytest.approx(summary.energy_until_rupture_N_mm[1], rel=1e-5)
    last = broken.rupture_factor[1]
    assert last == pytest.approx(1.0, rel=5e-3)


@pytest.mark.slow
def test_supports_may_be_as_far_apart_as_strings_reach():
    longest = np.sqrt(1.0 + 2.0 * string_states(LAW.cell.cell(), np.eye(3)[:1], LAW.cell.sides_mm).h[0])
    tables = {
        "curtain": {"width": 200.0, "height": 200.0},
        "mesh": {"cells": 2},
        "support": {"kind": "corners", "gather": 0.97 * longest},
        "load": {"gravity": 0.0, "edge": [{"edge": "bottom", "force": [0.0, -3.0]}]},
        "solver": STRINGS,
    }
    assert solve(read_scene(tables), LAW).status == "converged"
    tables["support"]["gather"] = 1.02 * longest
    with pytest.raises(InputError, match=r"the supports are farther apart than the mesh can stretch: .* 2 % more"):
        solve(read_scene(tables), LAW)


@pytest.mark.release
def test_the_energy_under_a_push_grows_with_the_mesh_to_a_limit():
    """On 38 to 480 triangles, of which the finest stalled where forces were balanced long after the gap closed."""
    answers = [solve(read_scene(net(4000.0, cells, radius=200.0)), LAW) for cells in (3, 6, 12)]
    assert [one.status for one in answers] == ["converged"] * 3
    for values in ([one.summary.plastic_work_N_mm for one in answers], [-one.solution.primal for one in answers]):
        first, second = np.diff(values)
        assert first > 2.0 * second > 0.0
        assert second < 0.06 * values[-1]


def bounded(tables):
    scene = read_scene(tables)
    return bound(solve_problem(admissible_problem(scene, LAW, build_mesh(scene, LAW.cell))))


@pytest.mark.parametrize(("times", "solver"), [(1.01, STRINGS), (4.0, ELASTIC)])
def test_bounds_of_a_strip_of_strings_meet(times, solver):
    tables = pulled([0.0, -times * capacity()], cells=2)
    found = bounded(tables | IN_Y | {"solver": solver})
    assert found.status == found.solution.status == "converged"
    assert 0.0 <= found.gap < 1e-5 * found.solution.plastic_work


@pytest.mark.slow
def test_bounds_of_a_pushed_net_of_elastic_strings_hold_the_finer_ones():
    """Pressure is the same on every mesh. Where points are held its strings stretch without end, and have no bounds."""
    tables = net(0.0, strings="elastic")
    tables["load"] = {"gravity": 0.0, "wind": {"pressure": 2e5, "direction": [0.1, -0.6, -1.0]}}
    coarse, fine = (bounded(tables | {"mesh": {"cells": cells, "pattern": "diagonal"}}) for cells in (2, 4))
    assert {one.status for one in (coarse, fine, coarse.solution, fine.solution)} == {"converged"}
    assert string_stress(coarse.solution) > 10.0
    assert max(coarse.lower, fine.lower) < fine.upper <= coarse.upper
    assert fine.gap < 0.7 * coarse.gap
    assert coarse.error.min() > -1e-6 * coarse.gap
    assert coarse.error.sum() == pytest.approx(coarse.gap, rel=0.01)
    with pytest.raises(InputError, match="bounds do not go with points held or loaded one by one"):
        bounded(tables | {"support": {"kind": "corners"}})


@pytest.mark.slow
@pytest.mark.parametrize("support", [{"kind": "edge", "edge": "top"}, {"kind": "corners", "gather": 0.8}])
def test_bounds_of_a_net_that_is_blown_out_hold_the_finer_ones(support):
    """Under pressure, an even load that is the same on every mesh; forces at corners are spread along edges."""
    tables = net(0.0) | {"support": support, "curtain": {"width": 300.0, "height": 300.0}}
    tables["load"] = {"gravity": 0.0, "wind": {"pressure": 3e4, "direction": [0.1, -0.6, -1.0]}}
    coarse, fine = (bounded(tables | {"mesh": {"cells": cells}}) for cells in (2, 4))
    assert {one.status for one in (coarse, fine, coarse.solution, fine.solution)} == {"converged"}
    assert max(coarse.lower, fine.lower) < fine.upper <= coarse.upper
    assert fine.gap < 0.7 * coarse.gap
    assert coarse.error.min() > -1e-6 * coarse.gap
    assert coarse.error.sum() == pytest.approx(coarse.gap, rel=0.01)  # less the solvers' own gaps


@pytest.mark.slow
def test_the_least_energy_until_rupture_is_that_of_the_continuous_net():
    summary = solve(read_scene(net(3000.0, 2, bounds=True)), LAW).summary
    broken = solve(read_scene(net(3000.0 * summary.rupture_factor[0], 2, bounds=True)), LAW).summary
    assert broken.plastic_work_interval_N_mm[0] == pytest.approx(summary.energy_until_rupture_N_mm[0], rel=1e-4)
    assert broken.mesh_part_N_mm == pytest.approx(np.diff(broken.plastic_work_interval_N_mm)[0])


def test_meshes_adapt_to_the_work_of_strings():
    """The limit is that of the first mesh. A bar is no live load: nothing breaks."""
    tables = pulled([0.0, -1.0], cells=2) | {"support": {"kind": "top"}, "solver": STRINGS | {"adapt": 1}}
    found = solve(read_scene(tables | {"load": {"bar": {"mass": 200.0}}}), LAW)
    coarse, fine = found.summary.levels
    assert fine.cells > coarse.cells
    assert 0.0 < fine.gap_N_mm < coarse.gap_N_mm
    assert found.summary.limit_factor < 1.0
    assert found.limits[-1].problem.disc.n_cells == coarse.cells


@pytest.mark.parametrize("force", [1e-9, 1e-3])
def test_the_smallest_loads_are_borne_without_work(force):
    """Rounding of slack rings, counted as flow, was more work than that of such a load."""
    tables = net(force, 2, strings=False)
    tables["support"] = [tables["support"][0] | {"move": [10.0, 0.0, 0.0]}, tables["support"][1]]
    found = solve_problem(posed(tables, LAW))
    assert found.status == "converged"
    assert found.plastic_work == 0.0


@pytest.mark.slow
def test_strings_that_are_none_are_refused_or_said():
    law = LAW
    butted = replace(law, strength=replace(law.strength, joint="butted"))
    with pytest.raises(InputError, match="butted rings open before"):
        plastic_law(butted, strings=True)
    with pytest.raises(InputError, match="does not tell its weave"):
        plastic_law(replace(law, cell=replace(law.cell, weave=None)), strings=True)
    with pytest.raises(InputError, match="the law is not that of its cell"):
        plastic_law(replace(law, cell=replace(law.cell, b_x_mm=40.0)), strings=True)
    with pytest.raises(InputError, match=r"strings: has no effect without kind = 'plastic'"):
        solve(read_scene(net(1000.0, kind="rigid")), law)


@pytest.mark.slow
def test_the_command_says_where_strings_break(tmp_path):
    tables = net(3000.0, 2)
    scene = tmp_path / "net.toml"
    patch = tables["load"]["patch"][0]
    scene.write_text(
        "curtain = {width = 600.0, height = 600.0}\nmesh = {cells = 2}\n"
        + "".join(f'[[support]]\nkind = "edge"\nedge = "{one["edge"]}"\n' for one in tables["support"])
        + f"[load]\ngravity = 0.0\n[[load.patch]]\nat = {patch['at']}\nradius = 100.0\nforce = {patch['force']}\n"
        + '[solver]\nkind = "plastic"\nstrings = true\nspace = true\n'
    )
    done = run("macro_fem", "run", scene, "--out", tmp_path / "out", "--no-picture")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    low, high = (digits(1e-3 * one) for one in summary["energy_until_rupture_N_mm"])
    assert f"with {low} to {high} J taken up" in done.output
    assert "strings break at" in done.output


def test_without_live_loads_nothing_breaks():
    tables = net(0.0, 2)
    tables["load"] = {}
    tables["solver"] |= {"space": False}
    found = solve(read_scene(tables), LAW)
    assert find_rupture(found.solution) is None
    assert found.summary.rupture_factor is None
    assert "it takes live loads, and a [material] with ultimate" in found.summary.limit_note


@pytest.mark.release
def test_strings_of_six_in_one_are_drawn_taut_without_a_detour():
    """Where half-spaces that looked idle were dropped while forces were far from balance, one of these took 400 steps
    without an end and one 165."""
    cell = Cell(6.0, 0.5, weave="6-in-1", material=named_material("steel 1.4301"))
    law = fit(with_rings(solve_table(cell), cell)).law
    for place in ([180.0, 150.0], [320.0, 150.0], [250.0, 100.0]):
        tables = net(0.0, 6) | {"curtain": {"width": 500.0, "height": 300.0}}
        tables["support"] = tables["support"][:2]
        tables["load"] = {"gravity": [0.0, 0.0, -9.81]}
        for force in (6400.0, 7936.0, 9600.0, 16000.0):
            patch = {"at": place, "radius": 60.0, "force": [0.0, 0.0, -force]}
            found = solve_problem(posed(tables | {"load": tables["load"] | {"patch": [patch]}}, law))
            assert found.status == "converged", (place, force, found.message)
            assert found.iterations < 120, (place, force)
