"""The pictures show what the law says, and the files are whole."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from homogenize import default_law
from homogenize.cli import main
from homogenize.fitting import rows_from_table
from homogenize.io import DEFAULT_LAW
from homogenize.laws import locking_surface, strength_loads
from rve import read_table

TABLE = Path(__file__).parent / "data" / "table190.csv"


def test_rows_lie_on_the_drawn_surface():
    rows = rows_from_table(read_table(TABLE))
    E = rows.E[rows.unique]
    assert np.abs(locking_surface(default_law(), 0.5 * (E[:, 0] - E[:, 2]), E[:, 1]) - E).max() < 1e-10


def test_drawn_strength_is_that_of_the_law():
    law = default_law()
    used, lines = (law.strength.utilisation, law.strength.collapse_utilisation), law.plot_strength(500.0)[2].lines
    for limit, S, line in zip(used, strength_loads(law.strength, 500.0), lines[:2], strict=True):
        along, across = line.get_data()
        drawn = np.vstack([S.reshape(-1, 3), np.column_stack([along, 0.0 * along, across])])
        assert limit(drawn, 500.0) == pytest.approx(1.0)


@pytest.mark.slow
def test_pictures_are_written(tmp_path):
    words = ["plot", str(DEFAULT_LAW), "--table", str(TABLE), "--out", str(tmp_path / "out")]
    run = CliRunner().invoke(main, words)
    assert run.exit_code == 0, run.output
    files = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    assert sorted(files) == ["errors.png", "pictures.json", "sections.png", "strains.png", "surface.png"]
    assert all(files[name].startswith(b"\x89PNG") for name in files if name.endswith(".png"))
    law = tmp_path / "out" / "surface.png"  # a law of this name is not overwritten by the picture
    law.write_bytes(DEFAULT_LAW.read_bytes())
    over = CliRunner().invoke(main, ["plot", str(law), "--table", str(TABLE), "--out", str(tmp_path / "out")])
    assert over.exit_code == 2
    assert "surface.png: would overwrite" in over.stderr
    assert law.read_bytes() == DEFAULT_LAW.read_bytes()
