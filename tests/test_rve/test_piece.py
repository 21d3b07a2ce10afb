"""Pieces of mesh as files: other programs find the same rings, links, distances and volumes in them."""

import json

import numpy as np
import pytest
import trimesh
from lib3mf import get_wrapper
from scipy.spatial import cKDTree

from rve import WEAVES, Cell, InputError, Piece
from rve.placed import DrawnRings, write_solids
from tests.commands import run

ALONG, AROUND = 48, 16


def by_lib3mf(path):
    """Turns (n, 3, 3), centres (n, 3) in mm and the tori (n) of the places in a 3MF, by its own library, strictly."""
    model = get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(str(path))
    assert reader.GetWarningCount() == 0
    items = model.GetBuildItems()
    assert items.Count() == 1  # slicers keep the rings together
    items.MoveNext()
    whole = items.GetCurrent().GetObjectResource()
    places = [whole.GetComponent(k) for k in range(whole.GetComponentCount())]
    rows = np.array([[list(row) for row in place.GetTransform().Fields] for place in places])
    solids = {}
    for number in {place.GetObjectResourceID() for place in places}:
        mesh = next(place.GetObjectResource() for place in places if place.GetObjectResourceID() == number)
        assert mesh.IsManifoldAndOriented()
        corners = [list(mesh.GetVertex(k).Coordinates) for k in range(mesh.GetVertexCount())]
        faces = [list(mesh.GetTriangle(k).Indices) for k in range(mesh.GetTriangleCount())]
        solids[number] = trimesh.Trimesh(corners, faces, process=False)
    return rows[:, :3].transpose(0, 2, 1), rows[:, 3], [solids[place.GetObjectResourceID()] for place in places]


def by_trimesh(path):
    """The same of a GLB, whose unit is m."""
    scene = trimesh.load_scene(path)
    places = [scene.graph[node] for node in scene.graph.nodes_geometry]
    rows = np.array([matrix for matrix, _ in places]) * 1e3
    scale = np.linalg.norm(rows[:, :3, 0], axis=1)
    np.testing.assert_allclose(scale, 1.0, rtol=1e-6)
    return rows[:, :3, :3], rows[:, :3, 3], [scene.geometry[name] for _, name in places]


def sampled_circles(turn, centre, r1, count):
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    flat = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    return centre[:, None] + r1 * np.einsum("nij,jk->nki", turn, flat)


def linking_numbers(one, other):
    """Gauss's integral over two closed polygons (m, k, 3), by the solid angles of pairs of sides."""
    a, b = np.stack([one, np.roll(one, -1, axis=1)]), np.stack([other, np.roll(other, -1, axis=1)])
    r = [[b[j][:, None] - a[i][:, :, None] for j in (0, 1)] for i in (0, 1)]
    corners = (r[0][0], r[0][1], r[1][1], r[1][0])
    normals = [np.cross(corners[k], corners[(k + 1) % 4]) for k in range(4)]
    unit = [n / np.linalg.norm(n, axis=-1, keepdims=True) for n in normals]
    angle = sum(np.arcsin(np.clip((unit[k] * unit[(k + 1) % 4]).sum(axis=-1), -1.0, 1.0)) for k in range(4))
    sign = np.sign((np.cross((b[1] - b[0])[:, None], (a[1] - a[0])[:, :, None]) * r[0][0]).sum(axis=-1))
    return (angle * sign).sum(axis=(1, 2)) / (4.0 * np.pi)


@pytest.mark.parametrize("weave", ["4-in-1", "6-in-1", "kings-4-in-1"])
@pytest.mark.parametrize("ending", ["3mf", "glb"])
def test_another_program_finds_the_rings_links_and_clearance(ending, weave, tmp_path):
    path, cell = tmp_path / f"part.{ending}", Cell.of(inner=8, wire=1.2, weave=weave)
    piece = Piece.cut(cell, (40, 30), clearance=1.2)
    piece.save(path)
    turn, centre, solids = (by_lib3mf if ending == "3mf" else by_trimesh)(path)
    assert len(centre) == len(piece.rings.centre) > 20
    r1, r2 = cell.r1, piece.cell.r2
    facets = ALONG * np.sin(2.0 * np.pi / ALONG) * r1 * 0.5 * AROUND * np.sin(2.0 * np.pi / AROUND) * r2**2
    assert len({id(solid) for solid in solids}) == 1
    assert solids[0].is_watertight
    assert solids[0].volume == pytest.approx(facets, rel=1e-5)
    assert np.ptp(solids[0].vertices, axis=0) == pytest.approx([2 * (r1 + r2), 2 * (r1 + r2), 2 * r2], rel=1e-5)
    np.testing.assert_allclose(turn @ turn.transpose(0, 2, 1), np.broadcast_to(np.eye(3), turn.shape), atol=1e-6)
    a, b = cKDTree(centre).query_pairs(2.0 * r1 + 2.0 * r2 + 0.5, output_type="ndarray").T
    linking = linking_numbers(*(sampled_circles(turn[ends], centre[ends], r1, 24) for ends in (a, b)))
    np.testing.assert_allclose(linking, np.round(linking), atol=1e-6)
    assert np.count_nonzero(np.abs(np.round(linking)) == 1) == piece.links == np.count_nonzero(np.round(linking))
    fine = sampled_circles(turn, centre, r1, 600)
    trees = [cKDTree(points) for points in fine]
    near = min(trees[i].query(fine[j])[0].min() for i, j in zip(a, b, strict=True))
    assert near - 2.0 * r2 == pytest.approx(1.2, abs=2e-3)
    assert piece.clearance_mm == pytest.approx(1.2, abs=1e-9)


def test_all_rings_are_inside_the_size_and_as_many_as_columns_and_rows_have_room():
    cell = Cell.of(inner=8, wire=1.6)
    piece = Piece.cut(cell, (120, 80))
    points, _ = piece.rings.tubes(96, 32)
    assert points.min(axis=0) == pytest.approx(np.zeros(3), abs=0.02)
    assert points.max(axis=0) == pytest.approx(piece.size_mm, abs=0.02)
    assert (np.array(piece.size_mm[:2]) <= (120.0, 80.0)).all()
    pitch, row = 4.8 * cell.weave.start_lattice[:2] * [1.0, 0.5]
    tilt = cell.weave.start_normals[0]
    rows = 1 + int((80.0 - 2.0 * (4.8 * tilt[2] + 0.8)) / row)
    full = 1 + int((120.0 - 11.2) / pitch)
    short = 1 + int((120.0 - 11.2 - 0.5 * pitch) / pitch)
    assert len(piece.rings.centre) == sum((full, short)[k % 2] for k in range(rows))


@pytest.mark.parametrize("name", WEAVES)
def test_every_weave_of_the_catalogue_is_cut(name):
    piece = Piece.cut(Cell(5.0, 4.0 / WEAVES[name].jamming_ratio, name), (60.0, 50.0), clearance=1.0)
    assert piece.links > len(piece.rings.centre) > 20
    assert piece.clearance_mm == pytest.approx(max(1.0, 2.0 / WEAVES[name].jamming_ratio), rel=1e-6)
    assert piece.size_mm[0] < 60.0
    assert piece.size_mm[1] < 50.0


def test_two_sizes_of_rings_are_two_solids(tmp_path):
    centre, normal = np.array([[0.0, 0, 0], [10, 0, 0], [20, 0, 0]]), np.array([[0, 0, 1.0], [0, 1, 0], [0, 0, -1]])
    rings = DrawnRings(centre, normal, np.array([5.0, 3.0, 5.0]), np.array([0.5, 0.4, 0.5]))
    for ending, read in (("3mf", by_lib3mf), ("glb", by_trimesh)):
        write_solids(tmp_path / f"two.{ending}", rings)
        turn, place, solids = read(tmp_path / f"two.{ending}")
        order = np.argsort(place[:, 0])
        np.testing.assert_allclose(place[order], centre, atol=1e-5)
        np.testing.assert_allclose(np.abs((turn[order, :, 2] * normal).sum(axis=1)), 1.0, atol=1e-6)
        outer = [np.ptp(solids[k].vertices[:, 0]) for k in order]
        assert outer == pytest.approx([11.0, 6.8, 11.0], rel=1e-5)
    metal, floor = rings.render().meshes  # which lies behind the sheet of the centres, here that of x and z
    assert np.ptp(floor.points[:, 1]) < 1e-6
    assert floor.bounds.y_max < metal.bounds.y_min


@pytest.mark.slow
def test_a_locked_piece_touches_and_thinner_wire_parts_it(tmp_path):
    words = ("export", "--inner", 8, "--wire", 1.2, "--size", "40x60", "--load", "0,90", "--json")
    locked = json.loads(run("rve", *words, "--out", tmp_path / "a.stl").output)
    assert abs(locked["clearance_mm"]) < 1e-9
    assert locked["wire_mm"] == pytest.approx(1.2)
    parted = json.loads(run("rve", *words, "--out", tmp_path / "b.stl", "--clearance", 0.3).output)
    assert parted["clearance_mm"] == pytest.approx(0.3)
    assert parted["wire_mm"] == pytest.approx(0.9)  # the same centre circles
    assert parted["wire_thinner_by_mm"] == pytest.approx(0.3)
    mesh = trimesh.load_mesh(tmp_path / "b.stl")
    pieces = mesh.body_count
    assert pieces == parted["rings"]
    assert mesh.volume * 7.85e-6 == pytest.approx(parted["mass_kg"], rel=0.04)  # facets are inside of tori
    slack = json.loads(run("rve", *words[:-3], "--json", "--out", tmp_path / "c.stl").output)
    assert slack["rings"] > locked["rings"]


def test_the_grain_along_x_exchanges_the_sides():
    along, across = (Piece.cut(Cell(grain=grain), size) for grain, size in (("y", (60, 90)), ("x", (90, 60))))
    np.testing.assert_allclose(across.size_mm, np.array(along.size_mm)[[1, 0, 2]], atol=1e-9)
    assert across.links == along.links


def test_the_facts_of_a_ring_agree_with_each_other_and_with_the_table():
    words = ("ring", "--inner", 9, "--wire", 1)
    facts = json.loads(run("rve", *words, "--json").output)
    mass = 7.85e-6 * 2.0 * np.pi**2 * 5.0 * 0.25
    assert facts["ring_mass_kg"] == pytest.approx(mass)
    assert facts["wire_length_mm"] == pytest.approx(10.0 * np.pi)
    mesh = facts["mesh"]["pulled_along_grain"]
    assert 1e3 / mesh["cells_per_m_across_grain"] == pytest.approx(11.0)
    assert 1e3 / mesh["cells_per_m_along_grain"] == pytest.approx(12.646069623526)
    assert mesh["mass_kg_per_m2"] == pytest.approx(2.7848, abs=1e-4)
    assert facts["slack_clearance_mm"] == pytest.approx(Piece.cut(Cell(), (60, 60)).clearance_mm, rel=1e-6)
    thick = facts["thickest_wire_at_this_inner_mm"]
    Cell.of(inner=9, wire=0.9999 * thick)
    with pytest.raises(InputError, match="too thick"):
        Cell.of(inner=9, wire=1.0001 * thick)
    told = run("rve", *words, "--grain", "x").output
    assert "AR 9)" in told
    assert "pulled along grain: a metre has 90.91 cells across and 79.08 along the grain" in told


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--size 9x9", "--size = 9 x 9: has no two linked rings"),
        ("--size 60x0", "--size = 60 x 0: is no width and height"),
        ("--size 60", "--size = '60': give finite numbers WIDTH,HEIGHT"),
        ("--size 6e4x6e4", "has more than 100000 rings; ask for a smaller piece"),
        ("--size 60x60 --clearance 9", "--clearance = 9: leaves no wire, since centre lines of rings are only 2.51 mm"),
        ("--size 60x60 --clearance -1", "--clearance = -1: is no length in mm"),
        ("--size 60x60 --load 45,99", "a principal line load is negative"),
    ],
)
def test_pieces_that_cannot_be_are_refused_in_a_sentence(words, said, tmp_path):
    done = run("rve", "export", "--out", tmp_path / "a.3mf", *words.split(), codes=[1, 2])
    assert said in done.output
    assert not list(tmp_path.iterdir())
    assert (
        "give a name that ends in .3mf or .glb or .stl"
        in run("rve", "export", "--out", tmp_path / "a.obj", "--size", "60x60", codes=[2]).output
    )
