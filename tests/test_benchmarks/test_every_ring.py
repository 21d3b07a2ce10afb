"""The parts behind the report of every ring: geometry, edge loads, cells in space, starts; and its quick form."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.every_ring import let_go
from benchmarks.every_ring.brute import least_gap, linked_pairs, minima_of
from benchmarks.every_ring.cases import SHEETS, disk_case
from benchmarks.every_ring.cell import edge_forces
from benchmarks.every_ring.hooks import peak
from benchmarks.every_ring.starts import random_start
from macro_fem import Motion
from macro_fem.motion import MovingRings
from macro_fem.rings import ring_scene
from rve import Cell, FiniteMesh, pulled_ring
from rve.common import STEEL
from rve.wire import Ring


def test_brute_force_knows_two_circles():
    centre = np.array([[0.0, 0.0, 0.0], [1.8, 0.0, 0.0], [4.2, 0.0, 0.0]])
    normal = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    pair, _, distance = minima_of(centre, normal, np.array([[0, 1], [1, 2]]))
    assert distance[pair == 0].min() == pytest.approx(0.2)
    assert distance[pair == 1].min() == pytest.approx(0.4)
    assert linked_pairs(centre, normal, 1.0) == {(0, 1)}
    assert least_gap(centre, normal, 1.0, 0.05) == pytest.approx(0.1)


@pytest.mark.slow
def test_the_disk_of_a_small_sheet_bears_its_weight_and_a_pull_over_less_than_a_ring():
    """A pull over a circle of 8 mm, of rings of r1 = 5 mm; P along the grain times the width is the weight below."""
    at_a_point, over_a_circle = (disk_case(replace(SHEETS[-1], spread=d), 4).numbers for d in (0.0, 0.1875))
    assert over_a_circle["mean_height_mm"] == pytest.approx(at_a_point["mean_height_mm"], rel=0.05)
    sheet = replace(SHEETS[1], gather=1.0, weave_angle=0.0)
    found, (W, H) = disk_case(sheet, 4).arrays, sheet.sides(1)
    share = found["area"] / found["area"].sum()
    below = share @ found["middle"][:, 1] / H * sheet.weight(1)
    assert share @ found["P"][:, 1, 1] * W == pytest.approx(below, rel=1e-4)


def test_edge_forces_are_those_of_the_line_load():
    mesh = FiniteMesh.rectangle(Cell(), 4, 3)
    P = np.array([[1.0, 0.3], [-0.2, 2.0]])
    force = edge_forces(mesh, P)
    area = np.ptp(mesh.X, axis=0).prod()
    assert np.abs(force.sum(axis=0)).max() < 1e-9
    assert pytest.approx(force.T @ mesh.X / area) == P


@pytest.mark.release
def test_413_rings_let_go_at_a_corner_pass_the_steps_whose_contacts_split_and_merge():
    """At one number of force x gap the step to 0.065 s does not converge, whichever number it is."""
    scene = replace(let_go.motion_scene(let_go.SCENES[0], 4), motion=Motion(0.07, let_go.STEP))
    run = MovingRings(scene).solve()
    assert (run.status, len(run.frames)) == ("converged", 15)
    assert all(frame.rings.contacts.links_intact and frame.rings.contacts.min_gap_mm > 0.0 for frame in run.frames)
    assert np.ptp([sum(vars(one.account).values()) - 2.0 * one.account.work for one in run.frames]) < 1e-8


@pytest.mark.slow
def test_random_starts_are_admissible_and_differ():
    rings = ring_scene(SHEETS[0].scene(1, 4))
    woven = {(int(a), int(b)) for a, b in rings.mesh.linked}
    first, second = (random_start(rings, True, seed) for seed in (1, 2))
    for placed in (first, second):
        assert least_gap(placed.x, placed.normal, 1.0, 0.1) > 0.0
        assert linked_pairs(placed.x, placed.normal, 1.0) == woven
    assert np.abs(first.x - second.x).max() > 0.1


def test_a_ring_of_a_chain_bears_what_a_ring_pulled_by_two_opposed_forces_does():
    """Rings 0, 1, 2 hang from each other, turned by 90 degrees each; the first is held, the force at a hook is its."""
    ring, force = Ring(5.0, 0.5, STEEL.young_N_per_mm2, STEEL.poisson), 3.0
    down = np.array([0.0, 2.0 * (ring.r1 - ring.r2), 0.0])
    chain = SimpleNamespace(
        centre=-np.arange(3.0)[:, None] * down,
        normal=np.eye(3)[[0, 2, 0]],
        reaction=np.array([[0.0, force, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
        contacts=SimpleNamespace(
            pairs=np.array([[0, 1], [1, 2]]),
            normal=np.array([[0.0, 1.0, 0.0], [0.0, 1.0, 0.0]]),
            force=np.full(2, force),
            gap=np.zeros(2),
        ),
    )
    most = STEEL.yield_N_per_mm2 * force / pulled_ring(5.0, 0.5, STEEL).first_yield_N
    assert [peak(chain, i, ring) for i in (0, 1)] == pytest.approx([most, most], rel=1e-9)
