"""The pictures show what the law says, and the files are whole."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from homogenize.cli import main
from homogenize.fitting.bounds import bounds_of
from homogenize.fitting.rows import rows_from_table, with_mirror
from homogenize.io import DEFAULT_LAW, default_law
from homogenize.laws.pictures import surface_height
from homogenize.view import draw_locking, draw_strength, surface_with_gap
from rve.common.drawing.space import parts
from rve.table import read_table

TABLE = Path(__file__).parent / "data" / "table190.csv"


def test_rows_lie_on_the_drawn_surface():
    rows = rows_from_table(read_table(TABLE))
    E = rows.E[rows.unique]
    T = surface_height(default_law(), 0.5 * (E[:, 0] - E[:, 2]), E[:, 1])
    assert np.abs(T - 0.5 * (E[:, 0] + E[:, 2])).max() < 1e-10


def test_the_surface_of_the_page_is_where_the_law_locks():
    law, rows = default_law(), rows_from_table(read_table(TABLE))
    surface, lines, balls = (mesh for mesh, *_ in parts(draw_locking(law, rows)).values())
    for points in (surface.points, lines.points):  # E12, E22, E11
        assert np.abs(law.cut(points[:, [2, 0, 1]].astype(float)).violation).max() < 1e-6
    both = with_mirror(rows)
    centre = balls.points.reshape(len(both), -1, 3).mean(axis=1)
    assert np.abs(centre[:, [2, 0, 1]] - both.E).max() < 5e-3
    E, gap = surface_with_gap(law, rows, 31)
    known = np.isfinite(gap)
    S, bounds = law.cut(E[known]).S, bounds_of(rows)
    assert (law.support(S) <= bounds.upper(S) + 1e-9).all()
    assert gap[known].max() == pytest.approx((bounds.upper(S) - bounds.lower(S)).max())
    assert gap[known].max() > 1e-4


def test_the_strength_of_the_page_is_where_rings_yield():
    known = default_law().strength
    assert known is not None
    surface, *nets = (mesh for mesh, *_ in parts(draw_strength(known, 300.0)).values())
    used = known.utilisation(surface.points[:, [2, 0, 1]].astype(float), 300.0)
    assert np.abs(used - 1.0).max() < 1e-5
    for net in nets:
        points = net.points[:, [2, 0, 1]].astype(float)
        assert np.abs(known.collapse_utilisation(points, 300.0) - 1.0).max() < 1e-5


def test_pictures_are_written(tmp_path):
    words = ["plot", str(DEFAULT_LAW), "--table", str(TABLE), "--out", str(tmp_path / "out"), "--html"]
    run = CliRunner().invoke(main, words)
    assert run.exit_code == 0, run.output
    files = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert files == ["errors.png", "law.html", "pictures.json", "sections.png", "strains.png", "surface.png"]
    pictures = [name for name in files if name.endswith(".png")]
    assert all((tmp_path / "out" / name).read_bytes().startswith(b"\x89PNG") for name in pictures)
    law = tmp_path / "out" / "surface.png"  # a law of this name is not overwritten by the picture
    law.write_bytes(DEFAULT_LAW.read_bytes())
    over = CliRunner().invoke(main, ["plot", str(law), "--table", str(TABLE), "--out", str(tmp_path / "out")])
    assert over.exit_code == 2
    assert "surface.png: would overwrite" in over.stderr
    assert law.read_bytes() == DEFAULT_LAW.read_bytes()
    bad = CliRunner().invoke(main, ["plot", str(DEFAULT_LAW), "--table", "nowhere.csv", "--out", str(tmp_path / "bad")])
    assert bad.exit_code == 2
    assert not (tmp_path / "bad").exists()
