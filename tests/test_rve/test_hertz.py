"""Hertz's contact of crossing wires: spheres, quadrature of the half-space, and rings that press on each other."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ellipe, ellipk

from rve.common.errors import InputError
from rve.equilibrium.elastic_rings import ring_states
from rve.equilibrium.interior_point import DirectOptions, solve_equilibrium
from rve.equilibrium.ring_contacts import contact_ends, contact_flexibility, local_flexibility
from rve.equilibrium.system import Equations
from rve.geometry.cell import Cell
from rve.geometry.kinematics import cauchy_line_load
from rve.geometry.weave import FOUR_IN_ONE
from rve.more_columns import RingOptions, with_rings
from rve.ring.hertz import approach_per_force, relative_curvatures, squared_axis_ratio
from rve.ring.section import Ring
from rve.solve import solve_table

E, NU = 210e3, 0.3
STAR = 0.5 * E / (1.0 - NU**2)
WEIGHT = np.array([1.0, 2.0, 1.0])


def test_crossed_equal_wires_touch_as_a_sphere_on_a_plane():
    R, F = 0.5, 12.0
    wire = np.array([0.0, 1.0 / R])
    curvature = relative_curvatures(wire, wire, np.array(0.0))
    a = np.cbrt(0.75 * F * R / STAR)
    assert squared_axis_ratio(curvature) == pytest.approx(1.0, rel=1e-12)
    assert approach_per_force(curvature, E, NU) * F ** (2.0 / 3.0) == pytest.approx(a**2 / R, rel=1e-12)


@pytest.mark.parametrize(("radii", "angle"), [((0.5, 0.5), 0.5), ((0.5, 1.5), 1.2), ((0.3, 3.0), np.pi / 2.0)])
def test_unequal_wires_at_an_angle_meet_the_equations_of_hertz(radii, angle):
    """A and B by the eigenvalues of the gap's second derivative; K and E by scipy; the approach by its integral."""

    def shape(radius, turn):
        across = np.array([-np.sin(turn), np.cos(turn)])
        return 0.5 / radius * np.outer(across, across)

    exact = np.linalg.eigvalsh(shape(radii[0], 0.0) + shape(radii[1], angle))
    wires = [np.array([0.0, 1.0 / radius]) for radius in radii]
    curvature = relative_curvatures(*wires, np.cos(angle))
    assert curvature == pytest.approx(exact, rel=1e-12)
    k = squared_axis_ratio(curvature)
    m = 1.0 - k
    assert (ellipk(m) - ellipe(m)) / (ellipe(m) / k - ellipk(m)) == pytest.approx(exact[0] / exact[1], rel=1e-9)
    a = np.cbrt(3.0 * (ellipk(m) - ellipe(m)) / m / (2.0 * np.pi * STAR * exact[0]))  # at F = 1
    b = a * np.sqrt(k)
    # the approach of an elliptic pressure: 3 F/(4 pi E*) int_0^oo dw/sqrt((a^2 + w)(b^2 + w) w), with w = x^2
    integral = quad(lambda x: 2.0 / np.sqrt((a**2 + x**2) * (b**2 + x**2)), 0.0, np.inf, epsabs=0.0)[0]
    assert approach_per_force(curvature, E, NU) == pytest.approx(0.75 / (np.pi * STAR) * integral, rel=1e-7)


def test_curvatures_of_rings_in_contact():
    """A pull along the grain: each contact's relative curvatures against the distance of the two tori, sampled."""
    found = solve_equilibrium(cauchy_line_load([20.0], [30.0]), Equations.of(FOUR_IN_ONE, 0.1), DirectOptions())
    ends = contact_ends(Equations.of(FOUR_IN_ONE, 0.1), found)
    minima = found.contacts.minima
    slots = np.flatnonzero(found.contacts.present.ravel())
    for i in range(ends.slot.shape[1]):
        at = np.flatnonzero(slots == ends.slot[0, i])[0]
        a, b = FOUR_IN_ONE.pairs[minima.pair[at], :2]
        normal = minima.normal[at]
        x = np.cross(normal, [0.3, 0.5, 0.8])
        frame = np.stack([x / np.linalg.norm(x), np.cross(normal, x / np.linalg.norm(x))])
        hessian = np.zeros((2, 2))
        for ring, rho, push in ((a, minima.rho_a[at], 1.0), (b, minima.rho_b[at], -1.0)):
            hessian += skin_hessian(found.pose.normals[0, ring], rho, push * normal, frame)
        assert ends.curvature[0, i] == pytest.approx(np.linalg.eigvalsh(0.5 * hessian), rel=3e-3)


def skin_hessian(ring_normal, rho, outwards, frame, step=2e-3):
    """Second derivative (2, 2) of the depth of a torus' skin (r1 = 1, r2 = 0.1) below its tangent plane."""
    point = rho + 0.1 * outwards

    def depth(u, v):
        base, low, high = point + u * frame[0] + v * frame[1], -0.05, 0.05
        for _ in range(60):
            middle = 0.5 * (low + high)
            x = base - middle * outwards
            h = x @ ring_normal
            inside = np.hypot(np.linalg.norm(x - h * ring_normal) - 1.0, h) < 0.1
            low, high = (low, middle) if inside else (middle, high)
        return low

    def second(p, q):
        return (depth(*p) + depth(*q) - 2.0 * depth(0.0, 0.0)) / step**2

    uu, vv = second((step, 0.0), (-step, 0.0)), second((0.0, step), (0.0, -step))
    both = second((step, step), (-step, -step))
    uv = 0.5 * (both - uu - vv)
    return np.array([[uu, uv], [uv, vv]])


def test_rings_give_more_by_the_work_of_their_contacts():
    """S:D S grows by the sum of delta F over the contacts; along other loads as the cube root of the load falls."""
    cell, load = Cell(), 3.0
    table = solve_table(cell, ([20.0], [30.0]))
    plain = with_rings(table, cell)
    size = np.trace(np.array([[table.S[0, 0], table.S[0, 1]], [table.S[0, 1], table.S[0, 2]]]))

    def along(found):
        return float(np.einsum("ni,nij,nj->", found.S * WEIGHT, found.compliance, found.S)) / size**2

    more = [
        along(with_rings(table, cell, RingOptions(load_N_per_mm=s, hertz=True))) - along(plain) for s in (3.0, 24.0)
    ]
    assert more[0] / more[1] == pytest.approx(2.0, rel=1e-6)
    states, known = table.states, table.provenance
    ends = contact_ends(Equations.of(cell.weave, cell.wire), states.found)
    lam = np.take_along_axis(states.lam.reshape(1, -1), ends.slot, axis=1)  # in s r1
    force = lam[0] * (load / size) * cell.r1  # N
    factor = approach_per_force(ends.curvature[0] / cell.r1, cell.material.young_N_per_mm2, 0.3)
    work = float((factor * force ** (5.0 / 3.0)).sum())
    assert more[0] * load**2 * known["b_x_mm"] * known["b_y_mm"] == pytest.approx(work, rel=1e-4)
    ring = Ring(1.0, 0.1, 1.0, 0.3)
    scale = load / size / (cell.material.young_N_per_mm2 * cell.r1)
    assert local_flexibility(ends, ring, lam, np.array([scale]))[0] == pytest.approx(
        factor / np.cbrt(force) * cell.material.young_N_per_mm2 * cell.r1, rel=1e-9
    )


def test_forces_that_have_not_settled_give_no_numbers(monkeypatch):
    """No change is below zero, so that no forces settle."""
    equations = Equations.of(FOUR_IN_ONE, 0.1)
    s = cauchy_line_load([20.0, 0.0], [30.0, 45.0])
    found = solve_equilibrium(s, equations, DirectOptions())

    def finite():
        states = ring_states(equations, found, s, (2.2, 2.53), 0.3, size=np.full(2, 1e-5))
        names = ("locking", "elastic", "first_yield", "collapse")
        return [np.isfinite(getattr(states, name)).reshape(2, -1).all(axis=1).tolist() for name in names]

    assert finite() == [[True, True]] * 4
    monkeypatch.setattr("rve.equilibrium.elastic_rings._SETTLED", 0.0)
    assert finite() == [[False, False]] * 4


def test_forces_of_a_choice_are_those_of_least_energy():
    """Along the grain balance leaves a choice: strain energy and the contacts' 3/5 delta F together are least."""
    equations, sides = Equations.of(FOUR_IN_ONE, 0.1), (2.2, 2.53)
    s = cauchy_line_load([0.0], [45.0])
    found = solve_equilibrium(s, equations, DirectOptions())
    size = np.array([1e-5])
    lam = ring_states(equations, found, s, sides, 0.3, size=size).lam.reshape(1, -1)
    ends, ring = contact_ends(equations, found), Ring(1.0, 0.1, 1.0, 0.3)
    lam = np.take_along_axis(lam, ends.slot, axis=1)
    C = contact_flexibility(ends, ring)[0]

    def energy(x):
        return 0.5 * x @ C @ x + 0.6 * (local_flexibility(ends, ring, x[None], size)[0] * x**2).sum()

    G = equations.assemble(found.pose, found.contacts, found.lam, s).G[0][ends.slot[0]]
    U, sizes, _ = np.linalg.svd(G)
    free = U[:, np.count_nonzero(sizes > 1e-7) :]
    assert free.shape[1] > 0
    least = energy(lam[0])
    for way in (*free.T, *-free.T):
        assert energy(lam[0] + 0.01 * way) > least * (1.0 + 1e-7)
    slope = [(energy(lam[0] + 1e-4 * w) - energy(lam[0] - 1e-4 * w)) / 2e-4 for w in free.T]
    assert np.abs(slope).max() < 1e-6 * least
    plain = ring_states(equations, found, s, sides, 0.3).lam.reshape(1, -1)
    assert np.abs(np.take_along_axis(plain, ends.slot, axis=1) - lam).max() < 0.1 * lam.max()


def test_hertz_needs_a_load():
    with pytest.raises(InputError, match="give load_N_per_mm"):
        RingOptions(hertz=True)
    with pytest.raises(InputError, match="load_N_per_mm = -1"):
        RingOptions(load_N_per_mm=-1.0)
