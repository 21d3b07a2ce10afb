"""Inputs that once were believed, ended in a traceback, or asked for all memory and time: each is refused by name."""

import base64
import json
import zlib

import numpy as np
import pytest
from click.testing import CliRunner

from homogenize.cli import main as homogenize
from homogenize.io import load_law, save_law
from macro_fem.cli import main as macro_fem
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.schema import load_scene, read_scene
from rve.cli import main as rve
from rve.common.errors import InputError
from rve.common.storage.reading import MOST_JSON_BYTES
from rve.directions import parse_angles
from rve.localization.curtain import read_curtain, read_weave
from rve.table import read_table
from tests.fuzz.targets import TARGETS, law, make_table, read_checkpoint, read_mesh_of, square


def changed(value, path, new):
    """A copy of nested dictionaries and lists with one value replaced."""
    if not path:
        return new
    copy = value.copy()
    copy[path[0]] = changed(value[path[0]], path[1:], new)
    return copy


@pytest.fixture
def law_record(tmp_path):
    path = tmp_path / "law.json"
    save_law(law(), path)
    return path, json.loads(path.read_text())


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("cell", "r1_mm"), -5, "cell r1_mm = -5: must be at least 1e-09"),
        (("cell", "r1_mm"), float("nan"), "cell r1_mm = nan: is not a finite number"),
        (("cell", "r1_mm"), "5", "cell r1_mm = '5': is not a number"),
        (("cell", "r2_mm"), 6.0, "cell r2_mm = 6: must be less than r1_mm = 5"),
        (("cell", "b_x_mm"), 1e308, "cell b_x_mm = 1e+308: must be at most 1e+09"),
        (("cell", "b_x_mm"), 1e6, "cell b_x_mm = 1e+06: must be from r2_mm = 0.5 to 8 r1_mm = 40"),
        (("cell", "areal_mass_kg_per_m2"), -3, "cell areal_mass_kg_per_m2 = -3: must be greater than 0"),
        (("cell", "colour"), 3, "cell colour = 3: unknown key"),
        (("parameters", "stiffness_N_per_mm", 0), [float("nan"), 0, 0], "not a finite number"),
        (("parameters", "stiffness_N_per_mm", 0), [-1000.0, 0.0, 0.0], "is not positive definite"),
        (("parameters", "stiffness_N_per_mm", 0), [0.0, 0.0, 0.0], "is not positive definite"),
        (("parameters", "stiffness_N_per_mm", 0), [1000.0, 900.0, 0.0], "must be symmetric"),
        (("parameters", "S", 3), [0.1, 0.2], "rows have different lengths"),
        (("parameters", "S", 3), [-0.5, 0.0, 0.2], "half-space 3, S = [-0.5, 0.0, 0.2], is not tensile"),
        (("parameters", "h", 3), 1e300, "must be at most 1000"),
        (("parameters", "h"), [0.1, 0.2], "has 2 numbers for 17 half-spaces"),
        (("provenance", "sampled_loads"), [[1, 2], [3]], "sampled_loads"),
        (("kind",), ["net"], "kind = ['net']"),
    ],
)
def test_numbers_of_a_law_are_checked(law_record, path, value, words):
    file, record = law_record
    if path[0] == "provenance" or path[-1] == "colour":
        record = changed(record, path[:1], record[path[0]] | {path[-1]: value})
    else:
        record = changed(record, path, value)
    file.write_text(json.dumps(record))
    for call in (lambda: load_law(file), lambda: load_law(str(file))):
        with pytest.raises(InputError) as error:
            call()
        assert str(error.value).startswith(f"{file}: ")
        assert words in str(error.value)
    result = CliRunner().invoke(homogenize, ["support", str(file), "--S", "1,0,0"])
    assert result.exit_code == 2


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("r1_mm", -5),
        ("r1_mm", float("nan")),
        ("r2_mm", True),
        ("b_x_mm", 1e308),
        ("b_y_mm", "12"),
        ("density_kg_per_mm3", 0),
        ("areal_mass_kg_per_m2", -3),
        ("areal_mass_kg_per_m2", 2.0),  # of no whole number of rings of the density beside it
    ],
)
def test_numbers_of_a_sidecar_are_checked(tmp_path, key, value):
    make_table(tmp_path)
    sidecar = tmp_path / "table.json"
    sidecar.write_text(json.dumps(json.loads(sidecar.read_text()) | {key: value}))
    with pytest.raises(InputError, match=rf"table\.json: {key} = "):
        read_table(tmp_path / "table.csv")


@pytest.mark.parametrize(
    ("keys", "value", "words"),
    [
        (("rings", "r1_mm"), -5, "r1_mm = -5"),
        (("rings", "r2_mm"), 0.0, "r2_mm = 0.0"),
        (("rings", "b_x_mm"), 1e308, "b_x_mm = 1e[+]308"),
        (("hang_deg",), 1e9, "hang_deg = 1000000000"),
    ],
)
def test_numbers_of_a_summary_are_checked(tmp_path, keys, value, words):
    TARGETS["curtain-text"].make(tmp_path)
    path = tmp_path / "summary.json"
    path.write_text(json.dumps(changed(json.loads(path.read_text()), keys, value)))
    with pytest.raises(InputError, match=rf"summary\.json: .*{words}"):
        read_weave(tmp_path / "curtain.vtu", None, None, None)


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a":' * 100_000, '{"kind": "net", "cell": ' + "[" * 100_000])
def test_deep_json_is_refused(tmp_path, text):
    path = tmp_path / "deep.json"
    path.write_text(text)
    with pytest.raises(InputError, match="nested too deeply"):
        load_law(path)


def test_deep_toml_is_refused(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text("[curtain]\nwidth = " + "[" * 100_000)
    result = CliRunner().invoke(macro_fem, ["run", str(path), "--out", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert "nested too deeply" in result.output
    path.write_text("x = 1\n" * 200_000)
    with pytest.raises(InputError, match="larger than 1,000,000 bytes"):
        load_scene(path)


def test_a_key_that_is_there_twice_is_refused(law_record):
    file, _ = law_record
    file.write_text(file.read_text().replace('"r1_mm":', '"r1_mm": 7, "r1_mm":'))
    with pytest.raises(InputError, match="the key r1_mm occurs twice"):
        load_law(file)


def test_a_file_that_is_too_large_is_not_read(tmp_path):
    with (tmp_path / "law.json").open("wb") as file:
        file.truncate(MOST_JSON_BYTES + 1)
    with pytest.raises(InputError, match="larger than 32,000,000 bytes"):
        load_law(tmp_path / "law.json")
    with pytest.raises(InputError, match="larger than"):
        load_law("/dev/zero")


REFUSED = (
    "nas",
    "bdf",
    "dat",
    "xml",
    "post",
    "su2",
    "xdmf",
    "off",
    "ply",
    "stl",
    "obj",
    "med",
    "e",
    "cgns",
    "h5m",
    "vtk",
)


@pytest.mark.parametrize("ending", REFUSED)
def test_only_tested_mesh_formats_are_offered(tmp_path, ending):
    (tmp_path / f"mesh.{ending}").write_bytes(b"")
    with pytest.raises(InputError, match=rf"files ending in \.{ending} are not read, only \.msh .* and|\.vtu"):
        read_mesh_of(f"mesh.{ending}")(tmp_path)


def vtu_of(points, cells, data):
    """A VTU that states these counts and holds these bytes, compressed, as its points."""
    packed = zlib.compress(data, 9)
    head = base64.b64encode(np.array([1, len(data), 0, len(packed)], "<u4").tobytes())
    text = (head + base64.b64encode(packed)).decode()
    array = '<DataArray type="{}" Name="{}" NumberOfComponents="{}" format="binary">{}</DataArray>'
    zero = base64.b64encode(np.zeros(1, "<u4").tobytes()).decode()
    names = [("Int64", "connectivity"), ("Int64", "offsets"), ("UInt8", "types")]
    return (
        '<VTKFile type="UnstructuredGrid" byte_order="LittleEndian" compressor="vtkZLibDataCompressor">'
        f'<UnstructuredGrid><Piece NumberOfPoints="{points}" NumberOfCells="{cells}"><Points>'
        + array.format("Float64", "Points", 3, text)
        + "</Points><Cells>"
        + "".join(array.format(kind, name, 1, zero) for kind, name in names)
        + "</Cells></Piece></UnstructuredGrid></VTKFile>"
    )


@pytest.mark.parametrize(
    ("points", "size", "words"),
    [
        (10, 100_000_000, "states 100000000 bytes where its counts make 240"),
        (10_000_000_000, 240, "NumberOfPoints = 10000000000: must be from 0 to 8000000"),
        (-1, 240, "NumberOfPoints = -1"),
    ],
)
def test_a_vtu_that_inflates_is_refused_before_it_does(tmp_path, bounded_memory, points, size, words):
    (tmp_path / "mesh.vtu").write_text(vtu_of(points, 0, bytes(size)))
    with bounded_memory(80_000_000), pytest.raises(InputError) as error:
        read_mesh_of("mesh.vtu")(tmp_path)
    assert words in str(error.value)
    with pytest.raises(InputError):
        read_curtain(tmp_path / "mesh.vtu")


def test_a_vtu_with_more_arrays_than_its_size_allows_is_refused(tmp_path):
    text = vtu_of(8_000_000, 0, b"")
    extra = '<PointData><DataArray type="Float64" Name="a" NumberOfComponents="9" format="ascii"/></PointData>'
    (tmp_path / "mesh.vtu").write_text(text.replace("<Points>", extra + "<Points>"))
    with pytest.raises(
        InputError, match=r"its arrays would take 768,000,000 bytes, for a file of 752 at most 256,000,000"
    ):
        read_mesh_of("mesh.vtu")(tmp_path)


@pytest.mark.parametrize(
    ("old", "new"),
    [("2 16 1 16", "2 999999999999 1 16"), ("2 1 0 12", "2 1 0 999999999999"), ("2 21 1 21", "999999999999 21 1 21")],
)
def test_counts_of_a_gmsh_file_are_checked_against_it(tmp_path, bounded_memory, old, new):
    TARGETS["msh-4.1-text"].make(tmp_path)
    path = tmp_path / "mesh.msh"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with bounded_memory(200_000_000):
        if old == "2 16 1 16":  # the total is not needed; blocks have counts of their own
            read_mesh_of("mesh.msh")(tmp_path)
            return
        with pytest.raises(InputError, match="numbers are stated where"):
            read_mesh_of("mesh.msh")(tmp_path)


@pytest.mark.parametrize("name", [name for name in TARGETS if name.startswith(("msh", "vtu"))])
def test_every_offered_format_gives_the_same_square(name, tmp_path):
    TARGETS[name].make(tmp_path)
    mesh = TARGETS[name].read(tmp_path)
    points, _, _ = square("triangle")
    assert sorted(map(tuple, mesh.mesh.p.T.tolist())) == sorted(map(tuple, points[:, :2].tolist()))
    assert np.hypot(*np.ptp(mesh.mesh.p, axis=1)) == pytest.approx(np.hypot(3.0, 3.0))
    assert mesh.mesh.t.shape[1] == (9 if mesh.mesh.t.shape[0] == 4 else 18)
    assert len(mesh.edges["top"]) == 3


def test_a_checkpoint_of_too_many_numbers_is_refused(tmp_path):
    TARGETS["checkpoint"].make(tmp_path)
    path = tmp_path / "block-0000.json"
    content = json.loads(path.read_text())
    for name, value, words in (("lattice", [[1.0, 1.0, 0.0]] * 4, "must be 3 x 3"), ("R", [0.0, None, 1.0], "number")):
        path.write_text(json.dumps(content | {name: value}))
        with pytest.raises(InputError, match=f"block-0000.json: {name} = .*{words}"):
            read_checkpoint(tmp_path)


def test_load_directions_are_counted_before_they_are_made(tmp_path):
    result = CliRunner().invoke(
        rve, ["table", "--out", str(tmp_path / "t.csv"), "--alpha", "0:45:0.01", "--beta", "0:90:0.01"]
    )
    assert result.exit_code == 2
    assert "4501 values of alpha times 9001 of beta are more than 100000 load directions" in result.stderr
    with pytest.raises(InputError, match="from -360 to 360 degrees"):
        parse_angles("1e300", "--alpha")


def scene(**tables):
    base = {"curtain": {"width": 1000.0, "height": 1000.0, "areal_mass": 1.0}, "mesh": {"cells": 4}}
    return base | {"support": {"kind": "top"}} | tables


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        (scene(support={"kind": "hooks", "pitch": 1e-9}), "pitch = 1e-09: must be at least 1e-06"),
        (scene(curtain={"width": 1e308, "height": 1e308}), "width = 1e+308: must be at most 1e+09"),
        (scene(support=[{"kind": "top"}] * 1001), "has 1001 entries, at most 1000"),
        (scene(load={"point": [{"at": [0, 0], "force": [0, 1]}] * 1001}), "has 1001 entries, at most 1000"),
        (scene(load={"gravity": 1e300}), "gravity = 1e+300"),
        (
            scene(curtain={"shape": "outline", "outline": [[0, k] for k in range(20_000)]}),
            "20000 points [x, y], at most",
        ),
        (
            scene(curtain={"shape": "outline", "outline": [[0, 0]] * 3000, "holes": [[[0, 0]] * 3000]}),
            "have 6000 corners, at most 5000",
        ),
    ],
)
def test_work_is_bounded_before_it_begins(tables, words):
    with pytest.raises(InputError) as error:
        read_scene(tables)
    assert words in str(error.value)
    assert len(str(error.value)) < 400


def test_hooks_are_counted_before_they_are_placed(bounded_memory):
    """A pitch of 1e-9 mm asked for 745 GiB; the least that is allowed now would make a billion hooks here."""
    from homogenize.laws.net import diagonal_net
    from macro_fem.curtain import solve_scene

    hooks = read_scene(scene(support={"kind": "hooks", "pitch": 1e-6}))
    with bounded_memory(500_000_000), pytest.raises(InputError, match="pitch = 1e-06: is finer than the mesh"):
        solve_scene(hooks, diagonal_net())


def test_an_outline_of_thousands_of_corners_is_meshed():
    """The work is that of its points: every corner against every lattice point took a minute here."""
    angle = 2.0 * np.pi * np.arange(2000) / 2000
    radius = 500.0 + 50.0 * np.sin(7.0 * angle)
    outline = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    tables = scene(curtain={"shape": "outline", "outline": outline.tolist(), "areal_mass": 1.0}, mesh={"cells": 100})
    mesh = build_mesh(read_scene(tables), None).mesh
    a, b = (mesh.p[:, mesh.t[k]] - mesh.p[:, mesh.t[0]] for k in (1, 2))
    x, y = outline.T
    area = 0.5 * abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
    assert 0.5 * np.abs(a[0] * b[1] - a[1] * b[0]).sum() == pytest.approx(area, rel=1e-6)


def test_a_slender_outline_across_the_weave_is_refused_before_its_lattice_is_made(bounded_memory):
    outline = [[0, 0], [1, 0], [3001, 3000], [3000, 3000]]
    thin = {"shape": "outline", "outline": outline, "areal_mass": 1.0, "weave_angle": 0.0}
    tables = scene(curtain=thin, mesh={"cells": 20_000})
    with bounded_memory(400_000_000), pytest.raises(InputError, match=r"lattice|triangles"):
        build_mesh(read_scene(tables), None)


def test_keys_of_thousands_of_parts_are_refused(tmp_path, bounded_memory):
    for line in ("a." * 20_000 + "b = 1", "[" + "a." * 20_000 + "b]", "c = {" + "a." * 20_000 + "b = 1}"):
        (tmp_path / "scene.toml").write_text(line + "\n")
        with bounded_memory(300_000_000), pytest.raises(InputError, match="a key has more than 50 parts"):
            load_scene(tmp_path / "scene.toml")
