"""The frame of the reports: every section can be run, and is made anew where its numerics are not today's."""

import pytest

import benchmarks.__main__ as command
from benchmarks import scaling
from benchmarks.frame import Section
from benchmarks.numerics import _read, fingerprint

SECTION = Section("Rings", "Some *text*.", (), (), "Yes.")


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


@pytest.mark.slow
def test_the_time_of_many_tables_is_start_and_rounds_times_the_time_of_one(monkeypatch):
    monkeypatch.setattr(scaling, "_swept", lambda count, way: 3.0 + 2.0 * -(-count // (2 if way else 1)))
    rows = scaling.side_by_side()
    assert [(row["s a table"], row["start, s"]) for row in rows] == [pytest.approx((2.0, 3.0))] * 3
    assert scaling.thousand(rows).startswith("a laptop, 2 workers, 1003 s; a node, 64 workers, 35 s; a cluster, 1,024 ")
