"""Does the curtain hold: utilisation in closed form, units, rotation, hooks, and laws that do not know."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from homogenize import default_law, fit, ring_net, with_material
from macro_fem import largest_that_holds, read_scene, solve
from macro_fem.judged import EXTRAPOLATED, FINE, TOO_COARSE, critical_load, judge_strength, nearest, utilisation
from macro_fem.output import combination_lines, curtain_mesh, holds_line, summarize
from macro_fem.scene import read_mesh_file
from rve import Cell, InputError, named_material, pulled_ring, read_table, solve_table, with_rings
from rve.common import write_mesh_file
from tests.test_macro_fem.sheets import sheet, solve_scene

TABLE = Path(__file__).parents[1] / "test_homogenize" / "data" / "table190.csv"
MASS, GRAVITY, WIDTH = 2.0, 9.81, 100.0


def hung(law=None, weave="y", mass=MASS, **support):
    """A weightless strip with a bar of `mass` below, free to narrow: every cell bears the same load, upright.

    Locked columns may share the load in many ways; without stabilising tension the solver's central one is even.
    """
    more = {"load": {"bar": {"mass": mass}}, "solver": {"stabilising_tension": 0.0}, "areal_mass": 0.0}
    tables = sheet(WIDTH, 150.0, 4, {"kind": "rail"} | support, weave_angle=weave, **more)
    return solve_scene(read_scene(tables), law or default_law())


def with_yield(stress):
    """The shipped law, its wire of another yield stress, N/mm2."""
    law = default_law()
    material = replace(law.strength.material, yield_N_per_mm2=stress, ultimate_N_per_mm2=None)
    return replace(law, strength=replace(law.strength, material=material))


def test_a_curtain_without_load_has_no_factor():
    hooks = {"kind": "hooks", "pitch": 30.0, "capacity": 9.0, "gather": 0.9}
    solution = solve_scene(read_scene(sheet(60.0, 60.0, 4, hooks, load={"gravity": 0.0})), default_law())
    told = summarize(solution)
    assert told.utilisation_max < 1e-9
    assert {told[key] for key in ("safety_factor", "collapse_factor", "weakest_factor", "first_yield_near")} == {None}
    assert holds_line(told) == "no load"


@pytest.fixture(scope="module")
def strip():
    return hung()


@pytest.mark.parametrize(("weave", "beta"), [("y", 90.0), ("x", 0.0)])
def test_a_strip_yields_at_the_line_load_of_its_table_row(weave, beta):
    """S along the strip is the weight below per reference width over the stretch at which the rings lock."""
    table = read_table(TABLE)
    row = int(np.flatnonzero((table.alpha_deg == 0.0) & (table.beta_deg == beta))[0])
    stretch = np.sqrt(1.0 + 2.0 * table.E[row, 2 if beta else 0])
    S = MASS * GRAVITY / WIDTH / stretch
    solution = hung(weave=weave)
    told = judge_strength(solution)
    assert solution.status == "converged"
    assert told.utilisation_max == pytest.approx(S * table.strength[row, 0] / 235.0, rel=1e-5)
    assert told.collapse_factor == pytest.approx(235.0 / (S * table.strength[row, 1]), rel=1e-5)
    assert told.safety_factor == pytest.approx(1.0 / told.utilisation_max, rel=1e-12)
    assert told.utilisation_pointwise_max == pytest.approx(told.utilisation_max, rel=1e-5)
    assert told.first_yield_near in ("support 1 (rail)", "load.bar 1 (bottom)")
    assert told.utilisation_too_low is None  # an even load is its own average on any mesh


@pytest.mark.parametrize("least", [0.3, 0.0])
def test_rings_judged_by_loads_unlike_theirs_are_told(least):
    """The strip is pulled along y; of two tables one has no load so uneven, one none along it."""
    law = default_law()
    s11, _, s22 = law.strength.S.T
    kept = np.minimum(s11, s22) > least if least else s11 > 0.3
    solution = hung(replace(law, strength=law.strength.take(kept)))
    told = summarize(solution)
    assert told.utilisation_too_low == EXTRAPOLATED.format(len(solution.S), len(solution.S))
    assert "factor of at most" in holds_line(told)


MESH_ALONE = {"kind": "corners", "rings_per_hook": 1000}
"""Corners whose rings bear any force."""


def corner_hung(side, cells):
    return solve_scene(read_scene(sheet(side, side, cells, MESH_ALONE)), default_law())


@pytest.mark.slow
def test_the_average_over_a_cell_converges_at_a_hook_where_the_pointwise_value_grows():
    coarse, fine = (judge_strength(corner_hung(40.0, cells)) for cells in (6, 12))
    assert fine.utilisation_pointwise_max > 1.5 * coarse.utilisation_pointwise_max
    assert fine.utilisation_of_averages_max == pytest.approx(coarse.utilisation_of_averages_max, rel=0.25)
    assert fine.utilisation_max < 0.7 * fine.utilisation_pointwise_max
    assert fine.first_yield_near == "support 1 (corners)"
    assert "grows with every refinement" in fine.strength_note


@pytest.mark.slow
def test_a_coarse_mesh_tells_the_utilisation_of_a_fine_one_from_the_force_at_the_corners():
    """Averages of the coarse mesh are low in proportion to its cells; the force over the width of an average is not."""
    coarse, fine = corner_hung(60.0, 4), corner_hung(60.0, 24)
    low, high = summarize(coarse), summarize(fine)
    assert low.utilisation_of_averages_max < 0.7 * high.utilisation_of_averages_max
    assert high.utilisation_of_point_forces_max == 0.0  # its cells resolve the average
    assert low.utilisation_max == low.utilisation_of_point_forces_max
    assert low.utilisation_max == pytest.approx(high.utilisation_max, rel=0.2)
    assert low.utilisation_max_at_mm in ([0.0, 60.0], [60.0, 60.0])
    assert [one.utilisation_too_low for one in (low, high)] == [None, None]
    S = critical_load(coarse)
    assert default_law().strength.utilisation(S[None])[0] == pytest.approx(low.utilisation_max, rel=1e-9)
    assert "the factor is that of the force at this point" in holds_line(low)
    assert "force at this point" not in holds_line(high)


def test_a_force_on_one_column_of_rings_is_that_force_over_the_width_of_a_disk():
    """A point that is pulled straight down far from all edges: the disk of 139 mm2 is as wide as its area over its
    diameter, and S is the force over this width and over the stretch at which rings lock along the columns."""
    load = {"point": {"at": [120.0, 120.0], "force": [0.0, -50.0], "rings_per_hook": 1000}}
    tables, law = sheet(240.0, 240.0, 6, {"kind": "top"}, load=load, areal_mass=0.0), default_law()
    told = judge_strength(solve_scene(read_scene(tables), law))
    area = law.cell.b_x_mm * law.cell.b_y_mm
    up = np.array([[0.0, 0.0, 1.0]])
    S = 50.0 / (0.5 * np.sqrt(np.pi * area)) / np.sqrt(1.0 + 2.0 * law.support(up)[0])
    assert told.utilisation_max == pytest.approx(law.strength.utilisation(S * up)[0], rel=0.05)  # pieces of cells
    assert told.first_yield_near == "load.point 1"


@pytest.mark.slow
def test_a_mesh_too_coarse_at_an_end_of_a_held_edge_is_told():
    """No single force tells there; the factor is then an upper bound and called so, of combinations and sizes too."""
    tables = sheet(300.0, 300.0, 4, {"kind": "top"}, load={"bar": {"mass": 0.5}}, weave_angle=30.0)
    scene = read_scene(tables | {"combination": {"name": "more", "bar": 1.5}})
    told = solve(scene).summary
    too_coarse = TOO_COARSE.format("support 1 (top)", "37.5", "2.95", ", as with cells = 51")
    assert (told.utilisation_of_point_forces_max, told.utilisation_too_low) == (0.0, too_coarse)
    assert holds_line(told).endswith(too_coarse)
    assert all("factor of at most " in line for line in (holds_line(told), *combination_lines(told)))
    assert largest_that_holds(replace(scene, combination=()), None, "mass", (0.4, 0.5), 9.0).note == too_coarse


NOTCHED = {"shape": "outline", "outline": [[0, 0], [66, 0], [66, 22], [55, 28], [66, 34], [66, 55], [0, 55]]}
HOLED = {"width": 66.0, "height": 55.0, "holes": [[[22, 16], [40, 16], [40, 34], [22, 34]]]}


@pytest.mark.parametrize(
    ("curtain", "near"),
    [
        pytest.param(NOTCHED, "edge ", marks=pytest.mark.slow),
        pytest.param(HOLED, "hole 1", marks=pytest.mark.release),
    ],
)
def test_a_mesh_too_coarse_at_a_notch_or_hole_says_which_one_tells_within_a_tenth(curtain, near):
    """The sentence names the place and `cells`; on those it is gone, and the utilisation is that of a mesh 1.4 times as
    fine; with half of them it stands, as on the coarse mesh, whose utilisation is too low."""

    def told(cells):
        tables = {"curtain": curtain, "mesh": {"cells": cells}, "support": {"kind": "top"}}
        return solve(read_scene(tables | {"load": {"bar": {"mass": 9.0}}})).summary

    def advice(summary):
        words, cells = summary.utilisation_too_low.split(", as with cells = ")
        assert words.startswith(f"the mesh is too coarse at {near}")
        return int(cells)

    coarse = told(6)
    needed = advice(coarse)
    half, right, fine = map(told, (needed // 2, needed, round(1.4 * needed)))
    assert needed == pytest.approx(66.0 / np.sqrt(2.0 * FINE**2 * 139.0), rel=0.3)  # of squares cut in two, cell's area
    assert right.utilisation_too_low is None
    assert right.utilisation_max == pytest.approx(fine.utilisation_max, rel=0.1)
    assert coarse.utilisation_max < 0.95 * right.utilisation_max
    assert advice(half) > needed // 2
    x, y = right.utilisation_max_at_mm
    place = f"at ({x:.6g}, {y:.6g}) mm, "
    assert right.weakest_place.startswith(place)
    assert near in right.weakest_place
    assert f"rings {right['weakest_place']} would yield first" in holds_line(right)


@pytest.mark.slow
def test_a_place_is_named_by_what_is_nearest_and_how_far_it_is():
    """Closed distances to hole, edges, hooks, loads, and to an obstacle where the curtain lies on it."""
    hole = [[40, 30], [60, 30], [60, 50], [40, 50]]
    tables = sheet(
        100.0, 80.0, 20, {"kind": "hooks", "pitch": 50.0}, load={"point": {"at": [25.0, 40.0], "force": [0, -1]}}
    )
    tables["curtain"] |= {"holes": [hole]}
    solution = solve_scene(read_scene(tables), default_law())
    for at, name, distance in (
        ((62.0, 40.0), "hole 1", 2.0),
        ((63.0, 54.0), "hole 1", 5.0),
        ((97.0, 40.0), "edge right", 3.0),
        ((50.0, 3.5), "edge bottom", 3.5),
        ((53.0, 76.0), "edge top", 4.0),
        ((50.0, 80.0), "support 1 (hooks)", 0.0),
        ((28.0, 44.0), "load.point 1", 5.0),
    ):
        assert nearest(solution, np.array(at)) == (name, pytest.approx(distance, abs=1e-9))
    wall = {"kind": "wall", "facing": [1.0, 0.3], "point": [5.0, 70.0]}  # lower corner left lies on it
    pushed = sheet(100.0, 80.0, 5, {"kind": "top", "gather": 0.9}) | {"obstacle": [wall]}
    solution = solve_scene(read_scene(pushed), default_law())
    assert nearest(solution, np.array([0.0, 0.0])) == ("obstacle 1 (wall)", 0.0)
    assert nearest(solution, np.array([40.0, 0.0])) == ("edge bottom", 0.0)


@pytest.mark.slow
def test_rings_at_hooks_are_in_the_picture_of_utilisation():
    """Circles at the hooks in the colours of the same scale, which reaches the largest of them."""
    answer = solve(
        read_scene(sheet(60.0, 60.0, 4, {"kind": "hooks", "pitch": 30.0, "gather": 0.9}, load={"bar": {"mass": 1.0}}))
    )
    (rings,) = [
        one for one in answer.plot_utilisation().collections if str(one.get_label()).startswith("ring at a hook")
    ]
    points = answer.summary.support_forces[0].points
    np.testing.assert_allclose(rings.get_offsets(), [one.place_mm for one in points], atol=1e-9)
    limit = pulled_ring(5.0, 0.5, default_law().strength.material).first_yield_N
    borne = [np.linalg.norm(one.force_N) / limit for one in points]
    np.testing.assert_allclose(rings.get_array(), borne, rtol=1e-9)
    assert max(borne) == pytest.approx(answer.summary.utilisation_of_hook_rings_max, rel=1e-9)
    assert rings.norm.vmax >= max(borne)


def square(scale=1.0, law=None, **curtain):
    """The summary of a small square hung by its corners, all lengths times `scale`."""
    side = {"width": 60.0 * scale, "height": 60.0 * scale, "areal_mass": 2.785}
    mesh = {"cells": 6, "pattern": "crossed"}
    tables = {"curtain": side | curtain, "support": MESH_ALONE, "mesh": mesh}
    return judge_strength(solve_scene(read_scene(tables), default_law() if law is None else law))


@pytest.mark.slow
def test_mirror_images_and_quarter_turns_bear_the_same():
    left, right = square(weave_angle=25.0), square(weave_angle=-25.0)
    for key in ("utilisation_max", "utilisation_pointwise_max", "utilisation_of_averages_max", "collapse_factor"):
        assert vars(left)[key] == pytest.approx(vars(right)[key], rel=1e-3)
    once, twice = square(weave_angle=90.0), square(weave_angle=270.0)
    assert once.utilisation_max == pytest.approx(twice.utilisation_max, rel=1e-6)
    assert once.utilisation_max != pytest.approx(square().utilisation_max, rel=1e-2)


@pytest.mark.slow
def test_a_mirrored_scene_with_the_mirrored_form_of_a_chiral_weave_bears_the_same():
    """6-in-1 leans to one side: without its mirrored form the mirrored scene bears something else."""
    step = np.arange(0.0, 91.0, 15.0)
    cell = Cell(weave="6-in-1")
    loads = np.repeat(np.arange(-45.0, 45.0, 15.0), len(step)), np.tile(step, 6)
    table = with_rings(solve_table(cell, loads), cell)
    flip = np.array([1.0, -1.0, 1.0])
    image = replace(table, alpha_deg=-table.alpha_deg, E=table.E * flip, S=table.S * flip, states=None)
    image = replace(image, compliance=table.compliance * np.outer(flip, flip))
    scene = {"curtain": {"width": 100.0, "height": 80.0}, "mesh": {"cells": 8}, "support": {"kind": "corners"}}
    left, right, other = (
        solve(read_scene(scene | {"curtain": scene["curtain"] | {"weave_angle": angle}}), law).summary
        for law, angle in ((fit(table).law, 25.0), (fit(image).law, -25.0), (fit(table).law, -25.0))
    )
    for key in ("utilisation_of_averages_max", "utilisation_of_point_forces_max", "collapse_factor", "safety_factor"):
        assert vars(left)[key] == pytest.approx(vars(right)[key], rel=0.02)
    assert left.utilisation_pointwise_max == pytest.approx(right.utilisation_pointwise_max, rel=1e-3)
    assert left.utilisation_of_averages_max != pytest.approx(other.utilisation_of_averages_max, rel=0.05)


def test_ten_times_larger_rings_in_a_ten_times_larger_curtain_of_the_same_mass_bear_the_same():
    """Line loads are ten times as large, and so is what the wire bears."""
    law, known = default_law(), default_law().strength
    cell = replace(law.cell, **{key: 10.0 * value for key, value in vars(law.cell).items() if key.endswith("_mm")})
    strength = replace(known, first_yield=0.1 * known.first_yield, collapse=0.1 * known.collapse)
    small, large = square(), square(10.0, replace(law, cell=cell, strength=strength))
    for key in ("utilisation_max", "utilisation_pointwise_max", "collapse_factor"):
        assert vars(large)[key] == pytest.approx(vars(small)[key], rel=1e-3)


def test_the_largest_average_is_that_of_all_corners_of_the_mesh():
    """The search stops early; here every corner is visited."""
    from macro_fem.judged import Disks, Nearby

    tables = {"curtain": {"width": 60.0, "height": 60.0}, "support": {"kind": "corners"}, "mesh": {"cells": 8}}
    solution = solve_scene(read_scene(tables), default_law())
    law = solution.problem.law.own
    mesh, S = solution.problem.mesh.mesh, solution.recovered(solution.S)
    near = Nearby(Disks(mesh.p.T, mesh.t.T, law.cell.b_x_mm * law.cell.b_y_mm), S, np.ones(len(S)))
    means = np.array([near.mean(x) for x in mesh.p.T])
    told = judge_strength(solution)
    assert told.utilisation_of_averages_max == pytest.approx(law.strength.utilisation(means).max(), rel=1e-12)


def test_the_vtu_has_the_utilisation_of_every_cell(strip, tmp_path):
    write_mesh_file(tmp_path / "curtain.vtu", curtain_mesh(strip))
    field = read_mesh_file(tmp_path / "curtain.vtu").cell_data["utilisation"][0]
    np.testing.assert_allclose(field, utilisation(strip), rtol=1e-12)
    assert field.max() == pytest.approx(judge_strength(strip).utilisation_pointwise_max, rel=1e-12)


def test_laws_that_do_not_know_say_so(tmp_path):
    for law, words in (
        (ring_net(default_law().cell), "make its table with rve table --rings"),
        (replace(default_law(), strength=None), "make its table with rve table --rings"),
        (with_yield(None), "steel has no yield stress"),
        (replace(default_law(), strength=default_law().strength.take(np.arange(5))), "on one line"),
    ):
        told = summarize(hung(law))
        assert told.utilisation_max is told.safety_factor is told.collapse_factor is None
        assert words in told.strength_note
        assert holds_line(told).startswith("strength of the rings not known: ")
    write_mesh_file(tmp_path / "curtain.vtu", curtain_mesh(hung(replace(default_law(), strength=None))))
    assert "utilisation" not in read_mesh_file(tmp_path / "curtain.vtu").cell_data


def two_hooks(law=None, **support):
    """Two sliding hooks that carry half of the bar each, and no force along their rail; its summary."""
    return summarize(hung(law, kind="hooks", pitch=WIDTH, sliding=True, **support))


@pytest.mark.slow
def test_hooks_are_compared_with_their_capacity():
    half = 0.5 * MASS * GRAVITY
    for share, words in ((0.9, "does not hold, factor 0.9; hooks of support 1"), (0.5, "does not hold, factor 0.5; ")):
        told = two_hooks(capacity=share * half)
        (held,) = told.support_forces
        assert held.capacity_N == share * half
        assert held.largest_nodal_force_N == pytest.approx(half, rel=1e-6)
        assert told.weakest == "hook capacity"
        assert told.weakest_factor == pytest.approx(share, rel=1e-6)
        line = holds_line(told)
        assert line.startswith(words)
        assert f"bear up to {half:.4g} N of {share * half:g} N" in line
    told = two_hooks()
    assert told.support_forces[0].capacity_N is None
    assert told.weakest_factor == told.safety_factor


@pytest.mark.slow
@pytest.mark.parametrize("joint", ["welded", "butted:worst", "butted:30"])
@pytest.mark.parametrize("rings", [1, 3])
def test_the_ring_at_a_hook_is_pulled_by_two_opposed_forces(joint, rings):
    """As many times the load as the strength of the rings that share it is of the force, by hand; it is the least."""
    law, half = with_yield(400.0), 0.5 * MASS * GRAVITY
    cell, material = law.cell, law.strength.material
    law = replace(law, strength=replace(law.strength, joint=joint))
    one = pulled_ring(cell.r1_mm, cell.r2_mm, material, "welded" if joint == "welded" else "butted")
    told = two_hooks(law, rings_per_hook=rings)
    assert told.utilisation_of_hook_rings_max == pytest.approx(half / rings / one.first_yield_N, rel=1e-6)
    if rings == 1:
        assert told.weakest in ("ring at hook 1", "ring at hook 2")
        assert told.safety_factor == told.weakest_factor == pytest.approx(one.first_yield_N / half, rel=1e-6)
        assert told.collapse_factor <= (1.0 + 1e-6) * one.collapse_N / half
        assert told.utilisation_max_at_mm in ([0.0, 150.0], [WIDTH, 150.0])
        assert f"the {told['weakest']} would yield first" in holds_line(told)


@pytest.mark.slow
def test_rings_at_corners_points_runners_and_loaded_points():
    """Wherever a force acts at a point it goes through rings; an edge that is held as a whole has none of them."""
    ring = pulled_ring(5.0, 0.5, default_law().strength.material)
    curtain = {"curtain": {"width": 60.0, "height": 60.0}, "mesh": {"cells": 4}}
    pair = [{"kind": "point", "at": [x, 60.0], "rings_per_hook": 2} for x in (0.0, 60.0)]
    track = {"kind": "track", "radius": 100.0, "angle": 40.0, "pitch": 30.0}
    for support, name, share in (
        ({"kind": "corners"}, "corner", 1.0),
        (pair, "point 1 of support", 2.0),
        (track, "runner", 1.0),
    ):
        told = summarize(solve_scene(read_scene(curtain | {"support": support}), default_law()))
        most = max(one.largest_nodal_force_N for one in told.support_forces)
        assert told.ring_at_hook.startswith(f"ring at {name}")
        assert told.utilisation_of_hook_rings_max == pytest.approx(most / share / ring.first_yield_N, rel=1e-9)
    for forces, name in (([-8.0], "load.point 1"), ([-3.0, -5.0], "load.point 1 and load.point 2")):
        load = {"point": [{"at": [30.0, 30.0], "force": [0.0, force], "rings_per_hook": 4} for force in forces]}
        told = summarize(solve_scene(read_scene(curtain | {"support": {"kind": "top"}, "load": load}), default_law()))
        assert told.ring_at_hook == f"ring at {name}"
        assert told.utilisation_of_hook_rings_max == pytest.approx(2.0 / ring.first_yield_N, rel=1e-12)


@pytest.mark.slow
def test_a_scene_may_say_what_the_rings_are_made_of():
    """Half the density halves the weight, twice the yield stress the utilisation; everything is in the summary."""
    tables = sheet(40.0, 40.0, 4, {"kind": "top", "gather": 0.9}, solver={"bounds": True})
    plain = solve(read_scene(tables))
    titanium = solve(read_scene(tables | {"material": {"material": "titanium grade 2"}}))
    one, other = plain.summary, titanium.summary
    assert other["material"] == asdict(named_material("titanium grade 2")) == asdict(titanium.rings().cell.material)
    assert other.areal_mass_kg_per_m2 / one.areal_mass_kg_per_m2 == pytest.approx(4.51 / 7.85, rel=1e-12)
    assert titanium.status == "converged"
    ratio = 4.51 / 7.85 * 235.0 / 275.0
    assert other.utilisation_max / one.utilisation_max == pytest.approx(ratio, rel=1e-2)
    assert other.bounds.lower_N_mm / one.bounds.lower_N_mm == pytest.approx(4.51 / 7.85, rel=1e-3)
    own = solve(read_scene(tables | {"material": {"yield": 470.0}})).summary
    assert own.ring_material == "steel, changed"
    assert own.safety_factor == pytest.approx(2.0 * one.safety_factor, rel=1e-9)


def test_elastic_curtains_follow_the_material():
    law = default_law()
    ours = replace(law, stiffness_is_measured=True)
    soft = with_material(ours, {"young": 105e3})
    assert soft.stiffness == pytest.approx(0.5 * law.stiffness, rel=1e-12)
    assert soft.strength.compliance == pytest.approx(2.0 * law.strength.compliance, rel=1e-12, nan_ok=True)
    again = with_material(soft, {"young": 105e3})
    assert again.stiffness == pytest.approx(soft.stiffness, rel=1e-12)
    assert again.strength.material == soft.strength.material
    assert with_material(law, {"young": 105e3}).stiffness == pytest.approx(law.stiffness)  # stated, not the rings'
    assert with_material(law, {}) is law


def test_a_material_needs_a_law_that_knows_its_own():
    scene = read_scene({"curtain": {"width": 40, "height": 40}, "support": {"kind": "top"}, "material": {"yield": 400}})
    with pytest.raises(InputError, match="needs a law that knows the strength of its rings; make the table again"):
        solve(scene, replace(default_law(), strength=None))
