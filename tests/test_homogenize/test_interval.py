"""A law with what its rows prove: the three laws contain each other, and files without rows are told apart."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from homogenize import diagonal_net, read_law_interval
from homogenize.fitting import interval_or_law, law_interval, random_loads
from homogenize.io import DEFAULT_LAW
from rve import InputError
from rve.common import double_dot


def test_the_law_of_a_file_lies_between_its_inner_and_outer_law():
    found, S = read_law_interval(), random_loads(300)
    inner, law, outer = (one.support(S) for one in (found.inner, found.law, found.outer))
    # Between two of its 720 loads of rank one the inner law is passed by less than 1e-5.
    assert (law >= inner - 2e-5).all()
    assert (outer >= law - 1e-9).all()
    assert found.width(S).max() < 0.02
    assert found.raised < 1e-8
    assert np.abs(found.width(found.rows.S)).max() < 2e-5


def test_rows_that_missed_the_largest_work_are_raised_to_what_others_do():
    rows = read_law_interval().rows
    i, j = 40, 41
    low = rows.E.copy()
    low[i] -= 0.01 * np.array([1.0, 0.0, 1.0])
    wrong = replace(rows, E=low, h=double_dot(rows.S, low))
    found = law_interval(wrong)
    best = double_dot(rows.S[i], low[np.arange(len(low)) != i]).max()
    assert found.raised == pytest.approx(best - wrong.h[i], abs=1e-12)
    assert found.raised > 1e-3
    assert found.rows.h[i] == pytest.approx(best, abs=1e-12)
    assert found.rows.h[j] == wrong.h[j]
    assert (found.outer.support(random_loads()) >= found.inner.support(random_loads()) - 2e-5).all()


def test_files_without_rows_hold_a_law_and_no_interval(tmp_path: Path):
    record = json.loads(DEFAULT_LAW.read_text())
    del record["provenance"]["table_rows"]
    bare, net = tmp_path / "bare.json", tmp_path / "net.json"
    bare.write_text(json.dumps(record))
    diagonal_net().save(net)
    for path in (bare, net):
        assert not hasattr(interval_or_law(path), "inner")
        with pytest.raises(InputError, match="table_rows"):
            read_law_interval(path)
