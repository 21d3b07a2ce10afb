"""Edges by direction, by hole and by physical group: lengths that can be told from the drawing."""

import meshio
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from homogenize import diagonal_net
from macro_fem import read_scene
from macro_fem.curtain import make_problem
from macro_fem.output import summarize
from macro_fem.scene import border_of, build_mesh, mesh_outline, refine
from rve import InputError
from tests.test_macro_fem.sheets import solve_scene

RISE = np.linspace(100.0, 0.0, 24)  # an even number: the arch has a flat facet at its apex
ARCH = np.vstack([[[0, 0], [100, 0]], np.column_stack([RISE, 100.0 + 0.016 * RISE * (100.0 - RISE)])])
TURN = np.linspace(0.0, np.pi, 31)
ROUND = np.vstack([[[0, 0], [100, 0]], np.column_stack([50 + 50 * np.cos(TURN), 100 + 50 * np.sin(TURN)])])
HOLES = [np.array([[60.0, 40], [80, 40], [80, 60], [60, 60]]), np.array([[15.0, 20], [25, 20], [25, 30], [15, 30]])]


def arc(points):
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def scene_of(outline, folder, groups=(), support=None, holes=(), **tables):
    """A scene of a mesh file of an outline; `groups` maps names to (tag, where on the boundary or inside)."""
    points, cells = mesh_outline(np.array(outline, float), list(holes), 12, 1.15, 0.0)
    blocks, tags, names = [("triangle", cells)], [np.full(len(cells), 99)], {"sheet": np.array([99, 2])}
    pairs = np.unique(np.sort(np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [2, 0]]]), axis=1), axis=0)
    for tag, (name, is_in) in enumerate(dict(groups).items(), start=1):
        chosen = pairs[is_in(points[pairs]).all(axis=1)]
        blocks.append(("line", chosen))
        tags.append(np.full(len(chosen), tag))
        if not name.isdigit():
            names[name] = np.array([tag, 1])
    data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    flat = np.column_stack([points, np.zeros(len(points))])
    document = meshio.Mesh(flat, blocks, cell_data=data, field_data=names)
    document.write(folder / "mesh.msh", file_format="gmsh22", binary=False)
    curtain = {"shape": "file", "file": "mesh.msh", "areal_mass": 1.0}
    return read_scene({"curtain": curtain, "support": support or {"kind": "top"}, **tables}, folder / "scene.toml")


def lengths(mesh):
    ends = {name: mesh.mesh.p[:, mesh.mesh.facets[:, facets]] for name, facets in mesh.edges.items()}
    return {name: float(np.hypot(*(end[:, 1] - end[:, 0])).sum()) for name, end in ends.items()}


def held(scene):
    """The first support of a scene as its problem holds it: name, nodes, length in mm."""
    problem = make_problem(scene, diagonal_net(1.1), build_mesh(scene, None))
    one = problem.supports.held[0]
    return one.name, len(one.nodes), np.hypot(*problem.mesh.sides[one.facets].T).sum()


def outline_lengths(outline):
    curtain = {"shape": "outline", "outline": [list(map(float, p)) for p in outline], "areal_mass": 1.0}
    found = lengths(build_mesh(read_scene({"curtain": curtain, "support": {"kind": "top"}}), None))
    return {name: length for name, length in found.items() if name != "outline"}


def test_an_arch_is_held_along_its_whole_arch(tmp_path):
    """Not by its flat apex alone: every point of the arch stays where it is."""
    scene = scene_of(ARCH, tmp_path)
    solution = solve_scene(scene, diagonal_net(1.1))
    summary = summarize(solution)
    assert summary["support_forces"][0]["nodes_held"] == 24
    assert summary["support_forces"][0]["length_held_mm"] == pytest.approx(arc(ARCH[2:]))
    distance, node = cKDTree(solution.problem.disc.nodes).query(ARCH[2:])
    assert distance.max() < 1e-9
    assert np.abs(solution.displacement[node]).max() < 1e-9


def test_a_round_arch_ends_where_its_sides_are_upright():
    found = outline_lengths(ROUND)
    assert found == pytest.approx({"top": arc(ROUND[2:]), "bottom": 100.0, "left": 100.0, "right": 100.0})


def turned(points, degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array(points, float) @ np.array([[c, s], [-s, c]])


BOX = [[0, 0], [100, 0], [100, 80], [0, 80]]
STEP = [[0, 0], [100, 0], [100, 40], [50, 40], [50, 80], [0, 80]]
HEM = [[0, 40], [100, 0], [100, 80], [0, 80]]
HEIGHTS = np.linspace(0.0, 80.0, 21)
WAVE = np.column_stack([100.0 + 1.5 * np.sin(0.3 * HEIGHTS), HEIGHTS])
HIP = {"top": 60.0, "bottom": 100.0, "left": 60.0, "right": 60.0}
OUTLINES = {
    "box": (BOX, {"top": 100.0, "bottom": 100.0, "left": 80.0, "right": 80.0}),
    "turned left": (turned(BOX, 20.0), {"top": 100.0, "bottom": 100.0, "left": 80.0, "right": 80.0}),
    "turned right": (turned(BOX, -20.0), {"top": 100.0, "bottom": 100.0, "left": 80.0, "right": 80.0}),
    "step": (STEP, {"top": 50.0, "bottom": 100.0, "left": 80.0, "right": 40.0}),
    "diamond": ([[50, 0], [100, 50], [50, 100], [0, 50]], {"top": 200.0 * 0.5**0.5, "bottom": 200.0 * 0.5**0.5}),
    "slender diamond": ([[60, 0], [80, 40], [60, 80], [40, 40]], {"top": 2.0 * 2000**0.5, "bottom": 2.0 * 2000**0.5}),
    "chamfers": ([[0, 0], [100, 0], [100, 60], [80, 80], [20, 80], [0, 60]], HIP),
    "hips": ([[0, 0], [100, 0], [100, 60], [80, 78], [20, 78], [0, 60]], HIP),
    "spire": ([[0, 0], [100, 0], [50, 173.2]], {"bottom": 100.0, "top": 2.0 * np.hypot(50.0, 173.2)}),
    "sloping hem": (HEM, {"top": 100.0, "bottom": np.hypot(100, 40), "left": 40, "right": 80}),
    "wavy side": ([[0, 0], *WAVE, [0, 80]], {"top": WAVE[-1, 0], "bottom": 100.0, "left": 80.0, "right": arc(WAVE)}),
}


@pytest.mark.parametrize("name", OUTLINES)
def test_sides_of_outlines(name):
    outline, expected = OUTLINES[name]
    assert outline_lengths(outline) == pytest.approx(expected)


def test_a_disk_has_an_upper_and_a_lower_half():
    scene = read_scene({"curtain": {"shape": "disk", "radius": 50.0, "areal_mass": 1.0}, "support": {"kind": "top"}})
    found = lengths(build_mesh(scene, None))
    assert found.keys() == {"top", "bottom", "outline"}
    assert found["top"] == pytest.approx(np.pi * 50.0, rel=0.03)
    assert found["top"] + found["bottom"] == pytest.approx(found["outline"])


def sides(outline):
    """Lengths of named edges of an outline; top and bottom reach its extremes, and no side has two names."""
    border = border_of(outline, [np.append(np.arange(len(outline)), 0)])
    ends = {name: outline[pairs] for name, pairs in border.edges.items()}
    named = np.concatenate([pairs for name, pairs in border.edges.items() if name != "outline"])
    assert len(np.unique(named, axis=0)) == len(named)
    for name, row, sign in (("top", 1, 1.0), ("bottom", 1, -1.0)):
        assert (sign * ends[name][..., row]).max() == (sign * outline[:, row]).max()
    return {name: float(np.linalg.norm(np.diff(end, axis=1), axis=2).sum()) for name, end in ends.items()}


@pytest.mark.parametrize("power", [1, 2, 5])
def test_a_drop_has_a_top_and_a_bottom_whichever_way_its_tip_points(power):
    """Its coordinates are whole numbers, so that the chain around it adds up to nothing in both components."""
    t = 2.0 * np.pi * np.arange(24) / 24
    drop = np.column_stack([np.sin(t) * np.sin(0.5 * t) ** power, np.cos(t)])[::-1]
    for degrees in 2.5 * np.arange(144):
        sides(np.round(1e5 * turned(drop, degrees)))


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(
    radii=st.lists(st.floats(0.05, 1.0), min_size=5, max_size=40),
    slender=st.floats(0.03, 1.0),
    degrees=st.floats(0.0, 360.0),
)
def test_sides_of_any_outline_depend_on_its_shape_alone(radii, slender, degrees):
    """Slender jagged ones have tips that lean. A mirror swaps names; places, sizes, first corners and points between
    corners change nothing."""
    angle = 2.0 * np.pi * np.arange(len(radii)) / len(radii)
    star = np.array(radii)[:, None] * np.stack([np.cos(angle), slender * np.sin(angle)], axis=-1)
    outline = turned(star, degrees)
    expected = sides(outline)
    halved = np.stack([outline, 0.5 * (outline + np.roll(outline, -1, axis=0))], axis=1).reshape(-1, 2)
    swap = {"left": "right", "right": "left"}
    flip = {"top": "bottom", "bottom": "top"}
    for other, names, scale in (
        (np.roll(outline, 2, axis=0), {}, 1.0),
        (halved, {}, 1.0),
        (1e3 * outline, {}, 1e3),
        ((outline * [-1.0, 1.0])[::-1], swap, 1.0),
        ((outline * [1.0, -1.0])[::-1], flip, 1.0),
    ):
        assert sides(other) == pytest.approx({names.get(k, k): scale * one for k, one in expected.items()}, rel=1e-6)


def near(x0, y0, x1, y1):
    """Which points lie in a box."""
    low, high = np.array([x0, y0]) - 1e-9, np.array([x1, y1]) + 1e-9
    return lambda points: ((points >= low) & (points <= high)).all(axis=-1)


def test_physical_groups_are_edges(tmp_path):
    """By name, or by number where they have none; a group comes before the side of the same name."""
    groups = {"hem": near(0, 0, 100, 0), "top": near(0, 0, 0, 100), "3": near(100, 0, 100, 100)}
    found = lengths(build_mesh(scene_of(ARCH, tmp_path, groups), None))
    assert (found["hem"], found["top"], found["3"]) == pytest.approx((100.0, 100.0, 100.0))
    support = {"kind": "edge", "edge": "hem"}
    assert held(scene_of(ARCH, tmp_path, groups, support)) == ("edge hem", 13, pytest.approx(100.0))


def test_holes_of_a_mesh_file_have_names(tmp_path):
    """They are numbered from left to right; a single hole needs no number."""
    scene = scene_of(ARCH, tmp_path, holes=HOLES, support={"kind": "edge", "edge": "hole 2"})
    found = lengths(build_mesh(scene, None))
    assert (found["hole 1"], found["hole 2"]) == pytest.approx((40.0, 80.0))
    assert found["outline"] == pytest.approx(arc(np.vstack([ARCH, ARCH[:1]])))
    assert "hole" not in found
    assert held(scene)[2] == pytest.approx(80.0)
    one = scene_of(ARCH, tmp_path, holes=HOLES[:1], support={"kind": "edge", "edge": "hole"})
    assert held(one)[2] == pytest.approx(80.0)


def test_an_unknown_edge_is_told_with_those_there_are(tmp_path):
    scene = scene_of(ARCH, tmp_path, {"hem": near(0, 0, 100, 0)}, {"kind": "edge", "edge": "heme"})
    with pytest.raises(InputError, match="'heme': the curtain has no such edge, only bottom, hem, left, outline"):
        held(scene)


def test_a_group_beside_the_sides_of_cells_is_refused(tmp_path):
    scene = scene_of(BOX, tmp_path, {"hem": near(0, 0, 100, 0)})
    data = meshio.read(tmp_path / "mesh.msh")
    data.cells[1].data[0] = [0, 2]  # a line across the sheet
    data.write(tmp_path / "mesh.msh", file_format="gmsh22", binary=False)
    with pytest.raises(InputError, match=r"group 'hem': only 11 of its 12 lines are sides of cells"):
        build_mesh(scene, None)


def test_refined_meshes_keep_groups_holes_and_hooks(tmp_path):
    support = {"kind": "hooks", "pitch": 11.0}
    scene = scene_of(ROUND, tmp_path, {"hem": near(0, 0, 100, 0)}, support, HOLES[:1])
    mesh = build_mesh(scene, None)
    finer = refine(mesh, np.arange(0, mesh.mesh.t.shape[1], 3))
    assert finer.mesh.t.shape[1] > 1.3 * mesh.mesh.t.shape[1]
    assert lengths(finer) == pytest.approx(lengths(mesh))
    places = mesh.mesh.p[:, mesh.hooks[0].nodes]
    assert finer.mesh.p[:, finer.hooks[0].nodes] == pytest.approx(places)
    assert len(finer.hooks[0].nodes) == len(mesh.hooks[0].nodes) == round(arc(ROUND[2:]) / 11.0) + 1
