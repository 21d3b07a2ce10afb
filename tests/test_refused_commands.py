"""Command lines that make no sense: one sentence, exit code 2, and nothing is written."""

import re
import shlex
import shutil
from contextlib import nullcontext
from pathlib import Path

import pytest

from homogenize import ClothLaw
from homogenize.io import DEFAULT_LAW
from tests.commands import run

DATA = Path(__file__).parent / "test_homogenize" / "data"
HOOKS = """
curtain = {width = 330.0, height = 252.9}
mesh = {cells = 4}
support = {kind = "hooks", pitch = 110.0}
load = {bar = {mass = 2.0}}
"""
REFUSED = f"""
rve tabel -> 'tabel' is no command; did you mean table? known are table, case,
rve {"a" * 999} -> is no command; known are
rve table -> Missing option '--out'
rve table --out -> '--out' requires an argument
rve table --out new.csv --ring -> No such option: --ring; did you mean --rings?
rve table --out new.csv --{"a" * 999} -> No such option: --a
rve table --out new.csv --weave 6in1 -> kings-4-in-1, FILE.toml; did you mean 6-in-1?
rve table --out new.csv --r1 '6 cm' -> '6 cm' is not a number; write the number alone, in mm: 60
rve table --out new.csv --density '8 g/cm3' -> write the number alone, in kg/m3: 8000
rve table --out new.csv --r2 0,5 -> '0,5' is not a number; has a decimal comma; write 0.5
rve table --out new.csv --density 7.85 -> --density = 7.85: expected a number >= 100.0 kg/m3; did you mean 7850, from
rve table --out new.csv --material 'Titanium grade2' -> did you mean titanium grade 2?
rve table --out new.csv --material {"a" * 999} -> known are steel
rve simulate --out new.csv --alpha 0 -> give --alpha and --beta, with --to for a loop, or --history alone
rve simulate --out new.csv --alpha 0 --beta 45 --to 0,60 -> --to: turns one load, with --friction above 0
rve simulate --out new.csv --alpha 0 --beta 120 -> cannot push
rve simulate --out new.csv --alpha 0 --beta 45 --friction -1 -> friction = -1.0: expected a number >= 0
rve simulate --out new.csv --alpha 0 --beta 45 --set h_mx=1 -> did you mean h_max?
rve simulate --out new.csv --alpha 0 --beta 45 --set h_max -> --set h_max = '': give finite numbers VALUE
rve simulate --out new.csv --history law.json -> law.json
rve simulate --out table.txt --alpha 0 --beta 45 -> ends in .csv
rve weaves --r1 0.005 --r2 0.0005 -> --r1 = 0.005: rings are from 0.1 to 200 mm; lengths are in mm, did you mean 5?
rve weaves --r2 0 -> --r2 = 0
rve weaves --r1 nan -> --r1 = nan: rings are from 0.1 to 200 mm
rve weaves --r2 nan -> --r2 = nan
rve weaves --r1 0.001 --r2 0.001 -> --r1 = 0.001: rings are from 0.1 to 200 mm
rve ring --inner 1000 --wire 1 -> Error: r1 = 500.5: rings are from 0.1 to 200 mm
rve sweep --out tables --r1 5 --r2 0.5 --ringz -> did you mean --rings?
homogenize --verbose -> No such option: --verbose
homogenize fit -> Missing argument 'TABLE'
homogenize fit table.csv --out new.json --kind Refined -> did you mean refined?
macro_fem run scene.toml extra.toml --out new -> unexpected extra argument (extra.toml)
macro_fem size scene.toml -> Missing option '--vary'
macro_fem size scene.toml --vary mas --from 1 --to 2 --factor 1 -> not one of pitch, mass, speed, r2; did you mean mass?
macro_fem modes scene.toml --out new --number 3.5 -> '3.5' is not a whole number
macro_fem localize curtain --out new --max-rings 0 -> 0 is not in the range x>=1
macro_fem run {"a" * 999} --out new -> cannot be read
macro_fem run scene.toml --out new --{"a" * 200}=3 -> No such option
rve table --out new.csv --r2 2 -> jams
rve table --out new.csv --alpha 0:10 -> --alpha
rve table --out new.csv --graded --beta 10 -> --graded
rve table --out new.csv --cells 2 -> cells
rve table --out new.csv --cells 9x1 -> cells
rve table --out new.csv --material mithril -> known are steel
rve table --out new.csv --young 210 -> young = 210.0: expected a number >= 500
rve table --out new.csv --rings --joint glued -> --joint = 'glued'
rve table --out new.csv --joint butted -> --joint: belongs to --rings
rve table --out table.json -> sidecar
rve case --alpha 0 --beta 45 --plot case.xyz -> xyz
rve support --S 1,0 -> --S
rve support --S 1,0,-1 -> has the eigenvalue -1
rve support --S 1,0,0 --branches none -> 'none' is not one of
rve sweep --out tables --r1 5 --r2 0.5 --cluster tcp://127.0.0.1:9 -> no Dask scheduler answers there
rve sweep --out tables --r1 5 --r2 0.5 --cluster '' -> no Dask scheduler answers there
rve sweep --out tables --r1 5 --r2 0.5 --cluster x --jobs 2 -> two ways to run side by side
rve sweep --out tables --r1 5 --r2 0.5,0.50 -> 2 items of the sweep are called so
homogenize strain law.json --alpha nan --beta 3 -> --alpha nan
homogenize strain law.json --alpha 10 --beta -5 -> push
homogenize strain cloth.json --alpha 10 --beta 45 -> kind = cloth: the law has no stiffness when locked
homogenize support nowhere.json --S 1,0,0 -> nowhere.json: cannot be read
homogenize strength law.json --S 1,2,1 -> not tensile
homogenize strength law.json --S 1,nan,1 -> give finite numbers S11,S12,S22
homogenize strength law.json --S 1e308,0,1e308 -> at most 1e+100
homogenize strength law.json --S 1,0,1 --yield -4 -> --yield = -4.0: expected a number >= 0.001
homogenize strength cloth.json --S 1,0,1 -> strength
homogenize fit table.csv --out new.json --kind spline -> 'spline' is not one of
homogenize fit table.csv --out nowhere/law.json -> nowhere
homogenize fit law.json --out new.json -> law.json: is a law, not a strain-load table; macro_fem run SCENE --law
homogenize export cloth.json --out umat.f -> kind = cloth: only polyhedral laws are exported
homogenize plot law.json --table other.csv --out new -> the table: r2, b_x and b_y over r1 are 0.08,
macro_fem run scene.toml --out new --cell=-5,0.5 -> r1 = -5: rings are from 0.1 to 200 mm
macro_fem run scene.toml --out new --cell 5,0.5 --cache c --no-cache -> contradict
macro_fem run scene.toml --out new --rings 5,0.5 -> is now --cell R1,R2
macro_fem run scene.toml --out new --accuracy 1e-3 -> belongs to --cell
macro_fem run scene.toml --out new --cell 8,0.5 --law law.json -> law.json: r2, b_x and b_y over r1 are
macro_fem run scene.toml --out new --cell 5,0.5 --cache /proc/none -> --cache = /proc/none: cannot be made
macro_fem run scene.toml --out new --animation -> [load] steps = 1: there is nothing to animate
macro_fem run scene.toml --out new --report r.txt -> ends in .pdf
macro_fem run scene.toml --out new --dxf scene.toml -> scene.toml
homogenize fit table.json --out new.json -> table.json: is a sidecar file of a table, not a strain-load table; give
homogenize strain scene.toml --alpha 0 --beta 45 -> is a scene, not a law; macro_fem run takes it
rve table --out new.csv --loads law.json -> law.json: is a law, not a list of loads
macro_fem run curtain --out new -> curtain: is a folder of a curtain, not a scene; macro_fem localize takes it
macro_fem localize law.json --out new -> law.json: is a law, not a folder of a curtain
macro_fem localize scene.toml --out new -> scene.toml: is a scene, not a folder of a curtain; macro_fem run takes it
macro_fem run scene.toml --out new --law curtain/summary.json -> is a record of a curtain, not a law
macro_fem run scene.toml --out new --cell 8,1 --weave 6-in-1 --law law.json
 -> law.json: has the weave 4-in-1 with grain y, --cell the weave 6-in-1 with grain y; give both the same one
macro_fem run scene.toml --out new --cell 5,0.5 --grain x --law law.json -> the weave 4-in-1 with grain x; give both
homogenize fit semicolons.csv --out new.json -> line 2, column E11: '0,7539450766977034' is not a number; has a decimal
homogenize fit lower.csv --out new.json -> lower.csv: column E11 is missing; write E11 in place of e11
homogenize fit commas.csv --out new.json -> column alpha_deg: '0,5' is not a number; has a decimal comma; write 0.5
homogenize fit utf16.csv --out new.json -> utf16.csv: is not a CSV text file: it is no text in UTF-8; save it in this
macro_fem run twice.toml --out new -> line 2: [support] stands twice; where there may be several, write [[support]]
macro_fem run comma.toml --out new -> comma.toml: is not TOML: line 2: has a decimal comma; write 330.5
macro_fem run semicolon.toml --out new -> line 1: has a semicolon; write commas in lists, and each key on a line of its
macro_fem run bare.toml --out new -> line 1: write support.kind = "hooks", a text in quotes
macro_fem run capital.toml --out new -> line 1: write true, without capitals
macro_fem run unit.toml --out new -> line 1: write the number alone: 5
macro_fem run scene.toml --out new --law curtain -> is a folder of a curtain, not a law
macro_fem run table.csv --out new -> table.csv: is a strain-load table, not a scene; homogenize fit takes it
macro_fem run curtain/curtain.vtu --out new -> is a mesh file, not a scene; a scene takes it
macro_fem run scene.toml --out new --law table.csv -> is a strain-load table, not a law; homogenize fit takes it
macro_fem run scene.toml --out new --law table.json -> is a sidecar file of a table, not a law
macro_fem run law.json --out new -> law.json: is a law, not a scene
macro_fem run moving.toml --out new --explain -> are for a curtain at rest
macro_fem compare combined.toml -> [combination]: is for a curtain by a law
macro_fem size scene.toml --vary speed --from 1 --to 2 --factor 1 -> Error: scene.toml: --vary speed: the scene has no
macro_fem size moving.toml --vary mass --from 1 --to 2 --factor 1 -> which is not sized
macro_fem size scene.toml --vary mass --from 3 --to 2 --factor 1 -> the smaller one first
macro_fem size scene.toml --vary mass --from 1 --to 2 --factor nan -> --factor = nan: must be positive
macro_fem size scene.toml --vary r2 --from 0.4 --to 0.6 --factor 1 -> Error: --vary r2: needs the rings, by --cell
macro_fem size scene.toml --vary mass --from 1 --to 2 --factor 1e6 -> no mass from 1 to 2 holds with a factor
macro_fem size scene.toml --vary pitch --from 120 --to 150 --factor 1 -> divides the edge of 330 mm
macro_fem sweep scene.toml --out new --report r.pdf -> names one file for all of its items
macro_fem localize curtain --out new --window 0,0,nan,9 -> window
macro_fem localize curtain --out new --window 5000,5000,6000,6000 -> not one ring
macro_fem localize curtain --out new --max-rings 3 -> --max-rings
rve table --out /proc/t.csv --alpha 0 --beta 45 -> --out = /proc/t.csv: cannot be written
homogenize fit table.csv --out other.json -> other.json: is the sidecar file of a table
"""
ROWS = [line.split(" -> ") for line in REFUSED.strip().replace("\n ->", " ->").splitlines()]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Scenes, a table, laws and a solved curtain for the commands to read."""
    out = tmp_path_factory.mktemp("refused")
    (out / "scene.toml").write_text(HOOKS)
    (out / "moving.toml").write_text(HOOKS + "motion = {duration = 1.0, start = 'reference'}")
    (out / "combined.toml").write_text(HOOKS + "combination = {name = 'a'}")
    shutil.copy(DEFAULT_LAW, out / "law.json")
    ClothLaw().save(out / "cloth.json")
    for name in ("table.csv", "table.json", "other.csv"):
        shutil.copy(DATA / f"table190{Path(name).suffix}", out / name)
    (out / "other.json").write_text((out / "table.json").read_text().replace('"r2_mm": 0.5', '"r2_mm": 0.4'))
    table = (out / "table.csv").read_text()
    (out / "semicolons.csv").write_text("\ufeff" + table.replace(",", ";").replace(".", ","))
    (out / "lower.csv").write_text(table.replace("E11", "e11", 1))
    (out / "commas.csv").write_text(table.replace("\n0.0,", '\n"0,5",', 1))
    (out / "utf16.csv").write_text(table, encoding="utf-16")
    (out / "comma.toml").write_text("[curtain]\nwidth = 330,5\n")
    (out / "twice.toml").write_text("[support]\n[support]\n")
    (out / "semicolon.toml").write_text('curtain.width = 1; curtain.height = 2 # "a; b"\n')
    (out / "bare.toml").write_text("support.kind = hooks\n")
    (out / "capital.toml").write_text("load.bar.straight = True\n")
    (out / "unit.toml").write_text("support.pitch = 5 mm\n")
    run("macro_fem", "run", out / "scene.toml", "--out", out / "curtain", "--no-picture")
    return out


@pytest.mark.parametrize(("command", "sentence"), ROWS, ids=[command for command, _ in ROWS])
def test_what_makes_no_sense_is_one_sentence(command, sentence, folder, monkeypatch):
    monkeypatch.setattr("rve.common.commands.sweeps.CONNECT_S", 0.5)
    monkeypatch.chdir(folder)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    monkeypatch.setattr("rve.common.commands.command_line.shown", nullcontext)  # lines of progress of a slow machine
    message = run(*shlex.split(command), codes=(2,)).stderr
    assert message.startswith("Error: ")
    assert message.index("\n") == len(message) - 1  # and no usage before it
    assert max(map(len, re.split(r"[\s/]", message))) <= 82
    assert sentence in message
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
