"""What a law carries beside its mechanics: report, provenance, file, picture, what a notebook shows."""

import json
from pathlib import Path

import numpy as np
import pytest

from homogenize import ClothLaw, default_law, fit_table, load_law, ring_net
from homogenize.io import DEFAULT_LAW
from homogenize.laws.net import ring_cell
from homogenize.query.answers import strain_answer
from rve.common import InputError

TABLE = Path(__file__).parent / "data" / "table190.csv"


@pytest.fixture(scope="module")
def fitted():
    return fit_table(TABLE)


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
