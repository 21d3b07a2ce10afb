"""Keys of scenes in space combine: every pair of values is tried, and each scene balances or is refused in words."""

import numpy as np
import pytest

from homogenize.io import default_law
from macro_fem.curtain import solve_problem
from macro_fem.scene.schema import read_scene
from rve.common.errors import InputError
from tests.test_macro_fem.pairs import pairs_not_covered
from tests.test_macro_fem.sheets import posed

LEFT, RIGHT = [[0.0, 0.0, 5.0], [10.0, 79.0, 0.0]], [[100.0, 0.0, -5.0], [90.0, 79.0, 0.0]]
TOP = [[10.0, 79.0, 0.0], [90.0, 79.0, 0.0]]
HOLE = [[[40, 30], [60, 30], [60, 50], [40, 50]]]
KEYS = {
    "curtain": {
        "rectangle": {"width": 100.0, "height": 80.0},
        "hole": {"width": 100.0, "height": 80.0, "holes": HOLE},
        "disk": {"shape": "disk", "radius": 50.0},
    },
    "element": dict.fromkeys(("P1", "P2", "CR", "Q1", "Q2")),
    "support": {
        "track": {"kind": "track", "radius": 60.0, "angle": 70.0},
        "runners": {"kind": "track", "fullness": 1.5, "radius": 60.0, "pitch": 50.0, "drawn": 0.6, "capacity": 9.0},
        "cables": [
            {"kind": "edge", "edge": "left", "along": LEFT, "sliding": True},
            {"kind": "edge", "edge": "right", "along": RIGHT, "sliding": True},
            {"kind": "edge", "edge": "top", "along": TOP},
        ],
        "hammock": [{"kind": "edge", "edge": "top"}, {"kind": "edge", "edge": "bottom", "move": [0.0, 60.0, 50.0]}],
        "rail": [{"kind": "rail"}, {"kind": "edge", "edge": "bottom", "held": "z"}],
    },
    "load": {
        "weight": {"gravity": [0.0, -9.81, 1.0]},
        "wind": {"wind": {"pressure": 20.0, "direction": [0.0, 0.2, 1.0]}},
        "speed": {"wind": {"speed": 9.0, "direction": [0.0, 0.0, -1.0]}},
        "follows": {"wind": {"pressure": 5.0, "direction": [0.0, 0.0, 1.0], "follows": True}},
        "bar": {"bar": {"mass": 0.1}},
        "patch": {"patch": {"at": [20.0, 20.0], "radius": 15.0, "force": [0.0, -0.1, 0.1]}},
    },
    "obstacle": {
        "none": [],
        "floor": {"kind": "floor", "height": 5.0},
        "wall": {"kind": "wall", "facing": [0.0, 0.3, 1.0], "point": [0.0, 0.0, -120.0], "move": [0.0, 0.0, 2.0]},
        "sphere": {"kind": "sphere", "centre": [50.0, 30.0, -130.0], "radius": 30.0, "move": [0.0, 0.0, 60.0]},
        "cylinder": {"kind": "cylinder", "axis": [1.0, 0.1, 0.0], "radius": 30.0, "point": [0.0, -60.0, -20.0]},
        "box": {"kind": "box", "corner": [20.0, -90.0, -90.0], "size": [50.0, 20.0, 60.0], "clear": "nodes"},
    },
    "solver": {"rigid": {"space": True}, "elastic": {"kind": "elastic"}},
    "weave": {"y": "y", "x": "x", "turned": 30.0},
}
REFUSED = {
    "no-node": "has no nodes at",  # Crouzeix-Raviart
    "plane": "as the scene lies in the plane",  # held = "z"
    "two-places": "at different places",  # top and bottom of a disk meet
    "no-edge": "the curtain has no such edge",  # a disk has top and bottom only
    "slides": "in which the supports let",
    "held-bar": "is held, or has a second bar",
    "too-long": "is too long for the mesh",
    "inside": "mm inside it",
    "line": "closed",
    "blocked": "cannot clear its obstacles",
    "across": "tells no side",
}

TABLE = """
curtain   | element   | support   | load      | obstacle  | solver    | weave
rectangle | P1        | cables    | weight    | wall      | rigid     | x
hole      | CR        | runners   | wind      | none      | rigid     | turned
disk      | P2        | runners   | bar       | box       | rigid     | x
hole      | P2        | rail      | speed     | wall      | elastic   | y
rectangle | Q1        | cables    | follows   | cylinder  | rigid     | turned
rectangle | Q2        | track     | patch     | floor     | elastic   | turned
rectangle | Q2        | hammock   | speed     | sphere    | rigid     | y
disk      | P2        | track     | follows   | sphere    | rigid     | turned
disk      | CR        | hammock   | weight    | floor     | rigid     | y
hole      | P1        | hammock   | follows   | cylinder  | elastic   | x
rectangle | P1        | rail      | wind      | none      | rigid     | y
rectangle | Q2        | rail      | bar       | cylinder  | rigid     | turned
disk      | P1        | hammock   | wind      | box       | elastic   | turned
rectangle | Q1        | runners   | patch     | sphere    | rigid     | y
hole      | CR        | track     | wind      | floor     | rigid     | x
hole      | CR        | cables    | bar       | cylinder  | elastic   | y
disk      | CR        | rail      | patch     | cylinder  | elastic   | x
disk      | P1        | track     | bar       | wall      | rigid     | turned
rectangle | Q2        | runners   | weight    | none      | elastic   | x
disk      | P1        | cables    | speed     | floor     | rigid     | turned
rectangle | CR        | track     | follows   | box       | rigid     | y
rectangle | Q1        | track     | weight    | sphere    | elastic   | x
hole      | P2        | cables    | patch     | sphere    | rigid     | x
rectangle | Q1        | rail      | bar       | floor     | rigid     | y
rectangle | P2        | runners   | follows   | floor     | rigid     | y
rectangle | Q2        | cables    | wind      | sphere    | rigid     | y
hole      | P2        | track     | weight    | cylinder  | elastic   | turned
disk      | P1        | runners   | speed     | cylinder  | rigid     | x
rectangle | Q2        | rail      | weight    | box       | elastic   | turned
rectangle | CR        | rail      | follows   | sphere    | rigid     | x
rectangle | Q1        | cables    | speed     | box       | rigid     | x
rectangle | Q1        | hammock   | follows   | wall      | rigid     | y
disk      | P1        | runners   | patch     | wall      | rigid     | turned
disk      | P2        | track     | speed     | none      | elastic   | x
hole      | P2        | hammock   | patch     | box       | rigid     | x
rectangle | Q1        | hammock   | bar       | none      | rigid     | turned
rectangle | Q2        | cables    | wind      | wall      | rigid     | y
disk      | CR        | cables    | speed     | none      | rigid     | turned
rectangle | P2        | rail      | patch     | none      | elastic   | turned
hole      | P2        | runners   | wind      | cylinder  | rigid     | x
hole      | P1        | runners   | bar       | sphere    | rigid     | y
rectangle | Q2        | track     | follows   | none      | elastic   | y
hole      | CR        | runners   | wind      | wall      | elastic   | y
rectangle | Q1        | runners   | wind      | none      | elastic   | x
"""
"""Rows of a covering array: any two keys have every pair of their values in some row."""
HEAD, *LINES = (line.replace("|", "").split() for line in TABLE.strip().splitlines())
ROWS = [dict(zip(HEAD, line, strict=True)) for line in LINES]
ROUNDS = ("sphere", "cylinder", "box", "follows")
"""What is found in rounds, each a convex problem."""


def fits(row):
    """Quadrilaterals need a rectangle without holes."""
    return row["element"][0] != "Q" or row["curtain"] == "rectangle"


def check(row):
    """What came of a scene: its status, all forces in balance, or the key of `REFUSED` for the sentence."""
    law = default_law()
    try:
        scene = read_scene(
            {
                "curtain": KEYS["curtain"][row["curtain"]] | {"weave_angle": KEYS["weave"][row["weave"]]},
                "mesh": {"cells": 4, "element": row["element"]},
                **{key: KEYS[key][row[key]] for key in ("support", "load", "obstacle", "solver")},
            },
            "scene.toml",
        )
        solution = solve_problem(posed(scene, law))
    except InputError as error:
        is_sentence = str(error).startswith("scene.toml") and "\n" not in str(error)
        return next((key for key, words in REFUSED.items() if words in str(error) and is_sentence), str(error))
    if solution.status in ("infeasible", "unsettled"):
        return solution.status
    assert solution.status in ("converged", "taut"), solution.message
    force = solution.problem.force
    left = force.sum(axis=0) + solution.reactions.sum(axis=0) + solution.pushes.sum(axis=0)
    size = max(np.abs(force).sum(), np.abs(solution.reactions).sum())
    assert np.abs(left).max() < 1e-8 * size
    assert solution.wall_forces.min(initial=0.0) >= -1e-9 * size
    walls = solution.problem.walls
    assert walls is None or walls.gap(solution.x).min() > -1e-6 * solution.problem.mesh.size
    return solution.status


def test_the_rows_cover_every_pair():
    assert not pairs_not_covered(ROWS, KEYS, fits)


def cost(row):
    """Only the cheap rows are quick tests."""
    quick = row["element"] == "P1" and not set(row.values()) & set(ROUNDS)
    return () if quick else pytest.mark.slow


@pytest.mark.parametrize("row", [pytest.param(row, marks=cost(row), id="-".join(row.values())) for row in ROWS])
def test_every_pair_of_keys_in_space(row):
    assert check(row) in ("converged", "taut", "infeasible", "unsettled", *REFUSED)
