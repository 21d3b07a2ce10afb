"""Back to the rings: poses against locked states, geometry against affine curtains, forces against statics."""

import csv
import json
from dataclasses import replace

import meshio
import numpy as np
import pytest
from click.testing import CliRunner

from homogenize import default_law
from macro_fem import localize
from macro_fem.cli import main
from macro_fem.output import weave_of
from macro_fem.rings import Curtain, Told, curtain_of, find_sites, place_rings, turns
from rve import Cell, DirectOptions, InputError
from rve.common import checksum
from rve.geometry import SIX_IN_ONE, cauchy_line_load, deformation_gradient, find_contacts, lattice_strain, second_pk
from rve.placed import (
    DrawnRings,
    axes_of_weave,
    cell_forces,
    fit_rings,
    largest_forces,
    locked_arrangements,
    nearest_poses,
    shares,
)
from rve.solve import locked_block

CELL = Cell()
WEIGHTS = np.array([1.0, 2.0, 1.0])
ALONG, AROUND = 24, 8
"""Cells of a drawn ring along its wire and around it."""


@pytest.fixture(scope="module")
def states():
    return locked_arrangements(CELL)


@pytest.fixture(scope="module")
def table(states):
    """Locked states of loads that lie between those that arrangements are interpolated from: pose, E, S."""
    alpha, beta = (x.ravel() for x in np.meshgrid([-38.0, -7.0, 5.0, 22.0, 40.0], [5.0, 25.0, 50.0, 65.0, 85.0]))
    block = locked_block(alpha, beta, CELL, DirectOptions())
    found, s = block.found, block.s
    E = lattice_strain(found.pose.lattice, states.sides)[0]
    return found.pose, E, second_pk(deformation_gradient(E), s), s


def is_admissible(found, cell):
    contacts = find_contacts(found.pose, cell.weave, cell.wire, 0.6)
    assert contacts.min_gap.min() >= -1e-9
    assert contacts.links_intact.all()
    np.testing.assert_allclose(contacts.min_gap * cell.r1, found.gap_mm, atol=1e-12)


@pytest.mark.slow
def test_a_locked_strain_gives_back_the_locked_rings(states, table):
    pose, E, _, _ = table
    found = nearest_poses(E, CELL, states)
    assert (found.status == "met").all()
    assert np.abs(found.E - E).max() < 1e-4
    assert np.abs(shares(found.pose) - shares(pose)).max() < 1e-4
    # The tilts of rings that slide on each other are softer than the strain: 1e-4 of strain turns them by 1e-2.
    assert np.abs(found.pose.normals - pose.normals).max() < 1e-2
    is_admissible(found, CELL)
    again = nearest_poses(states.E, CELL, states)
    assert np.abs(again.E - states.E).max() < 1e-4
    assert np.abs(again.pose.normals - states.pose.normals).max() < 2e-3


def test_too_large_a_strain_comes_back_to_the_locked_state_it_left_along_the_normal(states, table):
    """Springs find by projection on the admissible strains what line loads find by equilibrium."""
    _, E, S, _ = table
    normal = S / np.sqrt(S**2 @ WEIGHTS)[:, None]
    found = nearest_poses(E + 0.02 * normal, CELL, states)
    assert (found.status == "beyond").all()
    assert np.abs(found.E - E).max() < 5e-6
    largest = 0.5 * (normal[:, 0] + normal[:, 2]) + np.hypot(0.5 * (normal[:, 0] - normal[:, 2]), normal[:, 1])
    np.testing.assert_allclose(found.short, 0.02 * largest, atol=1e-6)
    assert found.fold.max() < 1e-6
    is_admissible(found, CELL)


@pytest.mark.slow
def test_strains_inside_are_met_and_all_others_get_an_admissible_pose(states, table):
    _, E, _, _ = table
    rng = np.random.default_rng(5)
    share = rng.dirichlet(np.ones(len(E)), 20)
    inside = nearest_poses(0.9 * share @ E, CELL, states)
    assert (inside.status == "met").all()
    assert np.maximum(inside.short, inside.fold).max() < 1e-3
    wild = nearest_poses(rng.uniform(-0.5, 0.8, (20, 3)) * [1.0, 0.5, 1.0], CELL, states)
    is_admissible(wild, CELL)
    assert np.isfinite(wild.E).all()
    assert {"beyond", "folded"} <= set(wild.status)


def test_a_mesh_drawn_together_hangs_in_folds(states):
    """Pulled along x the mesh can be no wider than locked: what the curtain lacks in width is the fold, to 2e-3."""
    pose = locked_block(np.array([0.0]), np.array([2.0]), CELL, DirectOptions()).found.pose
    E = lattice_strain(pose.lattice, states.sides)[0]
    found = nearest_poses(E - [0.0, 0.0, 0.03], CELL, states)
    assert found.status.tolist() == ["folded"]
    assert found.fold[0] == pytest.approx(0.03, abs=2e-3)
    assert found.short[0] < 1e-3
    is_admissible(found, CELL)


@pytest.mark.slow
def test_the_mirror_image_of_a_strain_has_the_mirror_image_of_the_rings(states, table):
    _, E, _, _ = table
    found, image = (nearest_poses(E * [1.0, sign, 1.0], CELL, states) for sign in (1.0, -1.0))
    assert np.abs(found.E * [1.0, -1.0, 1.0] - image.E).max() < 1e-12
    assert np.abs(found.pose.normals * [-1.0, 1.0, 1.0] - image.pose.normals).max() < 1e-12
    assert found.solves < len(E) + 1
    is_admissible(image, CELL)


def sheet(F, E, S, turn, count=2):
    """A square of 2 count^2 triangles with uniform deformation F, strain E, stress S in weave axes, all turned."""
    X = np.stack(np.meshgrid(*[np.linspace(-40.0, 40.0, count + 1)] * 2), axis=-1).reshape(-1, 2)
    a = (np.arange(count) + (count + 1) * np.arange(count)[:, None]).ravel()
    triangles = np.concatenate([np.stack([a, a + 1, a + count + 2], 1), np.stack([a, a + count + 2, a + count + 1], 1)])
    n = len(triangles)
    rest = np.tile(E, (n, 1)), np.tile(S, (n, 1)), np.ones(n), np.full(n, 2, dtype=int)
    return Curtain(X @ turn.T, X @ F.T @ turn.T, triangles, *rest)


@pytest.mark.parametrize("hang", [0.0, 90.0, 33.0])
@pytest.mark.parametrize("grain", ["x", "y"])
def test_a_uniform_curtain_gets_the_rings_of_one_locked_cell(states, table, hang, grain):
    """Every gap and every link of hundreds of rings in space, for a strained, sheared, turned sheet of turned weave."""
    _, E, S, _ = table
    found = nearest_poses(E[3:4], CELL, states)
    angle = np.radians(20.0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    F = turn @ deformation_gradient(found.E)[0]
    cell = replace(CELL, grain=grain)
    axes = axes_of_weave(cell, hang)
    curtain = sheet(F, E[3], S[3], axes)
    sites = find_sites(curtain, cell, states.sides, axes)
    rings = place_rings(curtain, sites, found, np.zeros(len(sites.X), dtype=int), cell, axes)
    density = 2.0 / (25.0 * states.sides[0] * states.sides[1])
    assert len(sites.X) == pytest.approx(80.0**2 * density, rel=0.15)
    fit = fit_rings(sites.index, *rings, cell)
    assert fit.links == fit.linked > 100
    assert not fit.broken.any()
    assert fit.gap_mm.min() == pytest.approx(found.gap_mm[0], abs=1e-9)
    np.testing.assert_allclose(np.linalg.norm(rings[1], axis=1), 1.0, atol=1e-12)


@pytest.mark.parametrize("hang", [0.0, 33.0, -20.0])
@pytest.mark.parametrize("grain", ["x", "y"])
def test_the_grain_runs_where_the_weave_is_turned_to(states, grain, hang):
    """A weave turned by `hang`: rings interlace along the turned x or y axis, and lean along it, b_y apart."""
    cell = replace(CELL, grain=grain)
    turned = np.radians(hang) + (0.0 if grain == "x" else 0.5 * np.pi)
    along = np.array([np.cos(turned), np.sin(turned)])
    axes = axes_of_weave(cell, hang)
    flat = sheet(np.eye(2), np.zeros(3), np.zeros(3), np.eye(2))
    sites = find_sites(flat, cell, states.sides, axes)
    at = {tuple(index): X for index, X in zip(sites.index.tolist(), sites.X, strict=True)}
    step = at[0, 0, 1] - at[0, 0, 0]
    np.testing.assert_allclose(step, 5.0 * states.sides[1] * along, atol=1e-9)
    rest = nearest_poses(np.zeros((1, 3)), cell, states)
    normal = place_rings(flat, sites, rest, np.zeros(len(sites.X), dtype=int), cell, axes)[1][:, :2]
    assert np.abs(normal @ along).min() > 0.3
    assert np.abs(normal @ [-along[1], along[0]]).max() < 1e-3


def test_a_ring_taken_out_of_the_net_is_missed(states, table):
    """Four links lost, five rings concerned, and a ring pushed through its neighbour's wire has a negative gap."""
    _, E, S, _ = table
    found = nearest_poses(E[3:4], CELL, states)
    curtain = sheet(deformation_gradient(found.E)[0], E[3], S[3], np.eye(2))
    sites = find_sites(curtain, CELL, states.sides, np.eye(2))
    centre, normal = place_rings(curtain, sites, found, np.zeros(len(sites.X), dtype=int), CELL, np.eye(2))
    whole = fit_rings(sites.index, centre, normal, CELL)
    inner = int(np.argmin((sites.X**2).sum(axis=1)))
    out = centre.copy()
    out[inner, 2] += 15.0
    apart = fit_rings(sites.index, out, normal, CELL)
    assert (whole.linked - apart.linked, int(apart.broken.sum())) == (4, 5)
    near = centre.copy()
    near[inner, 2] += 0.3
    assert fit_rings(sites.index, near, normal, CELL).gap_mm[inner] < -0.05


@pytest.mark.parametrize(("grain", "hang"), [("y", 0.0), ("x", 33.0)])
def test_a_plane_curtain_turned_in_space_has_the_turned_rings(states, table, grain, hang):
    """Centres, normals and the frame of the worst cell follow a rotation of space; gaps and links stay."""
    _, E, S, _ = table
    cell = replace(CELL, grain=grain)
    axes = axes_of_weave(cell, hang)
    found = nearest_poses(E[:8], cell, states)
    flat = sheet(deformation_gradient(E[3:4])[0], E[3], S[3], axes)
    sites = find_sites(flat, cell, states.sides, axes)
    Q = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    Q *= np.linalg.det(Q)
    turned = replace(flat, x=np.pad(flat.x, ((0, 0), (0, 1))) @ Q.T + [3.0, 50.0, -70.0])
    rings = place_rings(flat, sites, found, sites.triangle, cell, axes)
    moved = place_rings(turned, sites, found, sites.triangle, cell, axes)
    np.testing.assert_allclose(moved[0], rings[0] @ Q.T + [3.0, 50.0, -70.0], atol=1e-10)
    np.testing.assert_allclose(moved[1], rings[1] @ Q.T, atol=1e-12)
    here = turns(flat, sites.triangle, found.E[sites.triangle], axes)
    np.testing.assert_allclose(turns(turned, sites.triangle, found.E[sites.triangle], axes), Q @ here, atol=1e-12)
    here, there = (fit_rings(sites.index, *one, cell).gap_mm for one in (rings, moved))
    np.testing.assert_allclose(there, here, atol=1e-9)


def test_a_sheet_bent_to_a_cylinder_keeps_its_links(states, table):
    """Normals of the sheet are those of the cylinder, and all rings that were linked in the plane are linked on it."""
    _, E, _, _ = table
    found = nearest_poses(E[3:4], CELL, states)
    flat = sheet(deformation_gradient(found.E)[0], np.zeros(3), np.zeros(3), np.eye(2), 16)
    radius = 80.0
    angle = flat.x[:, 0] / radius
    bent = replace(flat, x=np.column_stack([radius * np.sin(angle), flat.x[:, 1], radius * np.cos(angle)]))
    sites = find_sites(bent, CELL, states.sides, np.eye(2))
    row = np.zeros(len(sites.X), dtype=int)
    plane, rings = (place_rings(one, sites, found, row, CELL, np.eye(2)) for one in (flat, bent))
    normal = turns(bent, sites.triangle, found.E[row], np.eye(2))[:, :, 2]
    outwards = rings[0] * [1.0, 0.0, 1.0]
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    assert (normal * outwards).sum(axis=1).min() > np.cos(0.06)  # half a facet is 0.05 wide at most
    before, after = (fit_rings(sites.index, *one, CELL) for one in (plane, rings))
    assert before.links == after.links == before.linked == after.linked > 150
    assert not after.broken.any()


def test_a_cell_drawn_to_a_line_takes_the_normal_of_its_neighbours():
    """A crease of no width between two halves of a sheet at right angles stands between their normals."""
    X = np.array([[0.0, 0.0], [0.0, 9.0], [5.0, 0.0], [5.0, 9.0], [6.0, 0.0], [6.0, 9.0], [11.0, 0.0], [11.0, 9.0]])
    triangles = np.array([[0, 2, 1], [2, 3, 1], [2, 4, 3], [4, 5, 3], [4, 6, 5], [6, 7, 5]])
    x = np.column_stack([np.minimum(X[:, 0], 5.0), X[:, 1], -np.maximum(X[:, 0] - 6.0, 0.0)])
    n = len(triangles)
    curtain = Curtain(X, x, triangles, np.zeros((n, 3)), np.zeros((n, 3)), np.ones(n), np.ones(n, int))
    normal = turns(curtain, np.arange(n), np.zeros((n, 3)), np.eye(2))[:, :, 2]
    np.testing.assert_allclose(normal[:2], [[0.0, 0.0, 1.0]] * 2, atol=1e-12)
    np.testing.assert_allclose(normal[4:], [[1.0, 0.0, 0.0]] * 2, atol=1e-12)
    assert np.abs(normal[2:4, 1]).max() < 1e-12
    assert normal[2:4, [0, 2]].min() > 0.1


def test_every_lattice_point_belongs_to_one_triangle():
    curtain = sheet(np.eye(2), np.zeros(3), np.zeros(3), np.eye(2))
    sites = find_sites(curtain, CELL, (2.0, 2.0), np.eye(2))
    assert len(np.unique(sites.index, axis=0)) == len(sites.index)
    # Points (10 i, 10 j) with |x|, |y| <= 40, and those shifted by half a cell.
    assert (sites.index[:, 0] == 0).sum() == 81
    assert (sites.index[:, 0] == 1).sum() == 64
    window = find_sites(curtain, CELL, (2.0, 2.0), np.eye(2), (0.0, 0.0, 10.0, 20.0))
    assert (window.index[:, 0] == 0).sum() == 6


def test_contact_forces_add_up_to_the_line_load_and_balance_every_ring(table):
    _, _, _, s = table
    for load in 3.7 * s[::4]:
        found = cell_forces(load, CELL)
        assert found.status == "converged"
        np.testing.assert_allclose(found.virial, load, atol=1e-8 * np.abs(load).max())
        push = found.force[:, None] * found.normal
        # Contacts are listed once per lattice: ring a feels -push, ring b, seen from its own centre, +push.
        centre_a = (found.a[:, 0] == 1)[:, None] * _centre_of_second(found)
        arm_a = found.point - centre_a
        arm_b = arm_a - found.branch
        for ring in (0, 1):
            a, b = found.a[:, 0] == ring, found.b[:, 0] == ring
            np.testing.assert_allclose(push[b].sum(axis=0) - push[a].sum(axis=0), 0.0, atol=1e-8)
            moment = np.cross(arm_b, push)[b].sum(axis=0) - np.cross(arm_a, push)[a].sum(axis=0)
            np.testing.assert_allclose(moment, 0.0, atol=1e-7)


def _centre_of_second(found):
    """Centre of ring (1, 0, 0) from ring (0, 0, 0): the branch of their contact."""
    row = np.flatnonzero((found.a == 0).all(axis=1) & (found.b == [1, 0, 0]).all(axis=1))[0]
    return found.branch[row]


def test_six_in_one_has_poses_too():
    cell = Cell(8.0, 1.0, SIX_IN_ONE)
    states = locked_arrangements(cell)
    found = nearest_poses(states.E[:12], cell, states)
    assert (found.status == "met").all()
    is_admissible(found, cell)


def test_tubes_lie_on_the_torus():
    points, quads = DrawnRings(np.array([[1.0, 2.0, 3.0]]), np.array([[0.0, 0.6, 0.8]]), 5.0, 0.5).tubes(12, 6)
    d = points - [1.0, 2.0, 3.0]
    height = d @ [0.0, 0.6, 0.8]
    around = np.sqrt((d**2).sum(axis=1) - height**2) - 5.0
    np.testing.assert_allclose(np.hypot(around, height), 0.5, atol=1e-12)
    assert sorted(np.bincount(quads.ravel())) == [4] * 72


# The whole way, by the command line.


def curtain_folder(folder, scene):
    """The files of macro_fem for a scene."""
    (folder / "scene.toml").write_text(scene)
    arguments = ["run", str(folder / "scene.toml"), "--out", str(folder), "--no-picture"]
    assert CliRunner().invoke(main, arguments).exit_code == 0
    return folder


@pytest.fixture(scope="module")
def hung(tmp_path_factory):
    """A small curtain hung by its corners."""
    scene = '[curtain]\nwidth = 70.0\nheight = 60.0\n[mesh]\ncells = 4\n[support]\nkind = "corners"\n'
    return curtain_folder(tmp_path_factory.mktemp("hung"), scene)


@pytest.mark.parametrize("weave", [pytest.param("y", marks=pytest.mark.slow), "x"])
def test_a_hanging_strip_has_the_rings_of_one_locked_cell(tmp_path, weave):
    """Hung along y from the held top, or along x from a rail, the strain is one locked state everywhere.

    Every drawn ring then clears its neighbours by what its cell allows, and the rings of the top carry the weight.
    """
    kind = "top" if weave == "y" else "rail"
    curtain = f"[curtain]\nwidth = 50.0\nheight = 60.0\nweave_angle = {90.0 if weave == 'x' else 0.0}\n"
    scene = f'{curtain}[mesh]\ncells = 4\n[support]\nkind = "{kind}"\n'
    folder = curtain_folder(tmp_path, scene)
    result = run(folder / "curtain.vtu", "--out", folder / "rings", "--no-picture")
    assert result.exit_code == 0, result.output
    summary = json.loads((folder / "rings" / "localize.json").read_text())
    assert list(summary["cells_by_status"]) == ["met"]
    assert summary["links_intact"] == summary["links"] > 30
    assert summary["drawn_gap_mm_quantiles_0_5_25_50"]["met"][0] > -1e-3
    sheet_load = json.loads((folder / "summary.json").read_text())["total_load_N"][1] / -50.0
    largest = summary["worst_cell"]["largest_principal_line_load_N_per_mm"]
    assert 0.7 * sheet_load < largest < sheet_load
    pull = summary["worst_cell"]["cauchy_line_load_11_12_22_N_per_mm"]
    # A pull along one axis of the weave: per reference length it is the line load above.
    assert abs(pull[1]) < 1e-2 * max(pull)


def run(*arguments):
    return CliRunner().invoke(main, ["localize", *(str(a) for a in arguments)])


@pytest.mark.slow
def test_rings_of_a_curtain_from_the_command_line(hung, tmp_path):
    result = run(hung / "curtain.vtu", "--out", tmp_path / "rings", "--no-picture")
    assert result.exit_code == 0, result.output
    assert "not solved" not in result.output
    out = tmp_path / "rings"
    assert {p.name for p in out.iterdir()} == {"rings.vtu", "worst_cell.csv", "localize.json"}
    summary = json.loads((out / "localize.json").read_text())
    assert summary["rings"] == pytest.approx(70.0 * 60.0 * 2.0 / (11.0 * 12.646), rel=0.15)
    assert summary["smallest_gap_in_a_cell_mm"] >= 0.0
    assert 0.9 * summary["links"] < summary["links_intact"] <= summary["links"]
    assert sum(summary["cells_by_status"].values()) == summary["cells"] <= 64
    assert summary["largest_strain_short"] < 2e-3
    worst = summary["worst_cell"]
    both = (worst[f"{name}_11_12_22_N_per_mm"] for name in ("line_load_of_contacts", "cauchy_line_load"))
    np.testing.assert_allclose(*both, atol=1e-8)
    with (out / "worst_cell.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == worst["contacts"] > 0
    assert max(float(row["force_N"]) for row in rows) == pytest.approx(worst["largest_force_N"])
    import pyvista

    drawn = pyvista.read(out / "rings.vtu")
    assert drawn.n_cells == ALONG * summary["rings"]
    x = np.asarray(drawn.points)[:, 0]
    # The curtain and its lattice are symmetric, so the rings are.
    assert x.min() + x.max() == pytest.approx(70.0, abs=0.1)


@pytest.mark.slow
def test_a_window_and_the_picture(hung, tmp_path):
    result = run(hung / "curtain.vtu", "--out", tmp_path, "--window", "0,0,40,40", "--tubes")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "rings.png").read_bytes()[:4] == b"\x89PNG"
    summary = json.loads((tmp_path / "localize.json").read_text())
    assert summary["worst_cell"]["reference_mm"] == pytest.approx([20.0, 20.0], abs=20.0)  # in the window
    points = meshio.read(tmp_path / "rings.vtu").points
    assert len(points) == summary["rings"] * ALONG * AROUND
    assert points[:, 0].max() < 60.0


def told(**summary):
    """A function that writes a summary which lists the mesh file of its folder."""

    def tell(folder):
        listed = summary | {"files": {"curtain.vtu": checksum(folder / "curtain.vtu")}}
        (folder / "summary.json").write_text(json.dumps(listed))

    return tell


def without_strains(folder):
    """Another mesh of the same run, such as that of bodies."""
    data = meshio.read(folder / "curtain.vtu")
    data.cell_data.pop("E_11_12_22")
    data.write(folder / "curtain.vtu")
    told(hang_deg=0.0)(folder)


def unlisted(folder):
    """A record of version 0.1, which has no checksums."""
    known = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").write_text(json.dumps({key: known[key] for key in known if key != "files"}))


def added(folder):
    """Another file of the same content."""
    (folder / "curtain.vtu").write_bytes((folder / "curtain.vtu").read_bytes() + b"\n")


RINGS = {"r1_mm": 5, "r2_mm": 0.5, "b_x_mm": 11.0, "b_y_mm": 14.0}
BAD = (
    (without_strains, "E_11_12_22"),
    (told(hang_deg=0, rings={"r1_mm": 5}), "does not tell r2_mm, b_x_mm, b_y_mm of the rings"),
    (told(hang_deg=0, rings=RINGS), "of no known weave"),
    (unlisted, "checksum is none of those"),
    (added, "does not belong to"),  # another run's
)


def copied(hung, folder):
    for name in ("curtain.vtu", "summary.json"):
        (folder / name).write_bytes((hung / name).read_bytes())
    return json.loads((folder / "summary.json").read_text())


@pytest.mark.parametrize(("spoil", "words"), BAD, ids=[words for _, words in BAD])
def test_bad_files_are_one_sentence(hung, tmp_path, spoil, words):
    copied(hung, tmp_path)
    spoil(tmp_path)
    result = run(tmp_path, "--out", tmp_path / "rings")
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("Error: ")
    assert result.stderr.count("\n") == 1
    assert words in result.stderr
    assert not (tmp_path / "rings").exists()


def test_line_loads_are_averaged_by_area():
    """Two triangles, the second of three times the area: their shared corners see (1 * 4 + 3 * 8) / 4 = 7."""
    X = np.array([[0.0, 0], [1, 0], [0, 1], [3, 1]])
    loads = np.array([[4.0, 0, 0], [8.0, 0, 0]])
    data = {"E_11_12_22": [np.zeros((2, 3))], "S_11_12_22_N_per_mm": [loads], "line_load_1_N_per_mm": [loads[:, 0]]}
    data |= {"state_0_slack_1_wrinkled_2_taut": [np.ones(2)]}
    cells, still = [("triangle", np.array([[0, 1, 2], [1, 3, 2]]))], {"displacement_mm": np.zeros((4, 3))}
    curtain = curtain_of(meshio.Mesh(np.pad(X, ((0, 0), (0, 1))), cells, still, data), Told(0.0, None), "two")
    np.testing.assert_allclose(curtain.S[:, 0], [(4 + 7 + 7) / 3, (7 + 8 + 7) / 3])


@pytest.mark.slow
def test_rings_of_a_window_as_metal_throw_a_soft_shadow(hung, tmp_path, monkeypatch):
    """Grey metal, bright where it mirrors a lamp, before a white surface on which the shadow has every tone."""
    from PIL import Image

    ask = (tmp_path / "rings", "--no-picture", "--render", "--window", "0,0,30,30")
    assert run(hung / "curtain.vtu", "--out", *ask).exit_code == 0
    image = np.asarray(Image.open(tmp_path / "rings" / "render.png")).astype(int)
    assert np.ptp(image, axis=2).max() < 40
    tones = np.bincount(image.mean(axis=2).astype(int).ravel(), minlength=256) / image[..., 0].size
    assert tones[:100].sum() > 0.02
    assert tones[250:].sum() > 0.1
    assert (tones[150:250] > 0.0).all()
    monkeypatch.setattr("macro_fem.rings.field.MOST_RENDERED", 3)
    refused = run(hung / "curtain.vtu", "--out", *ask)
    assert (refused.exit_code, "give --window" in refused.output) == (2, True)


def test_rings_of_a_curtain_that_is_not_solved_say_so(hung, tmp_path):
    (tmp_path / "summary.json").write_text(json.dumps(copied(hung, tmp_path) | {"status": "iterations"}))
    done = run(tmp_path, "--out", tmp_path / "rings", "--no-picture", "--window", "0,0,30,30")
    assert done.exit_code == 0, done.output
    assert "not solved: its status is iterations" in done.output
    assert json.loads((tmp_path / "rings" / "localize.json").read_text())["curtain_status"] == "iterations"


@pytest.mark.parametrize(("alpha", "beta"), [(30.0, 4.0), (20.0, 30.0), (0.0, 80.0)])
def test_the_largest_force_is_that_of_the_cell(alpha, beta):
    """At (30, 4) the two contacts of a pair carry forces ten times apart: the larger one counts."""
    s = 0.7 * cauchy_line_load([alpha], [beta])
    assert largest_forces(s, CELL).max() == pytest.approx(cell_forces(s[0], CELL).force.max(), rel=1e-6)


@pytest.mark.slow
def test_what_is_slack_beside_a_load_changes_no_force(table):
    """Rings bear S where it locks them, also in cells that are drawn together beside it."""
    _, E, S, s = table
    told = Told(**weave_of(default_law().cell, 0.0).to_dict())
    strains = E[3], E[3] - [0.3, 0.0, 0.15]
    curtains = [sheet(deformation_gradient(one[None])[0], one, S[3], np.eye(2)) for one in strains]
    locked, slack = (localize(replace(one, told=told)).contact_force_N.max() for one in curtains)
    assert [locked, slack] == pytest.approx([cell_forces(s[3], CELL).force.max()] * 2, rel=0.04)


@pytest.mark.slow
def test_the_ring_at_a_hook_is_told_beside_the_forces_away_from_supports(tmp_path):
    """A heavy bar on two corners: two rings share half of the load each; cells of rings take no more on fine meshes."""
    scene = """[curtain]\nwidth = 120\nheight = 100\nweave_angle = 45\n[mesh]\ncells = 24\n[support]\nkind = "corners"
rings_per_hook = 2\n[load.bar]\nmass = 3.0\n"""
    folder = curtain_folder(tmp_path, scene)
    (corners,) = json.loads((folder / "summary.json").read_text())["support_forces"]
    result = run(folder, "--out", folder / "rings", "--no-picture")
    assert result.exit_code == 0, result.output
    found = json.loads((folder / "rings" / "localize.json").read_text())
    force = max(np.hypot(*one["force_N"]) for one in corners["points"]) / 2.0
    assert found["ring_at_support"]["support"] == "support 1 (corners)"
    assert found["ring_at_support"]["force_N"] == pytest.approx(force, rel=1e-12)
    most = max(found["largest_contact_force_N"], found["worst_cell"]["largest_force_N"])
    assert force > max(0.25 * 3.0 * 9.81, 0.9 * most)
    assert f"forces between rings away from supports: at most {most:.4g} N" in result.output
    assert f"the ring at support 1 (corners) that takes most is pulled by {force:.4g} N" in result.output


@pytest.mark.parametrize("window", [(0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 1.0), (np.nan, 0.0, 1.0, 1.0), "all"])
def test_a_window_that_is_no_rectangle_is_refused_in_a_sentence(window):
    with pytest.raises(InputError, match="window = "):
        localize("no such curtain", window)
