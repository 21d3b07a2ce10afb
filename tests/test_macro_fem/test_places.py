"""Nodes are where a scene holds and loads points; supports report their forces there."""

import json
import re
from itertools import product

import meshio
import numpy as np
import pandas
import pytest
import skfem
from click.testing import CliRunner

import macro_fem
from homogenize import default_law, diagonal_net
from macro_fem import read_scene
from macro_fem.cli import main
from macro_fem.curtain import make_problem
from macro_fem.fem import signed_areas
from macro_fem.output import hooks_lines, summarize
from macro_fem.rings import ring_scene
from macro_fem.scene import NODES, build_mesh, disk_areas
from rve import InputError
from rve.geometry import CellInfo
from tests.test_macro_fem.sheets import least_angle, solve_scene

LAW = diagonal_net(1.1)
RINGS = CellInfo(5.0, 0.5, 11.0, 12.646069623526, 2.785)
NET_MEAN_HEIGHT = 14.187635  # 40 x 40 net square, top gathered to 70 %


def scene(support, width=100.0, height=80.0, load=(), mesh=(), solver=(), **curtain):
    shape = curtain if "shape" in curtain else {"width": width, "height": height, **curtain}
    tables = {"curtain": {"areal_mass": 1.0, **shape}, "support": support, "load": dict(load), "solver": dict(solver)}
    return read_scene({**tables, "mesh": dict(mesh)})


def points_of(summary, number=0):
    """Reference places and forces (k, 2) of one support."""
    points = summary["support_forces"][number]["points"]
    return np.array([p["at_mm"] for p in points]), np.array([p["force_N"] for p in points])


def has_node(mesh, at, within=1e-9):
    return np.linalg.norm(mesh.mesh.p.T - np.array(at), axis=1).min() < within * mesh.size


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_hooks_every_200_mm_on_3_m(element):
    """16 hooks at 0, 200, ..., 3000, though 32 columns have nodes every 93.75 mm."""
    hooks = {"kind": "hooks", "pitch": 200.0}
    solution = solve_scene(scene(hooks, 3000.0, 300.0, mesh={"cells": 32, "element": element}), LAW)
    summary = summarize(solution)
    at, force = points_of(summary)
    np.testing.assert_allclose(at, np.column_stack([np.arange(0.0, 3001.0, 200.0), np.full(16, 300.0)]), atol=1e-9)
    (row,) = summary["support_forces"]
    assert (row["nodes_held"], row["length_held_mm"]) == (16, 0.0)
    np.testing.assert_allclose(force.sum(axis=0), summary["support_forces"][0]["force_N"], atol=1e-9)
    np.testing.assert_allclose(force.sum(axis=0), [0.0, 1e-6 * 9.81 * 3000.0 * 300.0], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("hang", ["y", 30.0])
@pytest.mark.parametrize("shape", ["rectangle", "hole", "outline", "disk", "file"])
def test_every_point_has_its_node(shape, hang, tmp_path):
    """Random points inside a curtain and on its rim get nodes; its area stays, its cells stay positive and sound."""
    shapes = {
        "rectangle": {"width": 100.0, "height": 80.0},
        "hole": {"width": 100.0, "height": 80.0, "holes": [[[40, 30], [60, 30], [60, 50], [40, 50]]]},
        "outline": {"shape": "outline", "outline": [[0, 0], [100, 10], [90, 80], [0, 70]]},
        "disk": {"shape": "disk", "radius": 50.0},
        "file": {"shape": "file", "file": "mesh.vtu"},
    }
    rim = {"disk": [50.0 * np.cos(0.3), 50.0 * np.sin(0.3)], "outline": [37.0, 3.7]}.get(shape, [37.0, 0.0])
    plain = skfem.MeshTri.init_tensor(np.linspace(0, 100, 8), np.linspace(0, 80, 7))
    flat = np.column_stack([plain.p.T, np.zeros(plain.p.shape[1])])
    meshio.Mesh(flat, [("triangle", plain.oriented().t.T)]).write(tmp_path / "mesh.vtu")
    rng = np.random.default_rng(7)
    for _ in range(6):
        at = [rim, *rng.uniform([12.0, 15.0], [36.0, 60.0], size=(3, 2)).round(3).tolist()]
        at[1:] = [[x - 30.0, y - 30.0] for x, y in at[1:]] if shape == "disk" else at[1:]
        load = {"point": [{"at": place, "force": [0.0, 0.0]} for place in at]}
        table = {"curtain": {"areal_mass": 1.0, "weave_angle": hang, **shapes[shape]}, "support": {"kind": "top"}}
        if shape != "file":
            table["mesh"] = {"cells": 9}
        without = build_mesh(read_scene(table, tmp_path / "scene.toml"), None)
        mesh = build_mesh(read_scene({**table, "load": load}, tmp_path / "scene.toml"), None)
        assert all(has_node(mesh, place) for place in at)
        p, t = mesh.mesh.p.T, mesh.mesh.t.T
        area = np.abs(signed_areas(p[t])).sum()
        before = np.abs(signed_areas(without.mesh.p.T[without.mesh.t.T])).sum()
        assert area == pytest.approx(before, rel=1e-9 if shape != "disk" else 2e-3)
        assert least_angle(p, t) >= np.degrees(np.arcsin(NODES.least_sine)) - 1e-9
        facets = {name: len(facets) for name, facets in mesh.edges.items()}
        old = {name: len(facets) for name, facets in without.edges.items()}
        assert facets.keys() == old.keys()
        assert 0 <= facets["outline"] - old["outline"] <= 1


def test_a_point_leaves_the_curtain_exact():
    """Cells are cut without turning a side: the net square keeps its exact height, which P1 loses off the weave.

    A node moved to the third place would raise it by 0.13 mm, grid lines through the first by 0.2 mm.
    """
    curtain = {"width": 40.0, "height": 40.0}
    for at in ([13.1, 22.3], [21.7, 9.2], [28.3, 31.2]):
        load = {"point": {"at": at, "force": [0.0, 0.0]}}
        top = {"kind": "top", "gather": 0.7}
        asked = scene(top, load=load, mesh={"cells": 8}, solver={"stabilising_tension": 0.0}, **curtain)
        solution = solve_scene(asked, diagonal_net())
        assert has_node(solution.problem.mesh, at)
        assert solution.mean_height() == pytest.approx(NET_MEAN_HEIGHT, abs=1e-5)


@pytest.mark.parametrize(
    ("at", "words"),
    [
        ([130.0, 40.0], r"\[130.0, 40.0\]: is 30.* mm away from the curtain, whose nearest node is at \(100, "),
        ([50.0, 0.3], r"\[50.0, 0.3\]: gets no node without a flat cell, the nearest one is .* mm away at \["),
        ([50.0, 40.0], r"\[50.0, 40.0\]: is 10.* mm away from the curtain"),
    ],
    ids=["outside", "at the rim", "in the hole"],
)
def test_points_without_a_node_are_told_with_the_nearest(at, words):
    holes = [[[40, 30], [60, 30], [60, 50], [40, 50]]]
    for key in ("support", "load"):
        point = {"kind": "point", "at": at} if key == "support" else {"kind": "top"}
        load = {"point": {"at": at, "force": [1.0, 0.0]}} if key == "load" else {}
        with pytest.raises(InputError, match=words):
            build_mesh(scene(point, load=load, mesh={"cells": 10}, holes=holes), None)


def test_the_place_that_is_advised_has_a_node():
    sheet = {"mesh": {"cells": 7}, "width": 1000.0 / 3.0, "height": 1000.0 / 7.0}
    with pytest.raises(InputError, match="ask for that place") as told:
        build_mesh(scene({"kind": "point", "at": [0.0, 142.85]}, **sheet), None)
    advised = json.loads(re.search(r"away at (\[.*?\])", str(told.value))[1])
    for near in (advised, [advised[0], advised[1] - 3e-4]):
        assert has_node(build_mesh(scene({"kind": "point", "at": near}, **sheet), None), near, 1e-6)


def test_hooks_are_evenly_spaced_along_an_arch():
    turn = np.linspace(0.0, np.pi, 41)
    arch = [[-50.0, -60.0], [50.0, -60.0], *np.column_stack([50.0 * np.cos(turn), 50.0 * np.sin(turn)]).tolist()]
    support = {"kind": "hooks", "pitch": 13.0}
    one = scene(support, shape="outline", outline=arch, mesh={"cells": 14})
    problem = make_problem(one, LAW, build_mesh(one, None))
    held = problem.supports.held[0]
    at = problem.disc.nodes[held.nodes]
    assert len(at) == round(50.0 * np.pi / 13.0) + 1
    angles = np.diff(np.arctan2(at[:, 1], at[:, 0]))
    assert angles == pytest.approx(-np.pi / (len(at) - 1), rel=0.02)


def test_a_node_of_two_supports_counts_once():
    """Top and left side share a corner: the points of both together balance the load and have the corner once."""
    support = [{"kind": "top"}, {"kind": "edge", "edge": "left"}, {"kind": "point", "at": [0.0, 80.0]}]
    load = {"edge": {"edge": "bottom", "force": [0.02, -0.03]}}
    solution = solve_scene(scene(support, load=load, mesh={"cells": 6}), LAW)
    summary = summarize(solution)
    places, forces = zip(*(points_of(summary, number) for number in (0, 1)), strict=True)
    total = np.sum([force.sum(axis=0) for force in forces], axis=0)
    np.testing.assert_allclose(total, -np.array(summary["total_load_N"]), atol=1e-6)
    for number, force in enumerate(forces):
        np.testing.assert_allclose(force.sum(axis=0), summary["support_forces"][number]["force_N"], atol=1e-12)
    together = np.concatenate(places).round(9).tolist()
    assert together.count([0.0, 80.0]) == 1
    assert hooks_lines(summary)[1] == "point (0, 80): the forces of 1 of its points count for a support before it"
    corner = np.linalg.norm(forces[0][together.index([0.0, 80.0])])
    assert summary["support_forces"][2]["largest_nodal_force_N"] == pytest.approx(corner)
    held = [item["nodes_held"] for item in summary["support_forces"]]
    assert sum(held) - 2 == len(together)
    assert sum(item["length_held_mm"] for item in summary["support_forces"]) == pytest.approx(180.0)


def test_a_gathered_edge_is_narrowed_about_its_middle():
    one = scene({"kind": "edge", "edge": "left", "gather": 0.9, "move": [1.0, -2.0]}, mesh={"cells": 6})
    held = make_problem(one, LAW, build_mesh(one, None)).supports.held[0]
    X = build_mesh(one, None).mesh.p.T[held.nodes]
    np.testing.assert_allclose(held.positions, np.column_stack([X[:, 0] + 1.0, 40.0 + 0.9 * (X[:, 1] - 40.0) - 2.0]))


def run(folder, text):
    (folder / "scene.toml").write_text(text)
    LAW.save(folder / "law.json")
    arguments = ["run", str(folder / "scene.toml"), "--law", str(folder / "law.json"), "--out", str(folder / "out")]
    result = CliRunner().invoke(main, [*arguments, "--no-picture"])
    assert result.exit_code == 0, result.output
    return folder / "out"


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_csv_and_vtu_hold_the_forces_of_the_summary(tmp_path, element):
    """The VTU has the corners of cells only; what a node between them carries is shared by the two beside it."""
    text = f'[curtain]\nwidth = 100\nheight = 80\nareal_mass = 1\n[mesh]\ncells = 5\nelement = "{element}"\n'
    text += '[[support]]\nkind = "top"\n[[support]]\nkind = "edge"\nedge = "left"\nheld = "x"\n'
    out = run(tmp_path, text + '[[load.edge]]\nedge = "right"\nforce = [0.01, 0.0]\n')
    summary = json.loads((out / "summary.json").read_text())
    table = pandas.read_csv(out / "support_forces.csv")
    for number in (0, 1):
        rows = table[table.support_number == number + 1]
        at, force = points_of(summary, number)
        np.testing.assert_array_equal(rows[["x_mm", "y_mm"]], at)
        np.testing.assert_array_equal(rows[["force_x_N", "force_y_N"]], force)
        assert set(rows.support) == {summary["support_forces"][number]["support"]}
    data = meshio.read(out / "curtain.vtu")
    nodal = data.point_data["support_force_N"]
    np.testing.assert_allclose(nodal.sum(axis=0)[:2], -np.array(summary["total_load_N"]), atol=1e-5)
    moment = (data.points[:, 0] * nodal[:, 1] - data.points[:, 1] * nodal[:, 0]).sum()
    assert moment == pytest.approx((table.x_mm * table.force_y_N - table.y_mm * table.force_x_N).sum(), rel=1e-9)
    held = (np.abs(data.points[:, 0]) < 1e-9) | (np.abs(data.points[:, 1] - 80.0) < 1e-9)
    assert np.abs(nodal[~held]).max() == 0.0


def directions(mesh):
    """Directions in degrees (k,) from -90 to 90 of the facets inside a mesh."""
    inner = np.setdiff1d(np.arange(mesh.mesh.facets.shape[1]), mesh.mesh.boundary_facets())
    ends = mesh.mesh.p[:, mesh.mesh.facets[:, inner]]
    dx, dy = ends[:, 1] - ends[:, 0]
    return np.mod(np.degrees(np.arctan2(dy, dx)) + 90.0, 180.0) - 90.0


def share_along(mesh, degrees):
    off = np.abs(np.mod(directions(mesh) - degrees + 90.0, 180.0) - 90.0)
    return float((off < 0.01).mean())


FAMILY = np.degrees(np.arctan(RINGS.b_y_mm / RINGS.b_x_mm))


@pytest.mark.parametrize(
    ("shape", "hang"), [*product(("rectangle", "outline"), (0.0, 90.0)), ("outline", 30.0), ("outline", -20.0)]
)
def test_inner_edges_follow_the_turned_weave(shape, hang):
    """Both diagonals of the weave's cell, 49 degrees from its x axis, turn with it counterclockwise."""
    outline = {"shape": "outline", "outline": [[0, 0], [100, 0], [100, 80], [0, 80]]}
    curtain = {"weave_angle": hang, **(outline if shape == "outline" else {})}
    mesh = build_mesh(scene({"kind": "top"}, mesh={"cells": 24}, **curtain), RINGS)
    for family in (FAMILY, -FAMILY):
        assert share_along(mesh, hang + family) > 0.25
        if hang % 90.0:
            assert share_along(mesh, -hang + family) < 0.05


def test_a_disk_shares_its_area_with_the_cells_it_touches():
    """A grid around it gets all of it; half-planes, quarters and a ring segment get what geometry says."""
    grid = skfem.MeshQuad.init_tensor(np.linspace(-3, 3, 8), np.linspace(-3, 3, 6))
    centre, radius = np.array([0.3, -0.2]), 2.1
    shares = disk_areas(grid.p.T[grid.t.T], centre, radius)
    assert shares.sum() == pytest.approx(np.pi * radius**2)
    box = np.array([[0.0, -9.0], [9.0, -9.0], [9.0, 9.0], [0.0, 9.0]])
    corner = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 9.0]])
    right = np.array([1.0, 0.0])
    areas = disk_areas(np.array([box, box[::-1], corner, box + right, box + 2.5 * right]), np.zeros(2), 2.0)
    assert areas == pytest.approx([2 * np.pi, 2 * np.pi, np.pi, 4.0 * np.pi / 3.0 - np.sqrt(3.0), 0.0])


@pytest.mark.parametrize(("radius", "off"), [(12.0, 0.6), (30.0, 0.2)])
def test_a_patch_acts_where_it_is_asked_for(radius, off):
    """The resultant is within a small part of a cell, 12.5 mm wide, of the centre, wherever that is."""
    rng = np.random.default_rng(5)
    for at in rng.uniform(32.0, 68.0, size=(12, 2)):
        load = {"gravity": 0.0, "patch": {"at": at.tolist(), "radius": radius, "force": [0.0, -3.0]}}
        one = scene({"kind": "top"}, 100.0, 100.0, load=load, mesh={"cells": 8})
        problem = make_problem(one, LAW, build_mesh(one, None))
        assert problem.force.sum(axis=0) == pytest.approx([0.0, -3.0])
        middle = problem.force[:, 1] @ problem.disc.nodes / -3.0
        assert np.linalg.norm(middle - at) < off


@pytest.mark.parametrize(
    ("keys", "count", "asked"),
    [
        ("pitch = 129", 24, 129.0),
        ("count = 24", 24, None),
        ("pitch = 125", 25, 125.0),
    ],
)
@pytest.mark.slow
def test_the_pitch_that_fits_is_told(tmp_path, keys, count, asked):
    """A pitch of 129 mm does not divide 3000 mm: 23 spaces of 130.4 mm."""
    (tmp_path / "scene.toml").write_text(
        f"[curtain]\nwidth = 3000\nheight = 500\n[mesh]\ncells = 24\n[support]\nkind = 'hooks'\n{keys}\n"
    )
    found = CliRunner().invoke(main, ["run", f"{tmp_path}/scene.toml", "--out", f"{tmp_path}/out", "--no-picture"])
    assert found.exit_code == 0, found.output
    (hooks,) = json.loads((tmp_path / "out" / "summary.json").read_text())["support_forces"]
    assert hooks["pitch_mm"] == pytest.approx(3000.0 / (count - 1))
    assert hooks["pitch_asked_mm"] == asked
    table = pandas.read_csv(tmp_path / "out" / "support_forces.csv")
    assert np.diff(table.x_mm) == pytest.approx(hooks["pitch_mm"])
    assert table.point.tolist() == [f"hook {k}" for k in range(1, count + 1)]
    np.testing.assert_allclose(table[["place_x_mm", "place_y_mm"]], table[["x_mm", "y_mm"]])  # they have not moved
    assert f"hooks: {count}, {hooks['pitch_mm']:g} mm apart" in found.output
    assert ("does not divide" in found.output) == (asked == 129.0)
    assert found.output.startswith("no --law: rings of r1 = 5 mm and r2 = 0.5 mm, 4-in-1, steel")


def test_nearly_whole_cells_keep_the_rings_at_the_corners():
    """75.9 mm are six cells of 12.646 mm: the corner rings must not go, nor the support move by 1.9 mm."""
    width, solver = 6 * RINGS.b_x_mm, macro_fem.Solver(kind="elastic", bounds=True)
    first = macro_fem.Scene(macro_fem.Rectangle(width, 6 * RINGS.b_y_mm), [macro_fem.Corners()])
    other = macro_fem.Scene(macro_fem.Rectangle(width, 75.9), [macro_fem.Corners(rings_per_hook=2)], solver=solver)
    exact, rounded = (ring_scene(scene, default_law()) for scene in (first, other))
    assert exact.notes == ()
    assert "height = 75.9 mm is taken as 6 whole cells" in rounded.notes[0]
    unread = "[solver] kind, bounds", "[support] (corners) rings_per_hook"
    assert rounded.notes[1:] == tuple(f"{keys}: has no effect on every ring" for keys in unread)
    assert len(rounded.mesh.X) == len(exact.mesh.X)
    for (_, one), (_, its) in zip(exact.groups, rounded.groups, strict=True):
        assert rounded.mesh.X[its[:, 0]] == pytest.approx(exact.mesh.X[one[:, 0]])
