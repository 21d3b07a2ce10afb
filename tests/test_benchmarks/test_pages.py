"""The frame of the reports: data kept, times told from results, pictures the same twice, a page that needs nothing."""

import json
import math
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmarks.report.files import FOLDER, command, page, read, write
from benchmarks.report.picture import svg
from benchmarks.report.records import (
    Column,
    Curve,
    Diagram,
    Report,
    Section,
    Table,
    differences,
    from_json,
    table,
    to_json,
)

TABLE = Table("Runs", (Column("method"), Column("error", ".1e"), Column("s", timed=True)), (("a | b", 1e-3, 2.0),))
CURVES = (Curve("first", (1.0, 2.0, 3.0), (1e-3, math.nan, 1e-5)), Curve("second", (1.0, 2.0), (1e-2, 1e-4)))
DIAGRAM = Diagram("ladder", "Error against time", "time (s)", "error", CURVES)
BARS = Diagram("split", "Parts", "part", "error", CURVES[1:], bars=True, ticks=("", "law", "mesh"))
SECTION = Section("Rings", "Some *text*.", (TABLE,), (DIAGRAM, BARS), "Use `first`.", "rings", "Machine.", 1.0)
REPORT = Report("work_precision", "Error against run time", "All of it.", "python -m benchmarks.x", (SECTION,))

PROBE = """<script>
const seen = {
  tables: document.querySelectorAll("table").length,
  rows: Math.min(...[...document.querySelectorAll("table")].map(t => t.querySelectorAll("tbody tr").length)),
  flat: [...document.querySelectorAll("svg")].filter(s => s.getBoundingClientRect().height < 100).length,
  pictures: document.querySelectorAll("svg").length,
  ids: document.querySelectorAll("[id]").length - new Set([...document.querySelectorAll("[id]")].map(e => e.id)).size,
  dangling: [...document.querySelectorAll("nav a")].filter(a => !document.querySelector(a.getAttribute("href"))).length,
  wider: Math.max(0, document.documentElement.scrollWidth - window.innerWidth),
  fetched: performance.getEntriesByType("resource").length,
  images: document.querySelectorAll("img").length,
};
document.documentElement.dataset.seen = JSON.stringify(seen);
</script></body>"""


def changed(value, column):
    """The report with one number replaced."""
    row = list(TABLE.rows[0])
    row[column] = value
    table = replace(TABLE, rows=(tuple(row),))
    return replace(REPORT, sections=(replace(SECTION, tables=(table,)),))


def test_json_brings_back_the_report():
    again = from_json(json.loads(json.dumps(to_json(REPORT), allow_nan=False)))
    assert to_json(again) == to_json(REPORT)
    assert math.isnan(again.sections[0].diagrams[0].curves[0].y[1])
    assert differences(REPORT, again) == []


def test_differences_see_results_and_not_times():
    assert differences(REPORT, changed(7.0, 2)) == []
    assert differences(REPORT, changed(1.04e-3, 1)) == []  # shown with one digit
    assert len(differences(REPORT, changed(2e-3, 1))) == 1
    assert len(differences(REPORT, replace(REPORT, sections=()))) == 1


def test_rows_as_long_as_the_columns():
    with pytest.raises(ValueError, match="2 values under 3 columns"):
        replace(TABLE, rows=(("a", 1.0),))


def test_rows_make_a_table_with_dashes_for_what_a_failed_run_lacks():
    rows = [{"method": "a", "error": 1e-20, "ok": True, "s": 2.0, "_x": 1}, {"method": "b"}]
    made = table("Runs", rows, {"error": "decade 1e-12", "s": ".1f timed"})
    assert made.columns == (Column("method"), Column("error"), Column("ok"), Column("s", ".1f", timed=True))
    assert made.rows == (("a", "<= 1e-12", "yes", 2.0), ("b", None, None, None))
    for rows, forms in (([{"a": 1}, {"b": 2}], {}), ([{"a": 1}], {"b": ".1f"})):
        with pytest.raises(ValueError, match="no columns \\['b'\\]"):
            table("Runs", rows, forms)


def test_pictures_are_the_same_twice_and_do_not_share_names():
    assert svg(DIAGRAM) == svg(DIAGRAM)
    names = [set(re.findall(r'id="([^"]+)"', svg(diagram))) for diagram in (DIAGRAM, BARS)]
    assert not names[0] & names[1]
    used = set(re.findall(r"url\(#([^)]+)\)", svg(DIAGRAM))) | set(re.findall(r'href="#([^"]+)"', svg(DIAGRAM)))
    assert used <= names[0]


def test_page_needs_nothing_else(tmp_path):
    write(REPORT, tmp_path)
    text = (tmp_path / "report.html").read_text()
    assert text.count("<svg") == 2
    assert text.count("<table>") == 1
    assert not re.search(r'(src|href)="(?!#)', text.replace("xlink:href=", ""))
    assert "a | b" in text


def test_only_keeps_the_other_sections(tmp_path):
    measures = {
        "rings": lambda full: replace(SECTION, title="full" if full else "quick"),
        "law": lambda _full: replace(SECTION, diagrams=()),
    }
    main = command(replace(REPORT, sections=()), measures)
    for arguments in ([], ["--only", "law"], ["--only", "rings", "--full"]):
        done = CliRunner().invoke(main, [*arguments, "--out", str(tmp_path)])
        assert done.exit_code == 0, done.output
    again = read("work_precision", tmp_path)
    assert [(section.key, section.title) for section in again.sections] == [("rings", "full"), ("law", "Rings")]
    assert again.sections[0].machine.startswith("Machine:")


def test_a_file_is_no_folder_for_reports_and_is_told_before_anything_is_measured(tmp_path):
    (tmp_path / "out").write_text("here already")
    measured = []
    main = command(replace(REPORT, sections=()), {"rings": measured.append})
    done = CliRunner().invoke(main, ["--out", str(tmp_path / "out")])
    assert done.exit_code == 2
    assert "is a file" in done.output
    assert measured == []


@pytest.mark.slow
def test_browser_shows_the_page(tmp_path):
    """The page as it is in docs, in headless Chromium: pictures drawn, names unique, nothing fetched, nothing cut."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    assert browser, "this test needs a browser: apt-get install chromium"
    kept = page(FOLDER)
    assert (FOLDER / "report.html").read_text() == kept, "report.html is older than the reports beside it"
    probed = tmp_path / "report.html"
    probed.write_text(kept.replace("</body>", PROBE))
    flags = "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking --disable-sync"
    flags += f" --disable-component-update --disable-quic --window-size=1280,900 --user-data-dir={tmp_path / 'profile'}"
    picture = tmp_path / "page.png"
    for extra in (["--dump-dom"], [f"--screenshot={picture}"]):
        run = [browser, *flags.split(), *extra, probed.as_uri()]
        done = subprocess.run(run, capture_output=True, text=True, timeout=120, check=True)
        if extra == ["--dump-dom"]:
            seen = json.loads(re.search(r'data-seen="([^"]+)"', done.stdout)[1].replace("&quot;", '"'))
    reports = [read(path.stem, FOLDER) for path in sorted(Path(FOLDER).glob("*.json"))]
    sections = [section for report in reports for section in report.sections]
    assert len(reports) == 4
    assert seen["tables"] == sum(len(section.tables) for section in sections)
    assert seen["pictures"] == sum(len(section.diagrams) for section in sections)
    assert seen["rows"] >= 1
    assert {key: seen[key] for key in ("flat", "ids", "dangling", "wider", "fetched", "images")} == dict.fromkeys(
        ("flat", "ids", "dangling", "wider", "fetched", "images"), 0
    )
    import matplotlib.image as image

    assert image.imread(picture)[..., :3].std() > 0.02
