"""Elastic locked states and strength of cells from their rings: energy, balance, curvature, independent models."""

from dataclasses import replace

import numpy as np
import pytest

from rve import Cell, DirectOptions, Material, named_material, solve_table, with_rings
from rve.common import trace
from rve.geometry import FOUR_IN_ONE, cauchy_line_load, deformation, green_lagrange, second_pk, tangent_frame
from rve.locking import Equations, solve_equilibrium, with_limits
from rve.placed import central_forces
from rve.solve import locked_block, reference_sides
from rve.wire import Ring, out_of_plane_inertia, peak_stress, ring_states, shear_factor
from rve.wire.cell_stiffness import contact_ends, contact_flexibility, elastic_forces

from .frame import frame_flexibility

EQUATIONS = Equations.of(FOUR_IN_ONE, 0.1)
WEIGHT = np.array([1.0, 2.0, 1.0])
SIDES = tuple(x / 5.0 for x in reference_sides(Cell(), DirectOptions()))
AREA = SIDES[0] * SIDES[1]
POISSON = 0.3
RING = Ring(1.0, 0.1, 1.0, POISSON)


@pytest.fixture(scope="module")
def locked():
    """The 190 locked states of the paper's grid."""
    a, b = np.meshgrid(np.arange(0.0, 46.0, 5.0), np.arange(0.0, 91.0, 5.0), indexing="ij")
    return locked_block(a.ravel(), b.ravel(), Cell(), DirectOptions())


@pytest.fixture(scope="module")
def paper(locked):
    """The locked states, and the elastic states of their rings."""
    found, s, unique = locked.found, locked.s, locked.unique
    assert (found.status == "converged").all()
    return found, s, unique, ring_states(EQUATIONS, found, s, SIDES, POISSON)


def strain_energy(found, lam):
    """lam C lam (n,) of forces (n, p, SLOTS), by the rings' flexibility."""
    ends = contact_ends(EQUATIONS, found)
    C = contact_flexibility(ends, [RING] * 2)
    forces = np.take_along_axis(lam.reshape(len(lam), -1), ends.slot, axis=1)
    return np.einsum("nc,ncd,nd->n", forces, C, forces)


@pytest.mark.slow
def test_work_along_the_load_is_the_strain_energy_of_the_rings(paper):
    found, s, unique, states = paper
    S = second_pk(deformation(found.pose, SIDES), s)
    work = np.einsum("ni,nij,nj->n", S * WEIGHT, states.locking + states.elastic, S)
    assert unique.sum() == 184
    assert work == pytest.approx(strain_energy(found, states.lam) / AREA, rel=1e-8)
    free = (work / trace(S) ** 2)[~unique]
    assert free == pytest.approx(free[0], rel=1e-9)  # one load, six of the strains that it leaves free
    assert np.isfinite(states.first_yield).all()


def test_elastic_forces_balance_the_load_and_are_the_stiffest_choice(paper, locked):
    found, s, _, states = paper
    system = EQUATIONS.assemble(found.pose, found.contacts, states.lam, s)
    assert np.abs(system.r).max() < 1e-8
    assert states.lam.min() >= 0.0
    central = strain_energy(found, central_forces(locked))
    assert strain_energy(found, states.lam) == pytest.approx(central, rel=1e-12)  # by symmetry


def test_elastic_forces_do_not_depend_on_those_of_the_rigid_cell(paper):
    """Under a pull along the grain ten contacts touch, which balance tells apart but for three numbers."""
    found, s, _, states = paper
    rows = np.array([9, 18, 100])  # (0, 45), (0, 90), (25, 25) degrees; ascending
    part, s = found.take(rows), s[rows]
    G = EQUATIONS.assemble(part.pose, part.contacts, part.lam, s).G
    other = part.lam.copy()
    for i in range(len(rows)):
        working = np.flatnonzero(part.lam[i].ravel() > 1e-6)
        U, sizes, _ = np.linalg.svd(G[i][working])
        free = U[:, np.count_nonzero(sizes > 1e-7) :].sum(axis=1)
        lam = part.lam[i].ravel()[working]
        step = 0.5 * np.min(np.where(free < 0.0, lam / np.maximum(-free, 1e-12), np.inf))
        other[i].reshape(-1)[working] = lam + step * free
    asymmetric = replace(part, lam=other)
    assert np.all(strain_energy(part, other) > 1.01 * strain_energy(part, part.lam))
    again = ring_states(EQUATIONS, asymmetric, s, SIDES, POISSON)
    assert again.lam == pytest.approx(states.lam[rows], abs=1e-8)
    assert again.first_yield == pytest.approx(states.first_yield[rows], rel=1e-6)
    assert again.collapse == pytest.approx(states.collapse[rows], rel=2e-4)


def test_both_parts_of_the_compliance_come_from_potentials(paper):
    found, s, unique, states = paper
    S = second_pk(deformation(found.pose, SIDES), s)[unique]
    for D in (states.locking[unique], states.elastic[unique]):
        W = WEIGHT[:, None] * D
        assert np.abs(W - W.transpose(0, 2, 1)).max() < 1e-9 * np.abs(W).max()
        assert np.linalg.eigvalsh(0.5 * (W + W.transpose(0, 2, 1)))[:, 0].min() > -1e-8 * np.abs(W).max()
    along = np.einsum("nij,nj->ni", states.locking[unique], S)
    assert np.abs(along).max() < 1e-8 * np.abs(states.locking[unique]).max()  # the surface is homogeneous


def test_bend_of_the_surface_by_differences_of_locked_states():
    alpha, beta, step = np.array([10.0, 20.0, 30.0]), np.array([35.0, 30.0, 65.0]), 1e-3
    s = cauchy_line_load(alpha, beta)
    found = solve_equilibrium(s, EQUATIONS, DirectOptions())
    states = ring_states(EQUATIONS, found, s, SIDES, POISSON)
    assert np.abs(states.locking).max() > 0.01
    for d_alpha, d_beta in ((step, 0.0), (0.0, step)):
        E, S = [], []
        for sign in (1.0, -1.0):
            load = cauchy_line_load(alpha + sign * d_alpha, beta + sign * d_beta)
            F = deformation(solve_equilibrium(load, EQUATIONS, DirectOptions()).pose, SIDES)
            E.append(green_lagrange(F))
            S.append(second_pk(F, load))
        predicted = np.einsum("nij,nj->ni", states.locking, S[0] - S[1])
        assert predicted == pytest.approx(E[0] - E[1], rel=1e-4, abs=1e-6 * step)


def test_least_energy_under_nonnegative_forces_meets_its_conditions():
    rng = np.random.default_rng(7)
    idle = 0
    for _ in range(20):
        G = rng.normal(size=(8, 5))
        start = rng.uniform(0.0, 1.0, 8)
        C = rng.normal(size=(8, 8))
        C = C @ C.T + 0.1 * np.eye(8)
        lam = elastic_forces(G, C, start)
        assert np.abs(G.T @ (lam - start)).max() < 1e-9
        working = lam > 1e-9
        # C lam = G q + nu with nu >= 0 at idle contacts only
        q = np.linalg.lstsq(G[working], (C @ lam)[working], rcond=None)[0]
        slack = C @ lam - G @ q
        assert np.abs(slack[working]).max() < 1e-8
        assert slack.min() > -1e-8
        idle += np.count_nonzero(~working)
    assert idle > 0


def frame_energy(found, lam):
    """lam C lam of one case by polygons of straight beams in place of the rings."""
    ends = contact_ends(EQUATIONS, found)
    forces = np.take_along_axis(lam.reshape(1, -1), ends.slot, axis=1)[0]
    area, inertia = np.pi * 0.01, 0.25 * np.pi * 1e-4
    G = RING.shear_modulus
    stiffness = (area, inertia, out_of_plane_inertia(1.0, 0.1), 2.0 * G * inertia, shear_factor(POISSON) * G * area)
    energy = 0.0
    for k in range(2):
        mine = (ends.ring[0] == k) & (np.concatenate([forces, forces]) > 0.0)
        push = np.concatenate([forces, forces])[mine, None] * ends.direction[0, mine]
        energy += frame_flexibility(ends.phi[0, mine], push, 1.0, stiffness, 96).sum()
    return energy


@pytest.mark.parametrize("load", [(0.0, 90.0), (0.0, 45.0), (20.0, 30.0)])
def test_a_frame_of_straight_beams_gives_the_elastic_strain_of_the_cell(load):
    s = cauchy_line_load([load[0]], [load[1]])
    found, _ = with_limits(s, EQUATIONS, solve_equilibrium(s, EQUATIONS, DirectOptions()), DirectOptions())
    states = ring_states(EQUATIONS, found, s, SIDES, POISSON)
    energy = strain_energy(found, states.lam)[0]
    assert frame_energy(found, states.lam[0]) == pytest.approx(energy, rel=0.01)


@pytest.mark.parametrize("joint", [(), (20.0,)])
def test_every_ring_is_balanced_by_its_contacts(paper, joint):
    """Forces and moments of the ends on each ring add up to zero, so nothing is spread over it or held by its plane."""
    found, s, _, _ = paper
    states = ring_states(EQUATIONS, found, s, SIDES, POISSON, joint)
    ends = contact_ends(EQUATIONS, found)
    forces = np.take_along_axis(states.lam.reshape(len(states.lam), -1), ends.slot, axis=1)
    for k in range(2):
        phi, direction, contact = ends.on(k)
        f = np.take_along_axis(forces, contact, axis=1)[..., None] * direction
        c, s = np.cos(phi), np.sin(phi)
        total = [f[..., 0] * c - f[..., 1] * s, f[..., 0] * s + f[..., 1] * c, f[..., 2]]
        total += [f[..., 2] * s, -f[..., 2] * c, f[..., 1]]
        assert np.abs([part.sum(axis=1) for part in total]).max() < 1e-7


def test_strength_is_between_bounds(paper):
    """Scaled up, the elastic moments still balance: collapse exceeds first yield by at least the ratio 16/(3 pi) of a
    round section's plastic to its elastic moment where bending decides, as it does here."""
    _, _, _, states = paper
    ratio = states.first_yield / states.collapse
    assert ratio.min() > 16.0 / (3.0 * np.pi)
    assert ratio.max() < 4.0


def test_rows_without_a_locked_state_have_no_strength():
    table = with_rings(solve_table(Cell(), ([0.0, 0.0, 20.0], [45.0, 100.0, 135.0])), Cell())
    assert list(table.status) == ["converged", "compressive", "compressive"]
    assert np.isfinite(table.strength[0]).all()
    assert np.isnan(table.strength[1:]).all()
    assert np.isnan(table.compliance[1:]).all()


@pytest.mark.slow
def test_table_columns_follow_material_size_and_grain():
    loads = ([10.0, 80.0, 0.0, 15.0], [40.0, 50.0, 90.0, 0.0])
    steel, titanium = Material(), named_material("titanium grade 2")
    one = with_rings(solve_table(Cell(), loads), Cell())
    assert list(one.unique) == [True, True, True, False]
    assert np.isfinite(one.compliance[3]).all()
    other = Cell(10.0, 1.0, material=replace(steel, young_N_per_mm2=105e3))
    large = with_rings(solve_table(other, (loads[0][:2], loads[1][:2])), other)
    assert large.strength == pytest.approx(one.strength[:2] / 2.0, rel=1e-6)
    S = one.S[:2]
    along = [np.einsum("ni,nij,nj->n", S * WEIGHT, t.compliance[:2], S) for t in (one, large)]
    assert along[1] == pytest.approx(along[0], rel=1e-6)  # twice the size at half the modulus
    cell = Cell(grain="x")
    turned = with_rings(solve_table(cell, ([80.0], [40.0])), cell)  # 10 degrees from the other axis
    assert turned.strength[0] == pytest.approx(one.strength[0], rel=1e-6)
    swapped = one.compliance[0][::-1, ::-1]
    assert turned.compliance[0] == pytest.approx(swapped, rel=1e-5, abs=1e-9)
    assert one.cell.material.name == "steel"
    assert Cell(material=titanium).density == pytest.approx(4.51e-6)


def jointed(name, loads=((0.0, 20.0, 20.0), (90.0, 30.0, 60.0))):
    return with_rings(solve_table(Cell(), loads), Cell(), name)


@pytest.mark.slow
def test_butted_rings_are_weaker_softer_and_worst_at_the_worst_angle():
    welded, worst = jointed("welded"), jointed("butted")
    assert (worst.origin.joint, welded.origin.joint) == ("butted:worst", "welded")
    assert (worst.strength > 2.0 * welded.strength).all()

    def along(table):
        return np.einsum("ni,nij,nj->n", table.S * WEIGHT, table.compliance, table.S)

    for name in ("butted:0", "butted:45", "butted:90"):
        stated = jointed(name)
        assert (stated.strength > welded.strength).all()
        assert (stated.strength <= worst.strength * 1.01).all()
        assert (along(welded) < along(stated)).all()
        assert (along(stated) <= along(worst) * 1.01).all()


@pytest.mark.slow
def test_a_stated_angle_stands_for_its_mirror_image():
    """The mirror image of a load on the mirrored mesh; rings are symmetric under inversion, so 200 is 20 degrees."""
    one, other = jointed("butted:20"), jointed("butted:200", ((0.0, -20.0, -20.0), (90.0, 30.0, 60.0)))
    assert other.strength == pytest.approx(one.strength, rel=1e-6)
    assert jointed("butted:50").strength != pytest.approx(one.strength, rel=1e-2)


def test_joints_are_where_they_are_said_to_be():
    """The point of each ring at the angle of its joint, in space: 0 is farthest along the grain, 90 to the left."""
    s = cauchy_line_load([20.0], [30.0])
    found = solve_equilibrium(s, EQUATIONS, DirectOptions())
    ends = contact_ends(EQUATIONS, found)
    e1, e2 = tangent_frame(found.pose.normals[0])

    def points(angle_deg):
        angle = ends.joints(angle_deg)[0][:, None]
        return np.cos(angle) * e1 + np.sin(angle) * e2

    top = points(0.0)
    around = np.linspace(0.0, 2.0 * np.pi, 721)[:, None, None]
    assert top[:, 1] == pytest.approx((np.cos(around) * e1 + np.sin(around) * e2)[..., 1].max(axis=0), abs=1e-4)
    left = points(90.0)
    assert np.abs((top * left).sum(axis=1)).max() < 1e-12
    assert (np.cross(top, left)[:, 2] > 0.0).all()
    states = ring_states(EQUATIONS, found, s, SIDES, POISSON, (0.0,))
    forces = np.take_along_axis(states.lam.reshape(1, -1), ends.slot, axis=1)
    highest = []
    for k in range(2):
        phi, direction, contact = ends.on(k)
        push = np.take_along_axis(forces, contact, axis=1)[..., None] * direction
        highest.append(peak_stress(phi, push, RING, joint=ends.joints(0.0)[:, k])[0][0])
    assert states.first_yield[0] == pytest.approx(max(highest), rel=1e-9)
