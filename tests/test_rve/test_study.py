"""The study: every file is there, and its numbers are those of the solve."""

import csv
import json

import numpy as np
import pytest

from rve import grid
from rve.common import heard_by
from rve.geometry import FOUR_IN_ONE
from rve.simulation import ROUND_OFF, SimulationOptions, copies, study

PICTURES = [f"fig_{n:02d}.png" for n in (9, 10, 11, 12, 13, 14, 15, 16, 17)]


@pytest.mark.slow
def test_one_command_writes_every_table_and_picture(tmp_path):
    told = []
    alpha, beta = np.array([0.0, 0.0, 20.0, 20.0, 45.0]), np.array([0.0, 45.0, 45.0, 60.0, 90.0])
    options = SimulationOptions(max_steps=80)
    with heard_by(told.append):
        found = study.run_study(tmp_path / "new", alpha, beta, options)
    names = {path.name for path in (tmp_path / "new").iterdir()}
    expected = {"cases.csv", "comparison.md", "study.json", "history_0_0.csv", "history_45_90.csv", *PICTURES}
    assert names == expected
    assert [one.work for one in told if one.work.startswith("drawing")] == [f"drawing {name}" for name in PICTURES]
    with (tmp_path / "new" / "cases.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["case"]) for row in rows] == [1, 2, 3, 4, 5]
    assert [row["status"] for row in rows] == list(found.run.rest.status)
    assert set(found.run.rest.status) == {"step-limit"}
    assert float(rows[1]["E11"]) == pytest.approx(float(rows[1]["E11_direct"]), abs=2e-3)
    with (tmp_path / "new" / "history_0_0.csv").open() as file:
        steps = list(csv.DictReader(file))
    assert len(steps) == found.run.rest.steps[0]
    assert float(steps[-1]["t_s"]) == pytest.approx(sum(float(step["h_s"]) for step in steps))
    assert float(steps[-1]["E22"]) == pytest.approx(found.run.E[0, 2], abs=1e-12)
    record = json.loads((tmp_path / "new" / "study.json").read_text())
    assert record["options"]["max_steps"] == 80
    assert ["converged cases", "190 of 190", "0 of 5", ""] in record["comparison"]
    assert found.run.history.rise.max() <= ROUND_OFF


@pytest.mark.release
def test_all_cases_of_the_paper_give_its_figures_fall_in_energy_and_keep_their_links():
    found = study.solve_study(*grid())
    rows = {row[0]: row[2] for row in study.comparison(found)}
    assert rows["converged cases"] == "190 of 190"
    assert found.run.history.rise.max() <= ROUND_OFF
    assert found.run.rest.contacts.links_intact.all()
    # No force at a pair of rings that the ten rings of the paper do not contain.
    assert found.run.rest.lam[:, copies(FOUR_IN_ONE) == 0].max() == 0.0
    error = np.abs(found.run.E - found.table.E)[found.table.unique].max(axis=1)
    # Twice the stiffness would halve these: they are penetration, not an error of either method.
    assert error.max() < 5e-6
    assert np.median(error) < 2e-6
    assert 1000.0 < found.run.rest.time[189] < 1600.0
