"""Sizes that rings cannot resolve and pitches that do not fit are told in a user's words."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

import macro_fem
from homogenize import default_law
from macro_fem.cli import main
from macro_fem.rings.ring_scene import ring_scene

LAW = default_law()
B_X, B_Y = LAW.cell.b_x_mm, LAW.cell.b_y_mm


def command(group, *arguments):
    return CliRunner().invoke(group, [str(one) for one in arguments])


@pytest.mark.parametrize(
    ("keys", "count", "asked"), [("pitch = 129", 24, 129.0), ("count = 24", 24, None), ("pitch = 125", 25, 125.0)]
)
def test_the_pitch_that_fits_is_told(tmp_path, keys, count, asked):
    """A pitch of 129 mm does not divide 3000 mm: 23 spaces of 130.4 mm."""
    (tmp_path / "scene.toml").write_text(
        f"[curtain]\nwidth = 3000\nheight = 500\n[mesh]\ncells = 24\n[support]\nkind = 'hooks'\n{keys}\n"
    )
    found = command(main, "run", tmp_path / "scene.toml", "--out", tmp_path / "out", "--no-picture")
    assert found.exit_code == 0, found.output
    (hooks,) = json.loads((tmp_path / "out" / "summary.json").read_text())["support_forces"]
    assert hooks["pitch_mm"] == pytest.approx(3000.0 / (count - 1))
    assert hooks["pitch_asked_mm"] == asked
    x = [point["at_mm"][0] for point in hooks["points"]]
    assert np.diff(x) == pytest.approx(hooks["pitch_mm"])
    assert f"hooks: {count}, {hooks['pitch_mm']:g} mm apart" in found.output
    assert ("does not divide" in found.output) == (asked == 129.0)
    assert found.output.startswith("no --law: rings of r1 = 5 mm and r2 = 0.5 mm, 4-in-1, steel")


def test_nearly_whole_cells_keep_the_rings_at_the_corners():
    """75.9 mm are six cells of 12.646 mm: the corner rings must not go, nor the support move by 1.9 mm."""
    exact, rounded = (
        ring_scene(macro_fem.Scene(macro_fem.Rectangle(6 * B_X, height), [macro_fem.Corners()]), LAW)
        for height in (6 * B_Y, 75.9)
    )
    assert exact.notes == ()
    assert "height = 75.9 mm is taken as 6 whole cells" in rounded.notes[0]
    assert len(rounded.mesh.X) == len(exact.mesh.X)
    for (_, one), (_, other) in zip(exact.groups, rounded.groups, strict=True):
        assert rounded.mesh.X[other] == pytest.approx(exact.mesh.X[one])
