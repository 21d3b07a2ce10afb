"""Materials: named ones, values that replace theirs, one sentence for what no material has, and the way into files."""

import json
from copy import copy, deepcopy
from dataclasses import asdict, replace
from multiprocessing.reduction import ForkingPickler

import pytest
from click.testing import CliRunner

from rve import MATERIALS, WEAVES, Cell, InputError, Material, named_material, read_table
from rve.cli import main
from rve.common import material_of, read_typed

dumps, loads = ForkingPickler.dumps, ForkingPickler.loads


def test_named_materials_have_plausible_numbers():
    for name, material in MATERIALS.items():
        assert named_material(name) is material
        assert 1e-6 < material.density_kg_per_mm3 < 1e-5
        assert 0.05e-6 < material.young_N_per_mm2 / 1e12 < 0.25e-6
        assert material.ultimate_N_per_mm2 > material.yield_N_per_mm2 > 100.0
    assert MATERIALS["steel"].density_kg_per_mm3 == 7.85e-6


def test_given_values_replace_those_of_the_named_material():
    found = material_of({"material": "steel 1.4404", "density": 7990.0, "yield": 450.0, "young": None})
    assert found == Material("steel 1.4404, changed", 7.99e-6, 200e3, 0.3, 450.0, 500.0)
    assert material_of({}) == Material()
    assert material_of({"yield": 400.0}).ultimate_N_per_mm2 is None  # more than the named one: unknown
    assert read_typed(Material, asdict(found), "table.json: material") == found


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"yield": 400.0, "ultimate": 300.0}, "^ultimate = 300: is less than the yield stress, 400"),
        ({"ultimate": 100.0}, "^(--)?ultimate = 100: is less than the yield stress, 235"),
    ],
)
def test_bad_values_are_one_sentence(given, message):
    with pytest.raises(InputError, match=message) as caught:
        material_of(given)
    assert "\n" not in str(caught.value)


def test_a_cell_has_one_density():
    assert Cell(material=named_material("titanium grade 2")).density == 4.51e-6
    assert Cell(density=8e-6).material == Material(density_kg_per_mm3=8e-6)
    for material in ("titanium grade 2", named_material("titanium grade 2")):
        with pytest.raises(InputError, match=r"titanium grade 2 has 4.51e-06 kg/mm3; give one of the two"):
            Cell(density=7.85e-6, material=material)


@pytest.mark.parametrize("again", [copy, deepcopy, lambda cell: loads(dumps(cell)), replace])
def test_what_is_changed_of_a_copied_cell_is_changed_as_of_the_cell(again):
    plain, light, titanium = (again(cell) for cell in (Cell(), Cell(density=8e-6), Cell(material="titanium grade 2")))
    assert (plain, light, titanium) == (Cell(), Cell(density=8e-6), Cell(material="titanium grade 2"))
    for cell in (plain, light, titanium):
        assert replace(cell, material="copper") == Cell(material="copper")
        assert replace(cell, material="copper").ring_mass / Cell().ring_mass == pytest.approx(8.94 / 7.85)
    assert replace(plain, density=8e-6) == replace(Cell(density=9e-6), density=8e-6) == light
    assert replace(titanium, density=None, material=None, weave="6-in-1") == Cell(weave="6-in-1")
    with pytest.raises(InputError, match="give one of the two"):
        replace(titanium, density=8e-6)


def test_a_cell_takes_its_weave_by_name():
    assert Cell(r1=8.0, r2=1.0, weave="6-in-1") == Cell(r1=8.0, r2=1.0, weave=WEAVES["6-in-1"])
    with pytest.raises(InputError, match="is not one of 4-in-1, 6-in-1"):
        Cell(weave="5-in-1")
    with pytest.raises(InputError, match="expected a number, got Material"):
        Cell(r1=Material())


@pytest.mark.slow
def test_columns_and_material_from_the_command_line_to_the_file(tmp_path):
    words = ["table", "--out", str(tmp_path / "t.csv"), "--alpha", "0", "--beta", "45,90", "--rings"]
    result = CliRunner().invoke(main, [*words, "--material", "steel 1.4404", "--yield", "420"])
    assert result.exit_code == 0, result.output
    sidecar = json.loads((tmp_path / "t.json").read_text())
    assert sidecar["material"]["name"] == "steel 1.4404, changed"
    assert sidecar["material"]["yield_N_per_mm2"] == 420.0
    assert sidecar["density_kg_per_mm3"] == 8.0e-6
    assert (sidecar["compliance"], sidecar["joint"]) == ("rings", "welded")
    table = read_table(tmp_path / "t.csv")
    assert table.strength.shape == (2, 2)
    assert (table.strength[:, 0] > table.strength[:, 1]).all()
    assert table.compliance[1, 2, 2] > 0.0
    frame = table.to_pandas()
    assert frame["first_yield_1_per_mm"].tolist() == table.strength[:, 0].tolist()
    butted = CliRunner().invoke(main, [*words, "--joint", "butted:90"])
    assert butted.exit_code == 0, butted.output
    assert json.loads((tmp_path / "t.json").read_text())["joint"] == "butted:90"
    assert (read_table(tmp_path / "t.csv").strength > table.strength).all()
