"""Readers of mutated files end in InputError or in a value: no other error, no hang, nothing written.

Input i of a reader is made from the seed "reader:i", so that a failure names what repeats it. Warnings are errors here.
"""

import json
import re
import resource
import shutil
import signal
from pathlib import Path
from random import Random

import meshio
import numpy as np
import pytest

from homogenize import ClothLaw, default_law, load_law, ring_net
from homogenize.io import DEFAULT_LAW
from macro_fem import load_scene, read_curtain
from macro_fem.scene import build_mesh
from rve import Cell, InputError, read_table, solve_table, write_table
from rve.common import checksum, numbers_of
from rve.directions import parse_angles, read_loads
from tests.squares import MSH, mesh_of, square, write_square

QUICK, MANY, SECONDS = 40, 400, 10
WORDS = ["0", "-1", "1e308", "1e400", "nan", "-Infinity", "4294967295", "1_0"]
WORDS += ["true", "null", "[]", "{}", '"', "=", "<"]
WORDS += ["1" * 5000, "[" * 3000, '{"a":' * 3000, "a." * 300, "\x00", "\U0001f642"]
NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
CELL = default_law().cell
OUTLINE = """
mesh.cells = 9
support.kind = "top"
[curtain]
shape = "outline"
outline = [[0, 0], [100, 0], [100, 60], [50, 100], [0, 60]]
holes = [[[40, 30], [60, 30], [50, 50]]]
weave_angle = 12.5
"""


def make_scenes(folder):
    (folder / "outline.toml").write_text(OUTLINE)
    for path in (Path(__file__).parents[1] / "examples").glob("*.toml"):
        shutil.copy(path, folder)


def read_scenes(folder):
    """Every scene, and unless mutation asks for a large one the mesh of the outline."""
    for path in folder.iterdir():
        scene = load_scene(path)
        if path.name == "outline.toml" and scene.mesh.cells <= 20:
            build_mesh(scene, None)


def make_law(folder):
    """The shipped law with a twentieth of its half-spaces and without its rows."""
    record = json.loads(DEFAULT_LAW.read_text())
    known = record["parameters"]
    record["parameters"] = known | {key: known[key][::20] for key in ("S", "h")}
    (folder / "law.json").write_text(json.dumps(record | {"provenance": {}, "strength": None}))


def make_curtain(folder):
    points, cells = square("triangle")
    n = len(cells)
    fields = {"E_11_12_22": np.full((n, 3), 0.1), "S_11_12_22_N_per_mm": np.tile([1.0, 0.1, 0.5], (n, 1))}
    fields |= {"line_load_1_N_per_mm": np.ones(n), "state_0_slack_1_wrinkled_2_taut": np.full(n, 2.0)}
    moved = points * [1.1, 0.9, 1.0]
    data = {"displacement_mm": moved - points, "reference_mm": points}
    cell_data = {name: [values] for name, values in fields.items()}
    meshio.vtu.write(folder / "curtain.vtu", meshio.Mesh(moved, [("triangle", cells)], data, cell_data))
    rings = {"r1_mm": 5.0, "r2_mm": 0.5, "b_x_mm": 11.0, "b_y_mm": 12.646}
    summary = {"status": "converged", "hang_deg": 0.0, "rings": rings}
    listed = {"curtain.vtu": checksum(folder / "curtain.vtu")}
    (folder / "summary.json").write_text(json.dumps(summary | {"files": listed}))


def make_table(folder):
    """Four rows: locked, locked, compressive, free."""
    write_table(solve_table(Cell(), ([0.0, 20.0, 10.0, 30.0], [90.0, 30.0, 95.0, 0.0])), folder / "table.csv")


def read_options(folder):
    """The values of --alpha and --window."""
    first, _, second = (folder / "options.txt").read_bytes().decode("utf-8", "surrogateescape").partition(" ")
    parse_angles(first, "--alpha")
    numbers_of(second, "--window", "x0,y0,x1,y1")


def read_curtain_files(folder):
    curtain = read_curtain(folder)
    curtain.told.info(curtain.source).cell()


def read_law(folder):
    load_law(folder / "law.json")


TARGETS = {
    "table": (make_table, lambda folder: read_table(folder / "table.csv")),
    "law-polyhedral": (make_law, read_law),
    "law-cloth": (lambda folder: ClothLaw(cell=CELL).save(folder / "law.json"), read_law),
    "law-net": (lambda folder: ring_net(CELL).save(folder / "law.json"), read_law),
    "scene": (make_scenes, read_scenes),
    "loads": (
        lambda folder: (folder / "loads.csv").write_text("beta_deg,alpha_deg,note\n30,20,x\n60,-5,y\n"),
        lambda folder: read_loads(folder / "loads.csv"),
    ),
    "options": (lambda folder: (folder / "options.txt").write_text("0:45:5 0,0,50,80.5"), read_options),
    "msh-text": (lambda folder: (folder / "mesh.msh").write_text(MSH), mesh_of),
    "msh-binary": (lambda folder: write_square(folder / "mesh.msh"), mesh_of),
    "vtu-text": (lambda folder: write_square(folder / "mesh.vtu", binary=False), mesh_of),
    "vtu-zlib": (lambda folder: write_square(folder / "mesh.vtu", "quad", compression="zlib"), mesh_of),
    "curtain": (make_curtain, read_curtain_files),
}
"""By reader: what writes valid files into a folder, what reads them."""


class HangError(BaseException):
    """Not an Exception: no reader may take it for a damaged file."""


def mutated(content: bytes, random: Random) -> bytes:
    """One to four changes: bits flipped, bytes cut, doubled or put in, numbers replaced."""
    for _ in range(random.choice((1, 1, 2, 4))):
        place, length = random.randrange(len(content) + 1), random.choice((1, 4, 50, 1000))
        word, numbers = random.choice(WORDS).encode(), list(NUMBER.finditer(content))
        kind = random.randrange(8)
        if kind == 0:
            content = content[:place]
        elif kind == 1:
            content = content[:place] + content[place + length :]
        elif kind == 2:
            content = content[:place] + content[place : place + length] * 3 + content[place + length :]
        elif kind == 3 or not numbers:
            content = content[:place] + word + content[place:]
        elif kind == 4:
            flipped = bytes(one ^ 1 << random.randrange(8) for one in content[place : place + 1])
            content = content[:place] + flipped + content[place + 1 :]
        else:
            one = random.choice(numbers)
            content = content[: one.start()] + word + content[one.end() :]
    return content


@pytest.fixture
def alarm():
    def hang(*_):
        raise HangError(f"a reader takes more than {SECONDS} s of the processor")

    before = signal.signal(signal.SIGPROF, hang)
    limit = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (8_000_000_000, limit[1]))
    yield lambda: signal.setitimer(signal.ITIMER_PROF, SECONDS)
    signal.setitimer(signal.ITIMER_PROF, 0)
    resource.setrlimit(resource.RLIMIT_AS, limit)
    signal.signal(signal.SIGPROF, before)


@pytest.mark.parametrize("count", [QUICK, pytest.param(MANY, marks=pytest.mark.release)])
@pytest.mark.parametrize("name", TARGETS)
def test_mutated_files_end_in_a_sentence(name, count, tmp_path, alarm):
    make, read = TARGETS[name]
    make(tmp_path)
    read(tmp_path)
    valid, refused = {path.name: path.read_bytes() for path in tmp_path.iterdir()}, 0
    for i in range(count):
        seed = f"{name}:{i}"
        random = Random(seed)
        spoiled = random.choice(sorted(valid))
        content = mutated(valid[spoiled], random)
        (tmp_path / spoiled).write_bytes(content)
        alarm()
        sentence = ""
        try:
            read(tmp_path)
        except InputError as error:
            sentence = str(error)
        except (Exception, HangError) as error:
            raise AssertionError(f"seed {seed}: {type(error).__name__}: {error}") from error
        refused += bool(sentence)
        assert "\n" not in sentence, f"seed {seed}: {sentence}"
        assert len(sentence) < 2000, f"seed {seed}: {len(sentence)} characters"
        found = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
        assert found == valid | {spoiled: content}, f"seed {seed}: something was written"
        (tmp_path / spoiled).write_bytes(valid[spoiled])
    assert refused > count // 10
