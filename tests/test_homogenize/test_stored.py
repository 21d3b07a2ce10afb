"""What a law carries beside its mechanics: report, provenance, file, picture, what a notebook shows."""

import json
from pathlib import Path

import numpy as np
import pytest

from homogenize import ClothLaw, FitOptions, default_law, fit_table, load_law, ring_net, with_material
from homogenize.io import DEFAULT_LAW
from homogenize.laws import PolyhedralLaw, law_record, ring_cell
from homogenize.query import strain_answer
from rve import MATERIALS, DirectOptions, InputError, read_table

TABLE = Path(__file__).parent / "data" / "table190.csv"
OLD = TABLE.parent / "version_0_2"


@pytest.fixture(scope="module")
def fitted():
    return fit_table(TABLE)


@pytest.mark.slow
def test_a_law_keeps_its_report_and_rows_through_its_file(fitted, tmp_path):
    law, path = fitted.law, tmp_path / "law.json"
    law.save(path)
    again = load_law(path)
    assert again.report == law.report == fitted.report
    assert again.report.held_out.maximum == pytest.approx(5.767e-4, rel=1e-2)
    assert again.provenance["table"]["name"] == "table190.csv"
    assert strain_answer(path, 45.0, 0.0)["E11_min"] == pytest.approx(-0.0398369637, abs=1e-8)  # bounds need the rows


@pytest.mark.parametrize("law", [default_law(), ring_net(ring_cell(5.0, 0.5, 11.0, 12.646)), ClothLaw()], ids=str)
def test_a_law_file_keeps_every_digit(law, tmp_path):
    law.save(tmp_path / "law.json")
    again = load_law(tmp_path / "law.json")
    assert (type(again), again.cell, again.to_dict()) == (type(law), law.cell, law.to_dict())
    E = np.random.default_rng(9).normal(scale=0.5, size=(50, 3))
    assert np.array_equal(again.cut(E).S, law.cut(E).S)


def test_files_of_version_0_2_are_read(tmp_path):
    """They tell the weave in the sidecar alone, and in words whether the stiffness is that of the rings."""
    table, law = read_table(OLD / "table.csv"), load_law(OLD / "law.json")
    assert (table.cell.weave, table.cell.grain, table.cell.reference) == ("4-in-1", "x", "locked")
    assert (table.cell.material, table.origin.joint) == (MATERIALS["titanium grade 2"], "welded")
    assert table.options == DirectOptions(reference="locked")
    assert (law.cell, law.stiffness_is_measured, law.report.kind) == (table.cell, True, "outer")
    new = fit_table(OLD / "table.csv", FitOptions("outer")).law
    assert isinstance(law, PolyhedralLaw)
    assert isinstance(new, PolyhedralLaw)
    assert np.allclose(law.h, new.h, rtol=0.0, atol=1e-12)
    assert np.array_equal(law.rows.E, new.rows.E)
    assert with_material(law, {"young": 52.5e3}).stiffness == pytest.approx(0.5 * law.stiffness)
    law.save(tmp_path / "law.json")
    again = load_law(tmp_path / "law.json")
    assert law_record(again) == law_record(law)
    record = json.loads(json.dumps(law_record(with_material(law, {"material": "copper"}))))
    del record["cell"]["material"]  # the sidecar of the table still says titanium
    (tmp_path / "law.json").write_text(json.dumps(record))
    assert load_law(tmp_path / "law.json").cell.material == MATERIALS["copper"]


@pytest.mark.parametrize(("sides", "told"), [((12.646069623526, 11.0), ("4-in-1", "x")), ((11.0, 14.0), (None, "y"))])
def test_a_net_of_version_0_2_has_the_weave_of_its_sides(sides, told, tmp_path):
    record = json.loads(json.dumps(law_record(ring_net(ring_cell(5.0, 0.5, *sides)))))
    for key in ("weave", "grain", "reference", "material"):
        del record["cell"][key]
    del record["stiffness_is_measured"]
    (tmp_path / "net.json").write_text(json.dumps(record))
    law = load_law(tmp_path / "net.json")
    assert (law.cell.weave, law.cell.grain, law.stiffness_is_measured) == (*told, False)
    if law.cell.weave is None:
        with pytest.raises(InputError, match="of no known weave"):
            law.cell.cell()


def test_a_report_that_is_none_is_refused(tmp_path):
    record = json.loads(DEFAULT_LAW.read_text())
    for change, words in (
        ({"report": 3}, "law.json: provenance report: is not a table"),
        ({"report": record["provenance"]["report"] | {"gap": {"count": -1}}}, "count = -1"),
        ({"report": {"kind": "refined"}}, "normality: is missing"),
    ):
        (tmp_path / "law.json").write_text(json.dumps(record | {"provenance": record["provenance"] | change}))
        with pytest.raises(InputError, match=words):
            load_law(tmp_path / "law.json")


def test_a_law_shows_itself_in_a_line(fitted):
    assert str(fitted.law) == "PolyhedralLaw: refined, r1 = 5 mm, r2 = 0.5 mm"
