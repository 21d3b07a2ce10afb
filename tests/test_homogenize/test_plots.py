"""The pictures show what the law says, and the files are whole."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from homogenize.cli import main
from homogenize.fitting.rows import rows_from_table
from homogenize.fitting.shipped import SHIPPED
from homogenize.io import default_law
from homogenize.plots import plot_sections, plot_strains, surface_height
from rve.table import read_table

TABLE = Path(__file__).parent / "data" / "table190.csv"


def test_rows_lie_on_the_drawn_surface():
    rows = rows_from_table(read_table(TABLE))
    E = rows.E[rows.unique]
    T = surface_height(default_law(), 0.5 * (E[:, 0] - E[:, 2]), E[:, 1])
    assert np.abs(T - 0.5 * (E[:, 0] + E[:, 2])).max() < 1e-10


def test_lines_and_points_agree():
    table = read_table(TABLE)
    axes = plot_strains(default_law(), table)
    for ax, column in zip(axes, table.E.T, strict=True):
        lines = ax.get_lines()
        assert len(lines) == 2 * 10
        points = np.concatenate([line.get_ydata() for line in lines[1::2]])
        assert np.allclose(np.sort(points), np.sort(column))
    axes = plot_sections(default_law(), rows_from_table(table))
    x, y = axes.get_lines()[0].get_data()
    assert np.interp(0.0, x, y) == pytest.approx(0.0, abs=1e-3)  # the reference state is a vertex


def test_pictures_are_written(tmp_path):
    run = CliRunner().invoke(main, ["plot", str(SHIPPED), "--table", str(TABLE), "--out", str(tmp_path / "out")])
    assert run.exit_code == 0, run.output
    files = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert files == ["errors.png", "pictures.json", "sections.png", "strains.png", "surface.png"]
    assert all(
        (tmp_path / "out" / name).read_bytes().startswith(b"\x89PNG") for name in files if name != "pictures.json"
    )
    law = tmp_path / "out" / "surface.png"  # a law of this name is not overwritten by the picture
    law.write_bytes(SHIPPED.read_bytes())
    over = CliRunner().invoke(main, ["plot", str(law), "--table", str(TABLE), "--out", str(tmp_path / "out")])
    assert over.exit_code == 2
    assert "surface.png: would overwrite" in over.stderr
    assert law.read_bytes() == SHIPPED.read_bytes()
    bad = CliRunner().invoke(main, ["plot", str(SHIPPED), "--table", "nowhere.csv", "--out", str(tmp_path / "bad")])
    assert bad.exit_code == 2
    assert not (tmp_path / "bad").exists()


def test_report_on_rows_that_no_fit_has_seen(tmp_path):
    lines = TABLE.with_name("directions.csv").read_text().splitlines()
    (tmp_path / "some.csv").write_text("\n".join(lines[:101]) + "\n")
    (tmp_path / "some.json").write_text(TABLE.with_suffix(".json").read_text())
    seen = CliRunner().invoke(main, ["report", str(SHIPPED), "--table", str(tmp_path / "some.csv")])
    assert seen.exit_code == 0, seen.output
    assert "100 loads" in seen.output
    assert "extrapolated: 0" in seen.output
