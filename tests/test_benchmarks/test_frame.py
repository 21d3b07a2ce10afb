"""The frame of the reports: rows become tables, a section takes its place in a page, every section can be run."""

import math

import numpy as np
import pytest

import benchmarks.__main__ as command
from benchmarks.frame import Curve, Diagram, Section, table
from benchmarks.numerics import _read, fingerprint

CURVES = (Curve("first", (1.0, 2.0, 3.0), (1e-3, math.nan, 1e-5)), Curve("second", (1.0, 2.0), (1e-2, 1e-4)))
DIAGRAM = Diagram("ladder", "Error against time", "time (s)", "error", CURVES)
SECTION = Section("Rings", "Some *text*.", (table("Runs", [{"method": "a | b", "n": 1234}]),), (DIAGRAM,), "Yes.")


def test_rows_make_a_table_with_dashes_for_what_a_failed_run_lacks():
    rows = [{"method": "a", "error": 0.0, "ok": np.True_, "s": 2.0}, {"method": "b", "_": 0, "_1": 0, "_2": 0, "_3": 0}]
    made = table("Runs", rows, {"error": "decade 1e-12", "s": ".1f"})
    assert made.columns == ("method", "error", "ok", "s")
    assert made.rows == (("a", "<= 1e-12", "yes", "2.0"), ("b", "-", "-", "-"))
    for rows, forms in (([{"a": 1}, {"b": 2}], {}), ([{"a": 1}], {"b": ".1f"})):
        with pytest.raises(ValueError, match="no columns \\['b'\\]"):
            table("Runs", rows, forms)


def test_every_section_can_be_run_and_its_page_is_there():
    assert all(callable(command.measure_of(key)) and page.exists() for key, page in command.SECTIONS.items())


def test_a_fingerprint_follows_numbers_and_not_words(tmp_path, monkeypatch):
    file = tmp_path / "rve" / "one.py"
    file.parent.mkdir()
    monkeypatch.setattr("benchmarks.numerics.ROOT", tmp_path)
    found = []
    for text in ("x = 1.0\n", '"""What x is."""\n\nx = 1.0  # mm\n', "x = 2.0\n"):
        file.write_text(text)
        fingerprint.cache_clear(), _read.cache_clear()
        found.append(fingerprint("rve.one"))
    assert found[0] == found[1] != found[2]


def test_what_is_not_of_todays_numerics_is_stale_and_made_anew(tmp_path, monkeypatch):
    measured = []
    monkeypatch.setattr(command, "measure_of", lambda key: lambda full: measured.append(key) or SECTION)
    monkeypatch.setattr(command, "SECTIONS", {"rings": tmp_path / "a.md", "law": tmp_path / "b.md"})
    both = ["rings", "law"]
    for now, asked, made in (("a1", both[1:], both[1:]), ("a1", [], both[:1]), ("a1", [], []), ("b2", [], both)):
        monkeypatch.setattr(command, "fingerprint", lambda module, now=now: now)
        measured.clear()
        command.main.main(asked, standalone_mode=False)
        assert measured == made
    assert command.stale() == []
