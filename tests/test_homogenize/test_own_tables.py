"""Tables from elsewhere: any scale, order and variant of CSV give one law; rows that scatter are listed and mended."""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import homogenize
import homogenize.laws
import macro_fem
import rve
from homogenize.fitting import mended, normality, random_loads, rows_from_table
from rve.common import Array, double_dot
from tests.commands import run

DATA = Path(__file__).parent / "data"

LOADS = ["S11", "S12", "S22"]
ROWS = ["E11", "E12", "E22", *LOADS]
SCENE = macro_fem.Scene(macro_fem.Rectangle(600, 400), [macro_fem.Corners(gather=0.9)], macro_fem.Mesh(6))


@pytest.fixture(scope="module")
def ours() -> homogenize.Law:
    return homogenize.fit_table(DATA / "table190.csv").law


@pytest.fixture(scope="module")
def frame() -> pd.DataFrame:
    return pd.read_csv(DATA / "table190.csv")


def scaled(frame: pd.DataFrame) -> pd.DataFrame:
    plain = frame[ROWS].copy()
    plain[LOADS] *= 9.81e6
    return plain


VARIANTS = {
    "scaled": scaled,
    "shuffled": lambda frame: scaled(frame).sample(frac=1.0, random_state=3),
    "doubled": lambda frame: pd.concat([scaled(frame)] * 2),
    "angles": lambda frame: frame[["alpha_deg", "beta_deg", *ROWS[:3]]],
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_plain_rows_give_the_law_of_our_table(
    variant: str, frame: pd.DataFrame, ours: homogenize.Law, tmp_path: Path
) -> None:
    own = VARIANTS[variant](frame)
    own.to_csv(tmp_path / "own.csv", sep=";", index=variant == "doubled")  # whose index repeats
    S = random_loads()
    for law in (homogenize.fit(own).law, homogenize.fit_table(tmp_path / "own.csv").law):
        assert np.abs(law.support(S) - ours.support(S)).max() < 1e-9
        assert law.cell is None


@pytest.mark.slow
def test_arrays_to_a_curtain_that_is_ours(frame: pd.DataFrame, ours: homogenize.Law, tmp_path: Path) -> None:
    """With the areal mass that the law of our rings knows; and what only rings tell is refused in a sentence."""
    assert ours.cell is not None
    E, S = frame[ROWS[:3]].to_numpy(), 1e-3 * frame[LOADS].to_numpy()
    law = homogenize.fit_rows(E, S, homogenize.FitOptions(areal_mass=ours.cell.areal_mass_kg_per_m2)).law
    law.save(tmp_path / "law.json")
    told = homogenize.fit_rows(E, S, homogenize.FitOptions(cell=rve.Cell())).law
    along = [macro_fem.solve(SCENE, one).summary.mean_height_mm for one in (ours, told)]
    assert along[1] == pytest.approx(along[0], abs=1e-9 * 400.0)
    crossed = replace(SCENE, mesh=macro_fem.Mesh(6, pattern="crossed"))
    answers = [macro_fem.solve(crossed, one) for one in (ours, homogenize.load_law(tmp_path / "law.json"))]
    rings, own = (answer.summary for answer in answers)
    assert own.mean_height_mm == pytest.approx(rings.mean_height_mm, abs=1e-9 * 400.0)
    assert own.mass_kg == pytest.approx(rings.mass_kg, rel=1e-12)
    for one, other in zip(rings.support_forces[0].points, own.support_forces[0].points, strict=True):
        assert one.force_N == pytest.approx(other.force_N, abs=1e-6)
    for ask in (answers[1].rings, lambda: macro_fem.solve(SCENE, macro_fem.EveryRing(law))):
        with pytest.raises(rve.InputError, match="fitted to a table of rings"):
            ask()
    answers[1].save(tmp_path / "out", picture=False)
    words = ["localize", tmp_path / "out", "--out", tmp_path / "rings"]
    assert "fitted to a table of rings" in run("macro_fem", *words, codes=(2,)).stderr
    words = ["strength", tmp_path / "law.json", "--S", "1,0,1"]
    assert "only a law of rings has one" in run("homogenize", *words, codes=(2,)).stderr


TEXT = "E11,E12,E22,S11,S12,S22\n.1,0,-.1,1,0,0\n-.1,0,.1,0,0,1\n.04,.01,.04,1,1,1\n.05,0,.05,1,0,1\n"
PLAIN = {
    "index": TEXT.replace("E11", ",E11").replace("\n", "\n0,").removesuffix("0,"),
    "spaces": TEXT.replace(",", " , "),
    "tabs": TEXT.replace(",", "\t"),
    "comments": "# measured in May\n\n" + TEXT.replace("\n-.1", "\n# a slip\n-.1"),
    "mark": "\ufeff" + TEXT.replace("\n", "\r\n"),
    "quotes": TEXT.replace("E11", '"E11"'),
    "blanks": TEXT + ",,,,,\n",
    "more": TEXT.replace("S22\n", "S22,who\n").replace("1\n", "1,me\n").replace(",0\n", ",0,me\n"),
}


@pytest.mark.parametrize("name", PLAIN)
def test_variants_of_csv_are_one_table(name: str, tmp_path: Path) -> None:
    (tmp_path / "own.csv").write_text(PLAIN[name], encoding="utf-8", newline="")
    table = rve.read_table(tmp_path / "own.csv")
    assert table.E.tolist() == [[0.1, 0.0, -0.1], [-0.1, 0.0, 0.1], [0.04, 0.01, 0.04], [0.05, 0.0, 0.05]]
    assert table.S[2].tolist() == [1.0, 1.0, 1.0]
    assert table.beta_deg.tolist() == pytest.approx([0.0, 90.0, 0.0, 45.0], abs=1e-6)


REFUSED = {
    "lines": (TEXT.replace("-.1,0,.1", "# no\n-.1,0,x"), "line 4, column E22: 'x' is not a number"),
    "decimals": (TEXT.replace(",", ";").replace(".", ","), "column E11: ',1' is not a number; has a decimal comma"),
    "loads": (TEXT.replace("S12", "T12"), "tells no loads: give the columns S11, S12, S22 or alpha_deg, beta_deg"),
    "percent": (
        TEXT.replace(".1,0,-.1", "12,0,-5"),
        "line 2, column E11: with E12 and E22 it squeezes",
    ),
    "line": (TEXT.replace(".04,.01,.04,1,1,1", ".06,0,.03,2,0,1"), "one line"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_table_is_one_sentence(name: str, tmp_path: Path) -> None:
    text, sentence = REFUSED[name]
    (tmp_path / "own.csv").write_text(text)
    with pytest.raises(rve.InputError, match=sentence):
        homogenize.fit_table(tmp_path / "own.csv")


def noisy(size: float) -> tuple[Array, Array]:
    """Strains of an ellipsoid with an error, and their loads."""
    S = np.array([[a, c, b] for a, b, c in product((0.2, 0.5, 1.0), (0.2, 0.5, 1.0), (0.0, 0.1, 0.19))])
    E = 0.1 * S / np.sqrt(double_dot(S, S))[:, None]
    return E + np.random.default_rng(1).normal(scale=size, size=E.shape), S


def test_rows_that_contradict_each_other_are_listed_and_left_out() -> None:
    E, S = noisy(0.0)
    E[4] *= 1.2
    with pytest.raises(rve.InputError, match=r"row 4 contradicts row \d+ .*, by \d\.\de-02 of strain; without rows 4 "):
        homogenize.fit_rows(E, S)
    law = homogenize.fit_rows(E, S, homogenize.FitOptions(contradictions="drop")).law
    rest = np.arange(len(E)) != 4
    assert law.support(S) == pytest.approx(homogenize.fit_rows(E[rest], S[rest]).law.support(S), abs=1e-12)
    assert law.report is not None
    assert any("row 4 contradicts" in one for one in law.report.dropped)


def test_mended_strains_are_the_nearest_that_agree() -> None:
    """They agree; rows that agree stay; and the projection onto a cone obeys Moreau: what was moved is at right angles
    to what is left, and does no work on other strains that agree."""
    E, S = noisy(3e-3)
    rows = rows_from_table(rve.StrainTable.from_rows(E, S))
    assert not normality(rows).holds
    found = mended(rows)
    assert normality(found).holds
    moved = rows.E - found.E
    assert double_dot(moved, found.E).sum() == pytest.approx(0.0, abs=1e-12)
    rng, exact = np.random.default_rng(2), rows.S / np.sqrt(double_dot(rows.S, rows.S))[:, None]
    for stretch in rng.uniform(0.0, 1.0, size=20):
        assert double_dot(moved, stretch * exact + rng.normal() * np.array([1.0, 0.0, 1.0])).sum() < 1e-12
    assert np.abs(mended(found).E - found.E).max() < 1e-9


def test_rings_of_a_table_that_does_not_tell_them(frame: pd.DataFrame, tmp_path: Path) -> None:
    scaled(frame).to_csv(tmp_path / "own.csv")
    words = ["fit", tmp_path / "own.csv", "--out", tmp_path / "law.json", "--kind", "outer"]
    run("homogenize", *words, "--cell", "5,0.5")
    cell = homogenize.load_law(tmp_path / "law.json").cell
    assert cell is not None
    assert cell.areal_mass_kg_per_m2 == pytest.approx(2.784781677, rel=1e-6)
    run("homogenize", *words, "--cell", "5,0.5,4-in-1", "--areal-mass", "3")
    cell = homogenize.load_law(tmp_path / "law.json").cell
    assert (cell and cell.areal_mass_kg_per_m2) == 3.0
    run("homogenize", *words, "--cell", "inner=9,wire=1")
    again = homogenize.load_law(tmp_path / "law.json").cell
    assert (again and again.areal_mass_kg_per_m2) == pytest.approx(2.784781677, rel=1e-6)
    for option, sentence in (
        (["--cell", "5"], "--cell = '5': give R1,R2 in mm, or two sizes by name"),
        (["--cell", "5,0.5,knit"], "weave = 'knit': is not one of 4-in-1, 6-in-1"),
        (["--areal-mass", "-1"], "--areal-mass = -1"),
        (["--kind", "net"], "is the law of 4-in-1 rings that are known"),
    ):
        assert sentence in run("homogenize", *words, *option, codes=(2,)).stderr


def test_a_table_without_mirror_images_adds_none() -> None:
    E, S = noisy(0.0)
    options = homogenize.FitOptions("outer", mirrored=False)
    rows = homogenize.fit_rows(E, S, options).law.rows
    assert rows is not None
    assert not rows.is_mirrored
    table = rve.StrainTable.from_pandas(rve.StrainTable.from_rows(E, S).to_pandas())
    assert np.array_equal(table.E, E)


def test_loads_of_unit_trace_may_be_rounded_beyond_one() -> None:
    """A load of rank one with the other principal value -2e-16 has a component of 1 + 2e-16; a report ended there."""
    eps = float(np.finfo(float).eps)
    worst = homogenize.laws.Misfit(1, 0.0, 0.0, (1.0 + eps, 0.0, -eps))
    assert worst.worst_S[0] > 1.0
    with pytest.raises(rve.InputError, match=r"worst_S\[0\] = 1.001"):
        homogenize.laws.Misfit(1, 0.0, 0.0, (1.001, 0.0, 0.0))
