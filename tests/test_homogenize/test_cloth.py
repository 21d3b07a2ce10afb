"""The cloth law: no line becomes longer. Its cuts against numpy's eigenvalues, its file, its answers to commands."""

import json

import numpy as np
import pytest

from homogenize import ClothLaw, load_law
from macro_fem import read_scene, solve
from rve import InputError
from rve.common import double_dot, trace

LAW = ClothLaw()


def strains(n=200):
    rng = np.random.default_rng(4)
    return np.concatenate([rng.normal(0.0, 0.3, (n, 3)), [[0.0, 0.0, 0.0], [0.2, 0.0, 0.2], [-0.1, 0.0, -0.1]]])


def test_a_cut_is_the_fibre_that_stretches_most():
    E = strains()
    cut = LAW.cut(E)
    values = np.linalg.eigvalsh(E[:, [0, 1, 1, 2]].reshape(-1, 2, 2))
    assert np.allclose(cut.violation, values[:, 1], atol=1e-14)
    assert np.allclose(double_dot(cut.S, E) - cut.h, cut.violation, atol=1e-14)
    assert np.allclose(trace(cut.S), 1.0)
    assert (np.linalg.eigvalsh(cut.S[:, [0, 1, 1, 2]].reshape(-1, 2, 2)) > -1e-14).all()


def test_half_spaces_contain_the_law():
    """At admissible strains none is violated, and each is met by a strain of the law."""
    E = strains()
    admissible = E[LAW.cut(E).violation <= 0.0]
    start = LAW.half_spaces()
    assert len(admissible) > 10
    assert all((double_dot(S, admissible) <= h + 1e-14).all() for S, h in zip(start.S, start.h, strict=True))
    assert (LAW.support(start.S) == 0.0).all()
    assert (start.h == 0.0).all()


def test_a_law_file_with_a_parameter_is_refused(tmp_path):
    path = tmp_path / "cloth.json"
    LAW.save(path)
    record = json.loads(path.read_text())
    path.write_text(json.dumps(record | {"parameters": {"limit": 1.0}}))
    with pytest.raises(InputError, match=r"parameters limit = 1.0: unknown key; known are none"):
        load_law(path)


def test_an_elastic_curtain_of_cloth_is_refused():
    with pytest.raises(InputError, match="does not stretch"):
        LAW.response(np.zeros((1, 3)))
    tables = {"curtain": {"width": 100.0, "height": 100.0, "areal_mass": 1.0}, "support": {"kind": "top"}}
    with pytest.raises(InputError, match=r"\[solver\] kind = 'elastic': a law of kind cloth is inextensible"):
        solve(read_scene(tables | {"solver": {"kind": "elastic"}}), LAW)


def test_a_cloth_hung_by_its_top_keeps_its_height():
    tables = {"curtain": {"width": 100.0, "height": 100.0, "areal_mass": 1.0}, "mesh": {"cells": 4}}
    found = solve(read_scene(tables | {"support": {"kind": "top", "gather": 0.7}}), LAW).solution
    assert found.status == "converged"
    assert abs(found.primal) < 1e-8 * np.abs(found.problem.force).sum() * found.problem.mesh.size
    assert np.abs(found.x[:, 1] - found.problem.disc.nodes[:, 1]).max() < 1e-3
