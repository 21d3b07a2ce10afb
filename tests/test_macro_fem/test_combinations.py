"""All keys of a scene combine: every pair of values is tried, and each scene is solved in balance or refused in words.

What comes of each scene is written beside it. What is solved balances its loads; what is refused is refused in a
sentence that says why.
"""

import meshio
import numpy as np
import pytest
import skfem

from homogenize.io import default_law
from macro_fem.curtain import solve_problem
from macro_fem.fem.cells import counterclockwise
from macro_fem.output.files import summarize
from macro_fem.scene.meshing.mesh import cut_in_four
from macro_fem.scene.schema import read_scene
from rve.common.errors import InputError
from tests.test_macro_fem.pairs import pairs_not_covered
from tests.test_macro_fem.sheets import posed

HOLE = [[[40, 30], [60, 30], [60, 50], [40, 50]]]
PATCH = {"at": [20.0, 20.0], "radius": 15.0, "force": [0.1, -0.2]}
KEYS = {
    "curtain": {
        "rectangle": {"width": 100.0, "height": 80.0},
        "hole": {"width": 100.0, "height": 80.0, "holes": HOLE},
        "disk": {"shape": "disk", "radius": 50.0},
        "outline": {"shape": "outline", "outline": [[0, 0], [100, 0], [100, 40], [50, 40], [50, 80], [0, 80]]},
        "file": {"shape": "file", "file": "mesh.vtu"},
    },
    "element": dict.fromkeys(("P1", "P2", "CR", "Q1", "Q2")),
    "support": {
        "corners": {"kind": "corners", "gather": 0.7, "move": [3.0, 4.0]},
        "top": {"kind": "top", "gather": 0.8},
        "rail": {"kind": "rail"},
        "hooks": {"kind": "hooks", "pitch": 50.0},
        "sliding": {"kind": "hooks", "pitch": 50.0, "sliding": True},
        "left": {"kind": "edge", "edge": "left"},
        "both": [{"kind": "edge", "edge": "top"}, {"kind": "edge", "edge": "bottom", "move": [5.0, 2.0]}],
        "rim": {"kind": "edge", "edge": "outline", "gather": 0.9},
        "points": [{"kind": "point", "at": [0.0, 80.0]}, {"kind": "point", "at": [100.0, 80.0], "held": "y"}],
    },
    "load": {
        "weight": {},
        "edge": {"edge": {"edge": "bottom", "force": [1e-3, -2e-3]}},
        "point": {"point": {"at": [30.0, 20.0], "force": [0.1, -0.1]}},
        "patch": {"gravity": 0.0, "patch": PATCH},
        "bar": {"bar": {"mass": 0.1}},
        "loose-bar": {"bar": {"mass": 0.1, "straight": False}},
        "none": {"gravity": 0.0},
    },
    "solver": {"rigid": {}, "elastic": {"kind": "elastic"}},
    "weave": {"y": "y", "x": "x", "turned": 30.0},
    "pattern": dict.fromkeys(("aligned", "crossed", "diagonal")),
    "factor": {"half": 0.5, "full": 1.0},
}


OUTCOMES = """
curtain   | element | support | load      | solver   | weave  | pattern  | factor | outcome
disk      | CR      | corners | point     | elastic  | x      | crossed  | full   | no-node
disk      | P1      | rim     | weight    | rigid    | turned | aligned  | half   | converged
disk      | P2      | points  | bar       | rigid    | y      | aligned  | full   | off
disk      | CR      | left    | edge      | rigid    | y      | diagonal | half   | no-edge
disk      | P2      | both    | loose-bar | rigid    | x      | crossed  | half   | clash
disk      | P1      | hooks   | none      | elastic  | y      | diagonal | full   | converged
disk      | P2      | top     | patch     | rigid    | x      | diagonal | full   | converged
disk      | P2      | rail    | edge      | rigid    | turned | crossed  | full   | slides
disk      | P1      | sliding | patch     | rigid    | y      | crossed  | half   | slides
file      | CR      | hooks   | patch     | elastic  | turned | aligned  | half   | no-node
file      | P1      | rail    | bar       | rigid    | x      | crossed  | half   | converged
file      | P2      | rim     | none      | rigid    | y      | diagonal | full   | converged
file      | Q1      | both    | loose-bar | rigid    | turned | diagonal | full   | infeasible
file      | Q2      | corners | weight    | rigid    | x      | diagonal | half   | converged
file      | Q1      | sliding | edge      | rigid    | x      | aligned  | full   | slides
file      | Q2      | top     | point     | rigid    | turned | aligned  | full   | converged
file      | Q2      | left    | weight    | rigid    | y      | crossed  | full   | converged
file      | Q1      | points  | none      | rigid    | turned | crossed  | half   | converged
hole      | CR      | top     | weight    | elastic  | y      | crossed  | half   | converged
hole      | P1      | corners | bar       | elastic  | turned | aligned  | full   | converged
hole      | P2      | points  | point     | elastic  | x      | diagonal | half   | converged
hole      | P1      | sliding | edge      | elastic  | turned | diagonal | half   | slides
hole      | CR      | rim     | loose-bar | elastic  | y      | crossed  | half   | converged
hole      | CR      | left    | none      | rigid    | x      | aligned  | half   | converged
hole      | CR      | both    | patch     | rigid    | y      | crossed  | full   | converged
hole      | CR      | hooks   | bar       | rigid    | x      | crossed  | half   | no-node
hole      | CR      | rail    | weight    | elastic  | y      | aligned  | half   | converged
outline   | CR      | sliding | point     | rigid    | y      | aligned  | half   | no-node
outline   | P1      | both    | bar       | elastic  | turned | aligned  | full   | held-bar
outline   | P2      | hooks   | weight    | rigid    | x      | crossed  | full   | converged
outline   | CR      | left    | edge      | elastic  | turned | diagonal | half   | converged
outline   | P2      | corners | loose-bar | rigid    | x      | crossed  | half   | converged
outline   | P1      | top     | none      | rigid    | y      | crossed  | half   | converged
outline   | P1      | points  | patch     | rigid    | x      | diagonal | full   | off
outline   | P1      | rail    | point     | elastic  | y      | diagonal | full   | slides
outline   | CR      | rim     | bar       | rigid    | x      | diagonal | full   | held-bar
rectangle | CR      | points  | weight    | rigid    | x      | crossed  | half   | no-node
rectangle | P1      | rail    | loose-bar | elastic  | turned | aligned  | full   | converged
rectangle | P2      | left    | patch     | rigid    | x      | aligned  | full   | converged
rectangle | Q1      | top     | bar       | rigid    | y      | diagonal | half   | converged
rectangle | Q2      | hooks   | edge      | elastic  | y      | diagonal | full   | converged
rectangle | Q1      | corners | none      | elastic  | y      | diagonal | full   | converged
rectangle | Q1      | rim     | point     | rigid    | y      | aligned  | full   | converged
rectangle | Q2      | both    | none      | rigid    | y      | crossed  | full   | converged
rectangle | Q2      | sliding | bar       | rigid    | y      | diagonal | full   | converged
hole      | P1      | left    | loose-bar | rigid    | y      | diagonal | half   | taut
hole      | P2      | sliding | loose-bar | elastic  | x      | crossed  | half   | converged
file      | Q1      | rail    | patch     | rigid    | x      | aligned  | full   | slides
file      | Q1      | hooks   | weight    | rigid    | turned | crossed  | full   | converged
file      | Q1      | left    | bar       | elastic  | y      | aligned  | half   | held-bar
file      | Q2      | points  | loose-bar | elastic  | x      | aligned  | full   | converged
file      | Q2      | rim     | patch     | elastic  | turned | crossed  | half   | converged
rectangle | Q2      | rail    | none      | rigid    | turned | aligned  | full   | converged
rectangle | CR      | both    | edge      | elastic  | y      | diagonal | half   | converged
rectangle | Q1      | both    | point     | rigid    | x      | diagonal | full   | infeasible
outline   | CR      | both    | weight    | rigid    | y      | diagonal | full   | converged
file      | P1      | corners | edge      | rigid    | x      | diagonal | half   | converged
rectangle | P1      | corners | patch     | rigid    | y      | aligned  | half   | converged
outline   | CR      | hooks   | loose-bar | rigid    | x      | aligned  | full   | no-node
file      | P1      | hooks   | point     | rigid    | y      | crossed  | half   | converged
file      | P1      | left    | point     | rigid    | x      | aligned  | half   | converged
hole      | CR      | points  | edge      | rigid    | turned | crossed  | half   | no-node
file      | P2      | rim     | edge      | rigid    | y      | aligned  | half   | converged
rectangle | Q2      | sliding | none      | elastic  | turned | diagonal | half   | converged
outline   | CR      | sliding | weight    | elastic  | turned | aligned  | half   | no-node
rectangle | P2      | top     | edge      | rigid    | x      | crossed  | full   | converged
rectangle | Q1      | top     | loose-bar | elastic  | y      | crossed  | full   | converged
"""
"""Rows of a covering array: any two keys have every pair of their values in some row. The last column is what comes of
the scene: a status, or a key of `REFUSED`."""
REFUSED = {
    "no-node": "has no nodes at",  # Crouzeix-Raviart
    "off": "away from the curtain",
    "no-edge": "the curtain has no such edge",  # a disk has top and bottom only
    "clash": "at different places",
    "slides": "nothing carries the force",
    "held-bar": "is held, or has a second bar",
}
HEAD, *LINES = (line.replace("|", "").split() for line in OUTCOMES.strip().splitlines())
ROWS = [dict(zip(HEAD, line, strict=True)) for line in LINES]


def fits(row):
    """Quadrilaterals need a rectangle without holes or a mesh file, the rest triangles."""
    return row["element"][0] != "Q" or row["curtain"] in ("rectangle", "file")


def scene_of(row, folder):
    quads = skfem.MeshQuad.init_tensor(np.linspace(0, 100, 5), np.linspace(0, 80, 4))
    mesh = quads if row["element"][0] == "Q" else cut_in_four(quads)
    points = np.column_stack([mesh.p.T, np.zeros(mesh.p.shape[1])])
    cells = ("quad" if mesh is quads else "triangle", counterclockwise(mesh.p.T, mesh.t.T))
    meshio.Mesh(points, [cells]).write(folder / "mesh.vtu")
    curtain = {**KEYS["curtain"][row["curtain"]], "weave_angle": KEYS["weave"][row["weave"]], "areal_mass": 2.785}
    tables = {key: KEYS[key][row[key]] for key in ("support", "load", "solver")}
    mesh_table = {"element": row["element"]} | ({} if row["curtain"] == "file" else {"cells": 4})
    if row["curtain"] == "rectangle":
        mesh_table["pattern"] = row["pattern"]
    return read_scene({"curtain": curtain, "mesh": mesh_table, **tables}, folder / "scene.toml")


def check(row, folder):
    """What came of a scene: its status, with all numbers looked at, or the key of `REFUSED` for the sentence."""
    law = default_law()
    try:
        scene = scene_of(row, folder)
        problem = posed(scene, law, KEYS["factor"][row["factor"]])
        solution = solve_problem(problem)
    except InputError as error:
        is_sentence = str(error).startswith(str(folder / "scene.toml")) and "\n" not in str(error)
        return next((key for key, words in REFUSED.items() if words in str(error) and is_sentence), str(error))
    if solution.status == "infeasible":
        assert "farther apart than the mesh can stretch" in solution.message
        return "infeasible"
    assert solution.status in ("converged", "taut"), solution.message
    summary = summarize(solution)
    assert all(np.all(np.isfinite(value)) for value in (solution.x, solution.P, solution.E, solution.primal))
    load = problem.force.sum(axis=0)
    carried = np.sum([held["force_N"] for held in summary["support_forces"]], axis=0)
    size = max(np.abs(problem.force).sum(), np.abs(solution.reactions).sum(), 1e-4)
    np.testing.assert_allclose(carried, -load, atol=1e-8 * size)
    # rings of 1000 N/mm give a little, and so do those of supports at the largest stretch
    given = 0.05 if row["solver"] == "elastic" else 1e-6 + 4.0 * (solution.relaxation or 0.0)
    assert problem.law.cut(solution.E).violation.max() < given
    assert solution.dual <= solution.primal + 1e-9 * size * problem.mesh.size
    return solution.status


def test_the_rows_cover_every_pair():
    assert not pairs_not_covered(ROWS, KEYS, fits)


@pytest.mark.parametrize("row", ROWS, ids=["-".join(line[:-1]) for line in LINES])
def test_every_pair_of_keys(row, tmp_path):
    assert check(row, tmp_path) == row["outcome"]


@pytest.mark.parametrize("row", [row for row in ROWS if row["element"] == "P1"], ids=lambda row: "-".join(row.values()))
def test_elastic_solves_what_rigid_solves(row, tmp_path):
    other = {"elastic": "rigid", "rigid": "elastic"}[row["solver"]]
    assert check({**row, "solver": other}, tmp_path) == row["outcome"]
