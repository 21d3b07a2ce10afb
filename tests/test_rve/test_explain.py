"""What a run of rings leaves out: the same answer with it forced, and words that agree with what was done."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from rve.cli import main
from rve.common.errors import InputError
from rve.equilibrium.interior_point import DirectOptions
from rve.equilibrium.system import Equations
from rve.explain import FEATURES, checked_force, decisions, motion_terms, moving_decisions
from rve.geometry.cell import Cell
from rve.geometry.kinematics import cauchy_line_load
from rve.geometry.pairs import unlisted_gap, unlisted_pairs, widened
from rve.geometry.pose import start_pose
from rve.geometry.weave import FOUR_IN_ONE, SIX_IN_ONE, supercell
from rve.paper import ten_rings
from rve.paper.motion import TERMS
from rve.paper.stewart_trinkle import Dynamics, StewartTrinkleOptions, gyroscopic_torque, solve
from rve.solve import solve_table

# Strains end at mu_end / force: 1e-13 over forces of 1e-4 and more.
TOLERANCE = 1e-9
LOADS = np.array([0.0, 20.0, 45.0, 10.0]), np.array([45.0, 30.0, 60.0, 80.0])


@pytest.fixture(scope="module")
def plain():
    return solve_table(Cell(), LOADS)


def said(table):
    """Decisions by feature."""
    return {decision.feature: decision for decision in decisions(table.provenance)}


@pytest.mark.parametrize("feature", [name for name in FEATURES if name != "constraints"])
def test_a_forced_feature_changes_no_strain(plain, feature):
    forced = solve_table(Cell(), LOADS, options=DirectOptions(force=(feature,)))
    assert forced.converged.all()
    assert np.abs(forced.E - plain.E).max() < TOLERANCE
    assert not said(plain)[feature].used
    assert said(forced)[feature].used
    assert "forced" in said(forced)[feature].why


def test_all_constraints_written_out_change_no_strain(plain):
    forced = solve_table(Cell(), (LOADS[0][:1], LOADS[1][:1]), options=DirectOptions(force=("constraints",)))
    assert np.abs(forced.E - plain.E[:1]).max() < TOLERANCE
    assert all(said(forced)[term].used for term in TERMS)
    assert forced.iterations[0] > 3 * plain.iterations[0]  # time steps, not Newton's


def test_the_words_agree_with_the_work(plain):
    work = plain.provenance["work"]
    assert work["symmetric"] == work["cases"] == 4
    assert f"{work['least_near']} to {work['most_near']} of the 28" in said(plain)["far-pairs"].why
    both = said(solve_table(Cell(), LOADS, options=DirectOptions(force=("asymmetry", "unlisted-pairs"))))
    assert both["asymmetry"].used
    assert both["unlisted-pairs"].used
    assert "of the 161" in both["far-pairs"].why
    assert set(said(plain)) == set(FEATURES)


def test_motion_brings_the_terms_it_needs():
    assert motion_terms(()) == motion_terms(("far-pairs",)) == ()
    assert motion_terms(("inertia",)) == ("damping", "inertia")
    assert checked_force(("all",)) == FEATURES
    with pytest.raises(InputError, match="friction"):
        checked_force(("friction",))


def test_unlisted_pairs_are_listed_when_they_overlap(plain):
    """A weave that forgets its side neighbours: rings would overlap there, and the run sees it."""
    kept = np.array([a != b or (i, j) not in ((1, 0), (1, 1), (1, -1)) for a, b, i, j in FOUR_IN_ONE.pairs.tolist()])
    forgetful = replace(FOUR_IN_ONE, pairs=FOUR_IN_ONE.pairs[kept], linked=FOUR_IN_ONE.linked[kept])
    found = solve_table(Cell(weave=forgetful), ([10.0], [80.0]))
    assert found.provenance["work"]["widened"]
    assert said(found)["unlisted-pairs"].used
    assert np.abs(found.E[0] - plain.E[3]).max() < TOLERANCE


def test_every_pair_is_listed_once():
    wide = widened(FOUR_IN_ONE)
    names = {tuple(pair) for pair in wide.pairs.tolist()}
    assert len(names) == len(wide.pairs) == 161
    assert not names & {(b, a, -i, -j) for a, b, i, j in names}
    assert set(map(tuple, FOUR_IN_ONE.pairs.tolist())) <= names
    assert not len(unlisted_pairs(wide).pairs)
    assert len(unlisted_pairs(supercell(FOUR_IN_ONE, 2, 2)).pairs)


def test_the_gap_of_unlisted_pairs_is_a_bound():
    pose = start_pose(FOUR_IN_ONE, 1)
    squeezed = replace(pose, lattice=pose.lattice * np.array([0.3, 0.3, 1.0]))
    assert unlisted_gap(pose, FOUR_IN_ONE, 0.1)[0] > 0.3
    assert unlisted_gap(squeezed, FOUR_IN_ONE, 0.1)[0] < 0.0


def test_thick_wire_has_more_pairs_in_reach():
    thick, thin = (solve_table(Cell(5.0, r2), ([0.0], [45.0])).provenance["work"] for r2 in (1.2, 0.25))
    assert thick["most_near"] > thin["most_near"]


def test_a_weave_without_symmetry_uses_all_coordinates():
    large = supercell(FOUR_IN_ONE, 2, 1)
    found = solve_table(Cell(weave=large), ([0.0], [45.0]))
    assert found.provenance["work"]["symmetric"] == 0
    assert said(found)["asymmetry"].used
    assert solve_table(Cell(5.0, 0.625, SIX_IN_ONE), ([0.0], [45.0])).provenance["work"]["symmetric"] == 1


def test_gyroscopic_torques_vanish_unless_a_ring_spins_about_its_axis():
    equations, options = Equations.of(FOUR_IN_ONE, 0.1), StewartTrinkleOptions(gyroscopic=True)
    dynamics = Dynamics.of(equations, options)
    pose = start_pose(FOUR_IN_ONE, 1)
    tilt = np.concatenate([np.zeros((1, 6)), np.cross(pose.normals, [0.3, 0.2, 0.1]).reshape(1, 6)], axis=1)
    assert np.abs(gyroscopic_torque(pose, tilt, dynamics)).max() < 1e-15 * dynamics.axial.max()
    spinning = tilt + np.concatenate([np.zeros((1, 6)), pose.normals.reshape(1, 6)], axis=1)
    torque = gyroscopic_torque(pose, spinning, dynamics)
    rings = ten_rings.start(FOUR_IN_ONE, options)
    kind = FOUR_IN_ONE.rings[:, 0]
    w = spinning[0, 6:].reshape(2, 3)[kind]
    rings = replace(rings, v=np.concatenate([np.zeros((10, 3)), w], axis=1))
    full = ten_rings.gyroscopic(rings, ten_rings.mass_matrix(rings, 0.1, options)).reshape(10, 6)[:, 3:]
    scale = options.load * options.r1_mm**2
    assert torque[0, :3] * scale == pytest.approx(full[kind == 0].sum(axis=0), rel=1e-9)
    assert torque[0, 3:] * scale == pytest.approx(full[kind == 1].sum(axis=0), rel=1e-9)
    assert not gyroscopic_torque(pose, spinning, Dynamics.of(equations, StewartTrinkleOptions())).any()


def test_motion_without_inertia_comes_to_rest_at_the_same_place():
    s = cauchy_line_load([20.0], [30.0])
    equations = Equations.of(FOUR_IN_ONE, 0.1)
    slow, fast = (solve(s, equations, StewartTrinkleOptions(inertia=inertia)) for inertia in (True, False))
    assert fast.status[0] == "converged"
    assert fast.pose.lattice == pytest.approx(slow.pose.lattice, abs=1e-8)
    assert not np.array_equal(fast.pose.lattice, slow.pose.lattice)


def run(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments])


def test_case_explains_itself_beside_its_json():
    result = run("case", "--alpha", 20, "--beta", 30, "--explain", "--force", "asymmetry")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["status"] == "converged"
    lines = {line.split()[0]: line for line in result.stderr.splitlines()}
    assert set(lines) == set(FEATURES)
    assert "left out" in lines["inertia"]
    assert " used " in lines["asymmetry"]


def test_the_paper_s_scheme_explains_itself(tmp_path):
    arguments = ("table", "--out", tmp_path / "t.csv", "--alpha", 0, "--beta", 45, "--method", "stewart-trinkle")
    result = run(*arguments, "--explain", "--force", "gyroscopic")
    assert result.exit_code == 0, result.output
    provenance = json.loads((tmp_path / "t.json").read_text())
    used = {decision.feature: decision.used for decision in moving_decisions(provenance)}
    assert used == {"damping": True, "inertia": True, "gyroscopic": True, "constraints": False}
    assert "gyroscopic      used" in result.stderr


@pytest.mark.parametrize("method", ["direct", "stewart-trinkle"])
def test_an_unknown_feature_ends_in_one_sentence(tmp_path, method):
    result = run("table", "--out", tmp_path / "t.csv", "--method", method, "--force", "friction")
    assert result.exit_code == 2
    assert result.stderr.startswith("Error: --force = 'friction': known are all, ")
    assert list(tmp_path.iterdir()) == []
