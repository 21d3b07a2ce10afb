"""The whole chain, as the README runs it, on a coarse curtain."""

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from homogenize.query import strain_answer
from rve.sweep import solve_table

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    """Folder and summary of examples/curtain.py with 12 cells along the width."""
    sys.path.insert(0, str(ROOT / "examples"))
    try:
        import curtain
    finally:
        sys.path.pop(0)
    out = tmp_path_factory.mktemp("chain")
    return out, curtain.run(out, cells=12)


def test_every_file_and_picture_is_there(chain):
    out, _ = chain
    assert len(pd.read_csv(out / "table.csv")) == 190
    assert json.loads((out / "law.json").read_text())
    for picture in ("cell.png", "law/surface.png", "curtain/curtain.png"):
        assert (out / picture).stat().st_size > 10_000
    assert (out / "curtain" / "curtain.vtu").exists()


def test_the_curtain_is_what_its_summary_says(chain):
    out, summary = chain
    assert summary["status"] == "converged"
    assert json.loads((out / "curtain" / "summary.json").read_text())["mean_height_mm"] == summary["mean_height_mm"]
    # Primal and dual value bracket the potential, -weight times mean height up to the reference level.
    assert summary["potential_dual_N_mm"] <= summary["potential_primal_N_mm"] + 1e-9
    assert 0 < summary["relative_gap"] < 1e-4
    # Bounds of the continuous problem by another element (examples/corner_hung.toml) hold the mean height.
    assert 418.0 < summary["mean_height_mm"] < 426.0
    assert summary["total_load_N"][1] == pytest.approx(-27.32, abs=0.01)


def test_the_law_predicts_loads_off_the_grid(chain):
    out, _ = chain
    rng = np.random.default_rng(4)
    alpha, beta = rng.uniform(-45.0, 45.0, 60), rng.uniform(1.0, 89.0, 60)
    truth = solve_table(alpha, beta)
    answers = [strain_answer(out / "law.json", a, b) for a, b in zip(alpha, beta, strict=True)]
    predicted = np.array([[answer[name] for name in ("E11", "E12", "E22")] for answer in answers], dtype=float)
    unique = truth.unique & np.array([answer["unique"] for answer in answers], dtype=bool)
    assert unique.sum() > 40
    np.testing.assert_allclose(predicted[unique], truth.E[unique], atol=5e-3)
