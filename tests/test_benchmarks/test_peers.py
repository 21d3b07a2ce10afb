"""The page of peers: its ratios follow from its times, and programs run in turn are timed by their medians."""

import re
from functools import partial

import numpy as np
import pytest

from benchmarks import cone_form, peers
from benchmarks.measure import ROOT
from homogenize import default_law
from macro_fem import Mesh, Rectangle, Scene, Top
from macro_fem.curtain import make_problem, solve_problem
from macro_fem.scene.meshing.mesh import build_mesh
from tests.test_benchmarks.test_others import cells

PAGE = (ROOT / "docs" / "measured" / "peers.md").read_text(encoding="utf-8")
HEADS = ["of", "peer", "ours, s", "theirs, s", "theirs over ours", "found by ours", "found by the peer", "apart"]


def told_rows():
    lines = re.search(r"^\| of \|.*\n\|[- |]+\n((?:\|.*\n?)+)", PAGE, re.MULTILINE)
    assert cells(lines[0].split("\n")[0]) == HEADS
    return [dict(zip(HEADS, cells(line), strict=True)) for line in lines[1].strip().split("\n")]


def test_ratios_of_the_page_follow_from_its_times():
    rows = told_rows()
    assert len(rows) >= 3
    for row in rows:
        ours, theirs = float(row["ours, s"].replace(",", "")), float(row["theirs, s"].replace(",", ""))
        assert float(row["theirs over ours"]) == pytest.approx(theirs / ours, rel=0.012, abs=0.006)
    below = sum(float(row["theirs over ours"]) < 1.0 for row in rows)
    assert f"{below} of {len(rows)} are below 1." in PAGE


def test_every_peer_has_its_words_or_is_named_as_left_out():
    names = {name for name, _, _ in peers.PEERS.values()}
    assert all(name in PAGE for name in names)


def test_programs_run_in_turn_and_their_times_are_medians(monkeypatch):
    order, clock = [], iter([0.0, 1.0, 1.0, 3.0, 3.0, 8.0, 8.0, 9.0, 9.0, 12.0, 12.0, 14.0])
    monkeypatch.setattr(peers, "process_time", lambda: next(clock))

    def call(name):
        order.append(name)
        return name

    found = peers.in_turn({name: partial(call, name) for name in ("a", "b")})
    assert order == ["a", "b"] * peers.TIMES
    assert {name: (one.found, one.seconds) for name, one in found.items()} == {"a": ("a", 3.0), "b": ("b", 2.0)}


@pytest.mark.parametrize("solver", ["clarabel", "qoco"])
def test_peers_find_our_potential(solver):
    pytest.importorskip(solver)
    scene, law = Scene(Rectangle(200.0, 200.0), [Top()], mesh=Mesh(cells=4)), default_law()
    found = solve_problem(make_problem(scene, law, build_mesh(scene, law.cell)))
    fem, size = found.problem.fem, found.problem.mesh.size
    load = fem.gather(found.problem.force)
    form = cone_form.ConeForm(fem, found.cones, size, cone_form.gradient_matrix(fem))
    total = np.abs(load).sum()
    x, _ = getattr(cone_form, f"by_{solver}")(form, -load / total, peers.GAP)
    assert load @ x / total == pytest.approx(load @ fem.unknowns(found.x) / total / size, abs=1e-5)
