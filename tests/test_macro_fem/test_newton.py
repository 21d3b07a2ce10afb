"""Newton's method against exact equilibria, and why it stops where it does not reach one."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
import skfem
from scipy.integrate import quad
from scipy.optimize import brentq

from benchmarks.sheet import ours
from benchmarks.sheet.ours import NeoHookeanSheet
from homogenize import Response, diagonal_net
from macro_fem.fem.assembly import load_vector
from macro_fem.fem.discretization import discretize
from macro_fem.fem.linear import NotPositiveDefiniteError
from macro_fem.fem.membrane import evaluate, first_piola, tangent
from macro_fem.solvers.newton import NewtonOptions, solve
from tests.test_macro_fem.sheets import TensionFieldSheet, held, mesh_of, reactions, rectangle, supported

ELEMENTS = ["P1", "P2", "CR", "Q1", "Q2"]


def hung_net(disc, stiffness):
    """The net held at the top (40 mm) and gathered to 70 %, its law, its weight and a displacement to start with."""
    X = disc.nodes
    narrow = (0.7 - 1.0) * (X - [20.0, 0.0]) * [1.0, 0.0]
    fem = supported(disc, held(disc, lambda x: x[1] == 40.0), narrow)
    return fem, diagonal_net(1.0, stiffness), load_vector(disc, np.array([0.0, -1e-3])), narrow


def aligned(n):
    """P1 on a mesh whose edges follow both diagonal families, n (a power of 2) cells along an edge of 40."""
    mesh = skfem.MeshTri.init_sqsymmetric().scaled(40.0)
    return discretize(mesh.refined(int(np.log2(n)) - 1), "P1")


@pytest.mark.parametrize("element", ELEMENTS)
def test_strip_under_its_own_weight_carries_what_hangs_below(element):
    """The row mean of P_yy is the weight below: statics alone decide it, whatever the law and the start."""
    disc = rectangle(element, 2.0, 8.0, 2, 8)
    weight = 1e-2
    force = load_vector(disc, np.array([0.0, -weight]))
    law = TensionFieldSheet(1.0, 0.0)
    fem = supported(disc, held(disc, lambda x: x[1] == 8.0), 0 * force)
    slack_start = -0.4 * (disc.nodes - [0.0, 8.0]) * [0.0, 1.0]
    assert evaluate(disc, law, slack_start).stored == 0.0  # no stiffness anywhere
    solution = solve(fem, law, force, slack_start)
    assert solution.stop == "closed"
    pull = reactions(fem, law, solution.u, force).sum(axis=0)
    np.testing.assert_allclose(pull, [0.0, weight * 16.0], atol=1e-10)
    state = evaluate(disc, law, solution.u)
    P = disc.cell_mean(first_piola(state.F, state.response.S))[:, 1, 1]
    row = np.floor(disc.cell_mean(disc.points)[:, 1]).astype(int)
    line_load = np.bincount(row, P * disc.cell_area) / np.bincount(row, disc.cell_area)
    np.testing.assert_allclose(line_load, weight * (np.arange(8) + 0.5), rtol=1e-7)


def test_slack_sheets_need_regularisation():
    """Where all is slack the tangent is zero, and nothing can be factorized; the regularised matrix can."""
    disc = rectangle("P1", 20.0, 100.0, 4, 20)
    weight = load_vector(disc, np.array([0.0, -1e-4]))
    fem, law = supported(disc, held(disc, lambda x: x[1] == 100.0), 0 * weight), diagonal_net(1.1, 1e3)
    state = evaluate(disc, law, 0 * weight)
    with pytest.raises(NotPositiveDefiniteError):
        fem.factorize(tangent(state.F, state.response.S, state.response.C))
    assert solve(fem, law, weight, 0 * weight, NewtonOptions(rtol=0.1)).stop == "closed"


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize(
    ("law", "H"),
    [
        (NeoHookeanSheet(), [[0.3, 0.1], [-0.05, 0.2]]),
        (TensionFieldSheet(1.0, 0.3), [[0.02, 0.01], [0.0, 0.015]]),  # taut
        (TensionFieldSheet(1.0, 0.3), [[0.03, 0.01], [0.0, -0.05]]),  # wrinkled
        (diagonal_net(1.0, 10.0), [[0.1, 0.02], [-0.01, 0.1]]),  # both families taut
        (diagonal_net(1.0, 10.0), [[0.02, 0.06], [0.05, -0.03]]),  # one family taut
    ],
)
def test_patch(element, law, H):
    """A plate whose whole edge moves affinely does so inside: energy and stress are those of one point."""
    rng = np.random.default_rng(1)
    mesh = mesh_of(element, 1.0, 1.0, 4, 4)
    inside = np.all((mesh.p > 0) & (mesh.p < 1), axis=0)
    shift = np.where(inside, 0.04 * rng.standard_normal(mesh.p.shape), 0.0)
    disc = discretize(type(mesh)(mesh.p + shift, mesh.t), element)
    edge = held(disc, lambda x: (x[0] == 0) | (x[0] == 1) | (x[1] == 0) | (x[1] == 1))
    u = disc.nodes @ np.array(H).T
    start = u + 0.01 * rng.standard_normal(u.shape) * ~edge
    solution = solve(supported(disc, edge, u), law, 0 * u, start)
    assert solution.stop == "closed"
    point = evaluate(disc, law, u)
    exact = float(point.response.energy[0])
    assert exact > 1e-5
    assert solution.stored == pytest.approx(exact, rel=1e-8)
    S = evaluate(disc, law, solution.u).response.S
    np.testing.assert_allclose(S, np.broadcast_to(point.response.S[0], S.shape), atol=1e-6 * np.abs(S).max())
    if isinstance(law, NeoHookeanSheet):  # a wrinkled or one-family state leaves the displacement open
        np.testing.assert_allclose(solution.u, u, atol=1e-9)


@pytest.mark.parametrize("d", [2, 3])
def test_turning_supports_and_loads_turns_the_answer(d):
    rng = np.random.default_rng(2)
    disc = rectangle("P2", 3.0, 2.0, 3, 2)
    Q, _ = np.linalg.qr(rng.standard_normal((d, d)))
    X = np.zeros((disc.n_nodes, d))
    X[:, :2] = disc.nodes
    top = held(disc, lambda x: x[1] == 2.0, d)
    force = np.zeros_like(X)
    force[:, :2] = load_vector(disc, np.array([2e-3, -1e-2]))
    law = TensionFieldSheet(1.0, 0.2)
    fine, shift = NewtonOptions(rtol=1e-11), X @ Q.T - X
    here, there = supported(disc, top, 0 * X), supported(disc, top, shift)
    plain, turned = solve(here, law, force, 0 * X, fine), solve(there, law, force @ Q.T, shift, fine)
    assert plain.stop == turned.stop == "closed"
    assert turned.stored == pytest.approx(plain.stored, rel=1e-10)
    pull, turned_pull = reactions(here, law, plain.u, force), reactions(there, law, turned.u, force @ Q.T)
    np.testing.assert_allclose(turned_pull, pull @ Q.T, atol=1e-9 * np.abs(force).sum())


def test_clamped_neo_hookean_sheet_has_the_reaction_of_other_codes():
    """20 x 20, ten steps: dolfinx, felupe and plain scikit-fem (benchmarks/sheet) agree on the number to all digits."""
    *_, answer = ours.run(20, "superlu")
    assert answer["ok"]
    assert answer["reaction"] == pytest.approx(1.1036769193333, abs=1e-11)
    assert answer["iterations"] <= 30


def test_newton_is_quadratic_where_the_law_is_smooth():
    fem, even = ours.clamped_sheet(6, "superlu")
    history = solve(ours.stretched(fem, even, 0.3), NeoHookeanSheet(), 0 * even, 0.3 * even).history
    r = np.array([h.residual for h in history])
    assert len(r) <= 5
    assert r[-1] < 10.0 * r[-2] ** 2 + 1e-9


def test_a_linear_problem_takes_one_step():
    """Infinitesimal stretch of a taut sheet: quadratic potential, one Newton step, none from the answer."""
    disc = rectangle("P2", 1.0, 1.0, 3, 3)
    edge = held(disc, lambda x: (x[0] == 0) | (x[0] == 1) | (x[1] == 0) | (x[1] == 1))
    u = 1e-9 * (disc.nodes @ np.array([[1.0, 0.2], [0.0, 0.8]]))
    u += 1e-10 * disc.nodes[:, :1] ** 2 * [1.0, 0.5]
    fem, law = supported(disc, edge, u), TensionFieldSheet(1.0, 0.3)
    start = np.where(edge, u, 1e-9 * (disc.nodes @ np.array([[1.0, 0.2], [0.0, 0.8]])))
    solution = solve(fem, law, 0 * u, start, NewtonOptions(rtol=1e-6, regularisation=1e-12))
    assert solution.stop == "closed"
    assert len(solution.history) == 1
    assert solve(fem, law, 0 * u, solution.u, NewtonOptions(rtol=1e-6, max_iterations=0)).stop == "closed"


def test_every_start_leads_to_the_one_energy():
    disc = aligned(8)
    fem, law, weight, narrow = hung_net(disc, stiffness=5.0)
    X = disc.nodes
    flung = 60.0 * np.random.default_rng(4).standard_normal(X.shape)
    found = []
    for start in (narrow, 0.99 * ([20.0, 40.0] - X), flung):
        solution = solve(fem, law, weight, np.where(fem.held, narrow, start))
        assert solution.stop == "closed"
        found.append(solution.potential)
        for before, after in pairwise(solution.history):
            assert after.potential <= before.potential + 1e-12 * abs(before.potential)
    np.testing.assert_allclose(found, found[0], rtol=1e-9)


def test_the_bound_on_the_energy_holds():
    """Stopped early, the potential exceeds the minimum by no more than the reported bound."""
    fem, law, weight, narrow = hung_net(aligned(8), stiffness=50.0)
    least = solve(fem, law, weight, narrow).potential
    seen = []
    for rtol in (1e-1, 1e-2, 1e-3, 1e-5):
        found = solve(fem, law, weight, narrow, NewtonOptions(rtol=rtol))
        assert -1e-9 * abs(least) <= found.potential - least <= found.energy_bound
        seen.append(found.energy_bound)
        # The record's own numbers: sum of what is out of balance times the diagonal of the box around both shapes.
        out = np.where(fem.held, 0.0, evaluate(fem.disc, law, found.u).internal - weight)
        x = np.concatenate([fem.reference, fem.reference + found.u])
        diagonal = np.linalg.norm(x.max(axis=0) - x.min(axis=0))
        assert found.energy_bound == pytest.approx(diagonal * np.abs(out).sum(), rel=1e-6, abs=1e-12)
    assert seen[0] > 10.0 * seen[-1]


def test_failures_have_names():
    fem, law, weight, narrow = hung_net(aligned(8), stiffness=1e3)
    short = solve(fem, law, weight, narrow, NewtonOptions(max_iterations=3))
    assert short.stop == "iterations"
    assert short.residual > 1e-3
    assert np.all(np.isfinite(short.u))
    with pytest.raises(ValueError, match="does not obey the supports"):
        solve(fem, law, weight, 0 * narrow)
    disc = rectangle("Q1", 1.0, 1.0, 2, 2)
    flat = -disc.nodes * [1.0, 0.0]  # every node on one line: no area left, and the law has no energy for that
    crushed = solve(supported(disc, flat <= 0.0, flat), NeoHookeanSheet(), 0 * flat, flat)
    assert crushed.stop == "not_finite"
    assert np.all(np.isfinite(crushed.u))
    assert not np.isnan([crushed.potential, crushed.stored, crushed.energy_bound, crushed.residual]).any()
    free = supported(disc, np.zeros_like(flat, dtype=bool), 0 * flat)  # a sheet that nothing holds
    assert solve(free, NeoHookeanSheet(), flat, 0 * flat).stop != "closed"
    for name, value in (("rtol", 0.0), ("max_gradient_step", -1.0), ("max_iterations", -1)):
        with pytest.raises(ValueError, match=name):
            NewtonOptions(**{name: value})


def test_smaller_steps_are_more_steps():
    fem, law, weight, narrow = hung_net(aligned(4), stiffness=20.0)
    plain, tame = (solve(fem, law, weight, narrow, NewtonOptions(max_gradient_step=size)) for size in (1.0, 0.02))
    assert tame.stop == plain.stop == "closed"
    assert len(tame.history) > len(plain.history)


@dataclass(frozen=True)
class TamperedLaw:
    """A tension-field sheet whose stress is spoilt by a function: what a law with errors looks like to the solver."""

    spoil: Callable[[np.ndarray], np.ndarray]

    def response(self, E):
        r = TensionFieldSheet(1.0, 0.3).response(E)
        return Response(r.energy, self.spoil(r.S), r.C, r.E_star)


def test_round_off_and_false_laws_do_not_count_as_converged():
    disc = rectangle("P2", 1.0, 1.0, 4, 4)
    force = load_vector(disc, np.array([0.0, -0.1]))
    fem = supported(disc, held(disc, lambda x: x[1] == 1.0), 0 * force)
    good = solve(fem, TensionFieldSheet(1.0, 0.3), force, 0 * force)
    single = TamperedLaw(lambda S: S.astype(np.float32).astype(float))
    rough = solve(fem, single, force, 0 * force)
    assert rough.stop == "stalled"
    assert 1e-10 < rough.residual < 1e-6
    assert rough.potential == pytest.approx(good.potential, rel=1e-9)
    # What double precision allows is added to the tolerance and reported.
    net, law, weight, narrow = hung_net(aligned(4), stiffness=20.0)
    exact = solve(net, law, weight, narrow, NewtonOptions(rtol=1e-30))
    assert exact.stop == "closed"
    assert 1e-16 < exact.tolerance < 1e-11
    false = solve(fem, TamperedLaw(lambda S: -S), force, 0 * force)
    assert false.stop in ("stalled", "not_convex", "iterations")
    assert false.residual > 1e-3
    assert np.all(np.isfinite(false.u))


def test_a_catenary_in_space():
    """A strip between two rails under a weight across it, d = 3, in closed form; the mesh converges at order 2.

    T = (H, q (s - L/2)) is the force in the strip at the reference length s; its stretch follows from
    |T| = k l (l^2 - 1)/2, and H from the distance of the rails.
    """
    k, q, L = 1.0, 0.3, 4.0

    def stretch(T):
        return brentq(lambda l: k * l * (l**2 - 1) / 2 - T, 1.0, 10.0)

    def force_and_rise(H):
        T = lambda s: np.hypot(H, q * (s - L / 2))  # noqa: E731
        span = quad(lambda s: stretch(T(s)) * H / T(s), 0, L, epsabs=1e-12)[0]
        sag = quad(lambda s: stretch(T(s)) * q * (L / 2 - s) / T(s), 0, L / 2, epsabs=1e-12)[0]
        return span, sag

    H = brentq(lambda H: force_and_rise(H)[0] - L, 0.05, 5.0, xtol=1e-13)
    sag = force_and_rise(H)[1]
    errors = []
    for n in (8, 16):
        disc = rectangle("Q1", L, 1.0, n, 1)
        rails = held(disc, lambda x: (x[0] == 0.0) | (x[0] == L), d=3)
        weight = load_vector(disc, np.array([0.0, 0.0, -q]))
        fem, law = supported(disc, rails, 0 * weight), TensionFieldSheet(k, 0.0)
        solution = solve(fem, law, weight, 0 * weight)
        assert solution.stop == "closed"
        rail = reactions(fem, law, solution.u, weight)[disc.nodes[:, 0] == 0.0].sum(axis=0)
        np.testing.assert_allclose(rail[1:], [0.0, q * L / 2], atol=1e-9)
        pull = -rail[0]
        errors.append([abs(pull - H) / H, abs(-solution.u[:, 2].min() - sag) / sag])
    errors = np.array(errors)
    assert np.all(errors[1] < 5e-3)
    np.testing.assert_allclose(errors[0] / errors[1], 4.0, rtol=0.15)
