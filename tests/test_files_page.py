"""docs/reference/files.md names every field of every file that the commands write, and no others."""

import csv
import json
import re
from pathlib import Path

import pytest

from tests.commands import run

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "files.md"
pytestmark = pytest.mark.slow
FREE = {"versions", "files", "options", "sentences", "cells_by_status", "meanings", "table_provenance", "units"}
FREE |= {"factors", "drawn_gap_mm_quantiles_0_5_25_50", "several_states"}
"""Entries whose own keys are names of packages, files, options, statuses and rows."""
FOLDERS = {"demand", "space", "body", "limit", "net", "every", "curtains", "compared", "tables", "found", "sized"}
ELSEWHERE = {"not_finite", "drawing", "is_mirrored", "plugin"}
ELSEWHERE |= {"smallest_factor", "at_s", "peak_support_force_N", "peak_support_force_at_s", "reached_s"}
"""Of rows without numbers, of weaves from text, of plugins and of motions in sweeps, which have tests of their own."""
COUNTS = {"rows", "branches"}
"""Entries of the sidecar whose own keys are statuses and notes."""
PLANE = """
curtain = {width = 44.0, height = 37.94}
mesh = {cells = 4}
support = {kind = "top"}
"""
SPACE = """
curtain = {width = 120.0, height = 120.0}
mesh = {cells = 4}
support = {kind = "hooks", pitch = 60.0, gather = 0.9, capacity = 5.0}
load = {steps = 2, wind = [{direction = [0.0, 0.0, 1.0], speed = 10.0}]}
combination = [{name = "storm", wind = 1.5}]
obstacle = [{kind = "wall", facing = [0.0, 0.0, -1.0], point = [0.0, 0.0, 5.0]}]
solver = {bounds = true}
"""
BODY = """
curtain = {width = 120.0, height = 120.0}
mesh = {cells = 4}
support = {kind = "top"}
obstacle = [{kind = "sphere", centre = [60.0, 30.0, -30.0], radius = 25.0, move = [0.0, 0.0, 15.0]}]
"""
NET = """
curtain = {width = 120.0, height = 120.0}
mesh = {cells = 2}
support = [{kind = "edge", edge = "left"}, {kind = "edge", edge = "right"}]
load = {steps = 2, gravity = [0.0, 0.0, -9.81], patch = [{at = [60, 60], radius = 30, force = [0, 0, -200]}]}
solver = {kind = "plastic", strings = true, bounds = true}
"""


def placed(word, folder):
    """A word of a command with files and folders in `folder`."""
    return str(folder / word) if word.endswith((".csv", ".json", ".toml")) or word in FOLDERS else word


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """A folder with one of every file."""
    folder = tmp_path_factory.mktemp("files")
    barred = PLANE + "[load.bar]\nmass = 0.1\n"
    hung = PLANE.replace('{kind = "top"}', '{kind = "hooks", count = 3}')
    for name, text in {
        "plane": PLANE,
        "barred": barred,
        "hung": hung,
        "space": SPACE,
        "body": BODY,
        "net": NET,
    }.items():
        (folder / f"{name}.toml").write_text(text)
    (folder / "loads.csv").write_text("alpha_deg,beta_deg\n0,90\n20,30\n45,45\n0,0\n0,45\n45,90\n20,80\n")
    for command in (
        "rve table --rings --strings --loads loads.csv --out table.csv",
        "homogenize fit table.csv --out law.json",
        "macro_fem run plane.toml --cell 5,0.5 --no-cache --accuracy 0.05 --out demand --no-picture",
        "macro_fem run space.toml --out space --no-picture",
        "macro_fem run body.toml --out body --no-picture",
        "macro_fem run hung.toml --limit --out limit --no-picture",
        "macro_fem run net.toml --out net --no-picture",
        "macro_fem rings plane.toml --out every --no-picture",
        "macro_fem compare plane.toml --out compare.json",
        "macro_fem size barred.toml --vary mass --from 0.1 --to 0.2 --factor 1e-6 --out sized --no-picture",
        "macro_fem localize demand --out found --no-picture",
        "macro_fem sweep plane.toml --out curtains --no-picture",
        "macro_fem compare-designs plane.toml --out compared --no-picture",
        "rve sweep --r1 5 --r2 0.5 --out tables --loads loads.csv",
    ):
        run(*(placed(one, folder) for one in command.split()))
    return folder


def section(*headings):
    """The text below headings of the page, up to the next one of the same level."""
    text = PAGE.read_text("utf-8")
    found = ""
    for heading in headings:
        level = heading.split(" ")[0]
        part = text.split(f"\n{heading}\n", 1)[1]
        found += re.split(rf"^#{{1,{len(level)}}} ", part, maxsplit=1, flags=re.MULTILINE)[0]
    return found


def named(text):
    """Names in code."""
    return set(re.findall(r"`([A-Za-z_][A-Za-z_0-9]*)`", text))


def first_column(text):
    """Names in the first column of tables."""
    return {name for line in text.splitlines() if line.startswith("| `") for name in named(line.split(" | ")[0])}


def keys(value, into=()):
    """All names of a JSON value, except those below names that are free."""
    if isinstance(value, list):
        return set().union(*(keys(item) for item in value[:3])) if value else set()
    if not isinstance(value, dict):
        return set()
    found = set(value)
    for key, item in value.items():
        if key not in FREE and key not in into:
            found |= keys(item, into)
    return found


def of_file(path, into=()):
    if path.suffix == ".json":
        return keys(json.loads(path.read_text()), into) - {"versions", "files"}
    if path.suffix == ".csv":
        return set(next(csv.reader(path.read_text().splitlines())))
    names = set(re.findall(r'<DataArray [^>]*Name="([^"]*)"', path.read_bytes().decode("latin-1")))
    return names - {"Points", "connectivity", "offsets", "types"}


@pytest.mark.parametrize(
    ("headings", "names"),
    [
        (["## A table: table.csv and table.json"], ["table.csv", "table.json"]),
        (["## A law: law.json"], ["law.json"]),
        (
            ["## A curtain: summary.json"],
            [
                f"{run}/{name}"
                for run in ("demand", "space", "body", "limit", "net")
                for name in ("summary.json", "support_forces.csv")
            ],
        ),
        (["## The largest value that holds: size.json"], ["sized/size.json", "sized/size.csv"]),
        (["## curtain.vtu"], ["space/curtain.vtu"]),
        (
            ["## Its rings: localize.json"],
            [f"found/{name}" for name in ("localize.json", "worst_cell.csv", "rings.vtu")],
        ),
        (["## Every ring solved: summary.json"], ["every/summary.json", "every/rings.vtu"]),
        (["## Membrane beside rings: compare.json"], ["compare.json"]),
        (["## A sweep: sweep.csv"], ["curtains/sweep.csv", "tables/sweep.csv", "compared/designs.csv"]),
    ],
    ids=lambda value: value[0] if len(value) == 1 else "",
)
def test_the_page_names_every_field_and_no_other(out, headings, names):
    text = section(*headings)
    written = set().union(*(of_file(out / name, COUNTS if name == "table.json" else ()) for name in names))
    assert written - named(text) == set()
    statuses = set(re.findall(r"^\| `(\w+)`", section("### Status"), re.MULTILINE)) | {"stalled", "iterations"}
    assert first_column(text) - written - statuses - ELSEWHERE == set()
