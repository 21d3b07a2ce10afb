"""Mutated scenes of rings that flow, and mutated strengths of their laws: one sentence and nothing written, or an
answer with a certified limit."""

import json
from copy import deepcopy

import numpy as np
import pytest
from click.testing import CliRunner

from homogenize.io import DEFAULT_LAW
from macro_fem.cli import main

SCENE = """[curtain]\nwidth = 100\nheight = 100\n[mesh]\ncells = 2\n[support]\nkind = "top"\ngather = {gather}
[load]\ngravity = {gravity}\n[[load.edge]]\nedge = "bottom"\nforce = [0.0, {force}]
[solver]\nkind = "plastic"\ntolerance = {tolerance}\nstabilising_tension = {stabilising_tension}
max_iterations = {max_iterations}\nadapt = {adapt}\nstrings = {strings}\n[material]\nyield = {yield}
ultimate = {ultimate}
"""
PLAIN = {"gather": 0.9, "gravity": 9.81, "force": -1.0, "tolerance": 1e-9, "stabilising_tension": 1e-6}
PLAIN |= {"max_iterations": 400, "adapt": 0, "strings": "false", "yield": 235.0, "ultimate": 360.0}
VALUES = ("nan", "-1", "0", "1e300", "1e-300", "1e12", '"x"', "[]", "true", "inf", "")
ROWS = ("S", "cauchy", "first_yield_1_per_mm", "collapse_1_per_mm", "compliance_mm_per_N")
NUMBERS = (np.nan, np.inf, -1.0, 0.0, 1e300, 1e-300, 1e12, "x", None, [], True)
LOADS = ([np.nan, 0.0, 1.0], [-1.0, 0.0, 1.0], [0.0, 0.0, 0.0], [1.0, 5.0, 1.0], [1.0, 0.0], "x", None)
WHOLE = {
    "joint": ("butted", "butted:90", "butted:nan", "", "glued", None, 3),
    "material": (None, {}, {"name": "steel"}, 3, "steel"),
    "is_mirrored": (False, 3),
    "error": (None, 3),
}
MATERIAL = {
    "yield_N_per_mm2": (1e-300, -1, 0, 1e300, np.nan, None, 500.0, "x"),
    "ultimate_N_per_mm2": (1e-300, -1, 0, 1e300, np.nan, None, 100.0, "x"),
    "young_N_per_mm2": (-1, 0, 1e300, np.nan, None, "x"),
}


def scenes():
    """Name and text of scenes with one value changed."""
    for key in PLAIN:
        for value in VALUES:
            yield f"{key} = {value}", SCENE.format(**PLAIN | {key: value})


def strengths():
    """Name and mutated table of a law's strength."""
    known = json.loads(DEFAULT_LAW.read_text())["strength"]

    def changed(name, change):
        table = deepcopy(known)
        change(table)
        return name, table

    for key in ROWS:
        for value in NUMBERS if key not in ROWS[:2] else LOADS:
            yield changed(f"{key}[7] = {value}", lambda table, key=key, value=value: table[key].__setitem__(7, value))
        yield changed(f"{key} short", lambda table, key=key: table[key].pop())
        yield changed(f"{key} empty", lambda table, key=key: table[key].clear())
        yield changed(f"{key} missing", lambda table, key=key: table.pop(key))
    for key, values in WHOLE.items():
        for value in values:
            yield changed(f"{key} = {value}", lambda table, key=key, value=value: table.update({key: value}))
    for key, values in MATERIAL.items():
        for value in values:
            yield changed(
                f"{key} = {value}", lambda table, key=key, value=value: table["material"].update({key: value})
            )
    for count in (0, 1, 3, 5, 20):
        yield changed(f"{count} loads", lambda table, n=count: table.update({key: table[key][:n] for key in ROWS}))
    yield "none", None


CASES = [(name, text, "scene") for name, text in scenes()] + [(name, table, "law") for name, table in strengths()]
QUICK = {"yield = 1e-300", "ultimate = 1e-300", "yield_N_per_mm2 = 1e-300", "none", "3 loads", "force = nan"}


@pytest.mark.parametrize(
    ("name", "value", "kind"),
    [
        pytest.param(*case, id=f"{case[2]}: {case[0]}", marks=() if case[0] in QUICK else pytest.mark.release)
        for case in CASES
    ],
)
def test_mutated_scenes_and_strengths_end_in_a_sentence_or_an_answer(name, value, kind, tmp_path):
    scene, law, out = tmp_path / "scene.toml", tmp_path / "law.json", tmp_path / "out"
    scene.write_text(value if kind == "scene" else SCENE.format(**PLAIN))
    words = ["run", str(scene), "--out", str(out), "--no-picture"]
    if kind == "law":
        law.write_text(json.dumps(json.loads(DEFAULT_LAW.read_text()) | {"strength": value}))
        words += ["--law", str(law)]
    run = CliRunner().invoke(main, words)
    assert isinstance(run.exception, SystemExit | None)
    assert run.exit_code in (0, 1, 2)
    assert "unforeseen" not in run.output
    if run.exit_code == 2:
        assert run.output.startswith("Error: ")
        assert run.output.count("\n") == 1
        assert not out.exists()
        return
    summary = json.loads((out / "summary.json").read_text())
    low, high = summary["limit_interval"]
    assert 0.0 <= low <= summary["limit_factor"] * (1.0 + 1e-9)
    assert summary["limit_factor"] <= high
    assert (run.exit_code == 0) == (summary["status"] == "converged" and summary["holds"] is not False)
