"""The Newton solver against exact equilibria, against the rigid limit, and where it must say that it failed."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
import skfem
from scipy.integrate import quad
from scipy.optimize import brentq

from homogenize.laws.net import diagonal_net
from homogenize.laws.protocol import Response
from macro_fem.fem.assembly import cell_mean, discretize, interpolate, load_vector
from macro_fem.fem.linear import LinearOptions
from macro_fem.fem.materials import NeoHookeanSheet, TensionFieldSheet
from macro_fem.fem.membrane import evaluate, first_piola
from macro_fem.solvers.newton import LoadStep, Membrane, NewtonOptions, NewtonStatus, solve

ELEMENTS = ["P1", "P2", "CR", "Q1", "Q2"]
NET_HEIGHT = 14.187635  # mean height of the inextensible net on the 40 x 40 square gathered to 70 %


def rectangle(element, width, height, nx, ny):
    mesh_type = skfem.MeshQuad if element[0] == "Q" else skfem.MeshTri
    return discretize(mesh_type.init_tensor(np.linspace(0, width, nx + 1), np.linspace(0, height, ny + 1)), element)


def held(disc, where, d=2):
    return np.repeat(where(disc.nodes.T)[:, None], d, axis=1)


def hung_net(disc, gather=0.7, stiffness=1000.0, weight=1e-3):
    """The net held at the top (40 mm), gathered, under its weight (N/mm2)."""
    X = disc.nodes
    fixed = held(disc, lambda x: x[1] == 40.0)
    displacement = np.zeros_like(X)
    displacement[:, 0] = (gather - 1.0) * (X[:, 0] - 20.0)
    return Membrane(
        disc, diagonal_net(1.0, stiffness), fixed, displacement, load_vector(disc, np.array([0.0, -weight]))
    )


def aligned(n):
    """P1 on a mesh whose edges follow both diagonal families, n (a power of 2) cells along an edge of 40."""
    mesh = skfem.MeshTri.init_sqsymmetric().scaled(40.0)
    return discretize(mesh.refined(int(np.log2(n)) - 1), "P1")


def mean_height(disc, u):
    return float(interpolate(disc, disc.nodes + u)[:, 1] @ disc.weight / disc.weight.sum())


@pytest.mark.parametrize("element", ELEMENTS)
def test_strip_under_its_own_weight_carries_what_hangs_below(element):
    """The row mean of P_yy is the weight below: statics alone decide it, whatever the law and the start."""
    disc = rectangle(element, 2.0, 8.0, 2, 8)
    weight = 1e-2
    force = load_vector(disc, np.array([0.0, -weight]))
    sheet = Membrane(disc, TensionFieldSheet(1.0, 0.0), held(disc, lambda x: x[1] == 8.0), 0 * force, force)
    slack_start = -0.4 * (disc.nodes - [0.0, 8.0]) * [0.0, 1.0]
    solution = solve(sheet, start=slack_start)
    assert solution.status is NewtonStatus.CONVERGED
    assert solution.history[0].slack == 1.0  # no stiffness anywhere
    np.testing.assert_allclose(solution.reactions.sum(axis=0), [0.0, weight * 16.0], atol=1e-10)
    state = evaluate(sheet, solution.u)
    P = cell_mean(disc, first_piola(state.F, state.response.S))[:, 1, 1]
    area = disc.weight.reshape(disc.n_quad, -1).sum(axis=0)
    row = np.floor(cell_mean(disc, disc.points)[:, 1]).astype(int)
    line_load = np.bincount(row, P * area) / np.bincount(row, area)
    np.testing.assert_allclose(line_load, weight * (np.arange(8) + 0.5), rtol=1e-7)


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
    base = rectangle(element, 1.0, 1.0, 4, 4)
    mesh_type = skfem.MeshQuad if element[0] == "Q" else skfem.MeshTri
    mesh = mesh_type.init_tensor(np.linspace(0, 1, 5), np.linspace(0, 1, 5))
    inside = np.all((mesh.p > 0) & (mesh.p < 1), axis=0)
    shift = np.where(inside, 0.04 * rng.standard_normal(mesh.p.shape), 0.0)
    disc = discretize(mesh_type(mesh.p + shift, mesh.t), element)
    assert disc.n_nodes == base.n_nodes
    edge = held(disc, lambda x: (x[0] == 0) | (x[0] == 1) | (x[1] == 0) | (x[1] == 1))
    u = disc.nodes @ np.array(H).T
    start = u + 0.01 * rng.standard_normal(u.shape) * ~edge
    sheet = Membrane(disc, law, edge, u, 0 * u)
    solution = solve(sheet, start=start)
    assert solution.status is NewtonStatus.CONVERGED
    point = evaluate(sheet, u)
    exact = float(point.response.energy[0])
    assert exact > 1e-5
    assert solution.steps[-1].stored == pytest.approx(exact, rel=1e-8)
    S = evaluate(sheet, solution.u).response.S
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
    plain = solve(Membrane(disc, law, top, 0 * X, force), NewtonOptions(rtol=1e-11))
    turned = solve(Membrane(disc, law, top, X @ Q.T - X, force @ Q.T), NewtonOptions(rtol=1e-11), start=X @ Q.T - X)
    assert plain.status is turned.status is NewtonStatus.CONVERGED
    assert turned.steps[-1].stored == pytest.approx(plain.steps[-1].stored, rel=1e-10)
    np.testing.assert_allclose(turned.reactions, plain.reactions @ Q.T, atol=1e-9 * np.abs(force).sum())


def test_clamped_neo_hookean_sheet_has_the_reaction_of_other_codes():
    """20 x 20: dolfinx, felupe and plain scikit-fem (benchmarks/sheet) agree on the number to all digits given."""
    disc = rectangle("Q1", 1.0, 1.0, 20, 20)
    right = disc.nodes[:, 0] == 1.0
    displacement = np.zeros_like(disc.nodes)
    displacement[right, 0] = 0.5
    edges = held(disc, lambda x: (x[0] == 0.0) | (x[0] == 1.0))
    sheet = Membrane(disc, NeoHookeanSheet(), edges, displacement, 0 * displacement)
    path = [LoadStep(displacement=k / 10) for k in range(1, 11)]
    solution = solve(sheet, steps=path)
    assert solution.status is NewtonStatus.CONVERGED
    assert len(solution.steps) == 10
    assert solution.reactions[right, 0].sum() == pytest.approx(REACTION_20, abs=1e-11)
    # Work of the supports equals the stored energy to the error of the trapezoidal rule over ten steps.
    pull = np.array([0.0] + [s.reactions[right, 0].sum() for s in solution.steps])
    assert 0.05 * (pull[1:] + pull[:-1]).sum() / 2 == pytest.approx(solution.steps[-1].stored, rel=2e-3)
    # Extrapolation saves factorizations and changes no digit that counts.
    slow = solve(sheet, NewtonOptions(predictor_order=0), steps=path)
    assert slow.statistics.factorizations > solution.statistics.factorizations
    np.testing.assert_allclose(slow.u, solution.u, atol=1e-9)


REACTION_20 = 1.1036769193333


def test_newton_is_quadratic_where_the_law_is_smooth():
    disc = rectangle("Q1", 1.0, 1.0, 6, 6)
    right = disc.nodes[:, 0] == 1.0
    displacement = np.zeros_like(disc.nodes)
    displacement[right, 0] = 0.3
    edges = held(disc, lambda x: (x[0] == 0.0) | (x[0] == 1.0))
    history = solve(Membrane(disc, NeoHookeanSheet(), edges, displacement, 0 * displacement)).history
    r = np.array([h.residual for h in history])
    assert len(r) <= 5
    assert r[-1] < 10.0 * r[-2] ** 2 + 1e-9


def test_a_linear_problem_takes_one_step():
    """Infinitesimal stretch of a taut sheet: quadratic potential, one Newton step, none from the answer."""
    disc = rectangle("P2", 1.0, 1.0, 3, 3)
    edge = held(disc, lambda x: (x[0] == 0) | (x[0] == 1) | (x[1] == 0) | (x[1] == 1))
    u = 1e-9 * (disc.nodes @ np.array([[1.0, 0.2], [0.0, 0.8]]))
    u += 1e-10 * disc.nodes[:, :1] ** 2 * [1.0, 0.5]
    sheet = Membrane(disc, TensionFieldSheet(1.0, 0.3), edge, u, 0 * u)
    start = np.where(edge, u, 1e-9 * (disc.nodes @ np.array([[1.0, 0.2], [0.0, 0.8]])))
    solution = solve(sheet, NewtonOptions(rtol=1e-6, regularisation=1e-12), start=start)
    assert solution.status is NewtonStatus.CONVERGED
    assert solution.statistics.iterations == 1
    assert solve(sheet, NewtonOptions(rtol=1e-6, max_iterations=0), start=solution.u).status is NewtonStatus.CONVERGED


def test_every_start_leads_to_the_one_energy():
    disc = aligned(8)
    sheet = hung_net(disc, stiffness=5.0)
    X = disc.nodes
    flung = 60.0 * np.random.default_rng(4).standard_normal(X.shape)
    found = []
    for start in (0 * X, 0.99 * ([20.0, 40.0] - X), flung):
        solution = solve(sheet, start=start)
        assert solution.status is NewtonStatus.CONVERGED
        found.append(solution.steps[-1].potential)
        for before, after in pairwise(solution.history):  # the potential falls from step to step of a stage
            if before.softness == after.softness:
                assert after.potential <= before.potential + 1e-12 * abs(before.potential)
    np.testing.assert_allclose(found, found[0], rtol=1e-9)


def test_the_rigid_net_is_reached_in_proportion_to_the_compliance():
    disc = aligned(8)
    heights = []
    for stiffness in (1e2, 1e3, 1e4):
        solution = solve(hung_net(disc, stiffness=stiffness))
        assert solution.status is NewtonStatus.CONVERGED
        heights.append(mean_height(disc, solution.u))
    sag = NET_HEIGHT - np.array(heights)
    assert np.all(sag > 0.0)
    np.testing.assert_allclose(sag[:-1] / sag[1:], 10.0, rtol=0.02)
    # Extrapolated to no compliance it is the exact answer of the inextensible net, given to 1e-6.
    assert heights[2] + (heights[2] - heights[1]) / 9.0 == pytest.approx(NET_HEIGHT, abs=2e-6)


def test_the_bound_on_the_energy_holds():
    """Stopped early, the potential exceeds the minimum by no more than the reported bound."""
    sheet = hung_net(aligned(8), stiffness=50.0)
    least = solve(sheet).steps[-1].potential
    seen = []
    for rtol in (1e-1, 1e-2, 1e-3, 1e-5):
        step = solve(sheet, NewtonOptions(rtol=rtol)).steps[-1]
        assert -1e-9 * abs(least) <= step.potential - least <= step.energy_bound
        seen.append(step.energy_bound)
        # The record's own numbers: sum of what is out of balance times the diagonal of the box around both shapes.
        out = np.where(sheet.fixed, 0.0, evaluate(sheet, step.u).internal - sheet.force)
        x = np.concatenate([sheet.disc.nodes, sheet.disc.nodes + step.u])
        diagonal = np.linalg.norm(x.max(axis=0) - x.min(axis=0))
        assert step.energy_bound == pytest.approx(diagonal * np.abs(out).sum(), rel=1e-6, abs=1e-12)
    assert seen[0] > 10.0 * seen[-1]


def test_failures_have_names():
    stiff = hung_net(aligned(8), stiffness=1e3)
    short = solve(stiff, NewtonOptions(max_iterations=3))
    assert short.status is NewtonStatus.ITERATION_LIMIT
    assert "max_iterations" in short.status.value
    assert short.steps[-1].residual > 1e-3
    assert np.all(np.isfinite(short.u))
    disc = rectangle("Q1", 1.0, 1.0, 2, 2)
    flat = -disc.nodes * [1.0, 0.0]  # every node held on one line: no area left, and the law has no energy for that
    crushed = solve(Membrane(disc, NeoHookeanSheet(), flat <= 0.0, flat, 0 * flat), steps=[LoadStep(), LoadStep()])
    assert crushed.status is NewtonStatus.NOT_FINITE
    assert "smaller steps" in crushed.status.value
    assert len(crushed.steps) == 1  # the path ends where it fails
    last = crushed.steps[-1]
    assert np.all(np.isfinite(last.u))
    assert np.all(np.isfinite(last.reactions))
    assert not np.isnan([last.potential, last.stored, last.energy_bound, last.residual]).any()
    assert last.tolerance == NewtonOptions().rtol


@dataclass(frozen=True)
class TamperedLaw:
    """A tension-field sheet whose stress is spoilt by a function: what a law with errors looks like to the solver."""

    spoil: Callable[[np.ndarray], np.ndarray]

    def response(self, E):
        r = TensionFieldSheet(1.0, 0.3).response(E)
        return Response(r.energy, self.spoil(r.S), r.C, r.E_star)


def test_round_off_and_false_laws_are_called_by_their_names():
    disc = rectangle("P2", 1.0, 1.0, 4, 4)
    force = load_vector(disc, np.array([0.0, -0.1]))
    top = held(disc, lambda x: x[1] == 1.0)
    good = solve(Membrane(disc, TensionFieldSheet(1.0, 0.3), top, 0 * force, force))
    single = TamperedLaw(lambda S: S.astype(np.float32).astype(float))
    rough = solve(Membrane(disc, single, top, 0 * force, force))
    assert rough.status is NewtonStatus.ROUND_OFF
    assert rough.status.is_solution
    assert 1e-10 < rough.steps[-1].residual < 1e-6
    assert rough.steps[-1].potential == pytest.approx(good.steps[-1].potential, rel=1e-9)
    # What double precision allows is added to the tolerance and reported: the impossible is not asked for.
    exact = solve(hung_net(aligned(4), stiffness=20.0), NewtonOptions(rtol=1e-30))
    assert exact.status is NewtonStatus.CONVERGED
    assert 1e-16 < exact.steps[-1].tolerance < 1e-11
    false = solve(Membrane(disc, TamperedLaw(lambda S: -S), top, 0 * force, force))
    assert not false.status.is_solution
    assert false.status in (NewtonStatus.STALLED, NewtonStatus.NOT_CONVEX, NewtonStatus.ITERATION_LIMIT)
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
        solution = solve(Membrane(disc, TensionFieldSheet(k, 0.0), rails, 0 * weight, weight))
        assert solution.status is NewtonStatus.CONVERGED
        left = disc.nodes[:, 0] == 0.0
        np.testing.assert_allclose(solution.reactions[left].sum(axis=0)[1:], [0.0, q * L / 2], atol=1e-9)
        pull = -solution.reactions[left, 0].sum()
        errors.append([abs(pull - H) / H, abs(-solution.u[:, 2].min() - sag) / sag])
    errors = np.array(errors)
    assert np.all(errors[1] < 5e-3)
    np.testing.assert_allclose(errors[0] / errors[1], 4.0, rtol=0.15)


def test_a_known_stress_shortens_the_way():
    """Started from the answer of a law a hundred times stiffer, with its stress, the soft stages are few."""
    disc = aligned(8)
    near = solve(hung_net(disc, stiffness=1e4))
    S = evaluate(hung_net(disc, stiffness=1e4), near.u).response.S
    sheet = hung_net(disc, stiffness=1e3)
    cold = solve(sheet)
    warm = solve(sheet, start=near.u, stress=S)
    assert warm.status is cold.status is NewtonStatus.CONVERGED
    assert warm.steps[-1].potential == pytest.approx(cold.steps[-1].potential, rel=1e-9)
    assert warm.statistics.iterations < 0.5 * cold.statistics.iterations
    assert 1.0 < warm.history[0].softness <= 30.0 * 1.5  # no plain attempt first, and no more softness than it needs
    assert cold.history[0].softness == 1.0


def test_sheets_that_are_not_held_are_refused():
    disc = rectangle("P1", 1.0, 1.0, 2, 2)
    nothing = np.zeros_like(disc.nodes)
    with pytest.raises(ValueError, match="held nowhere along axis x"):
        solve(Membrane(disc, NeoHookeanSheet(), nothing > 0, nothing, nothing))
    one_way = held(disc, lambda x: x[1] == 1.0)
    one_way[:, 1] = False
    with pytest.raises(ValueError, match="held nowhere along axis y"):
        solve(Membrane(disc, NeoHookeanSheet(), one_way, nothing, nothing))
    left, right = skfem.MeshTri(), skfem.MeshTri().translated((2.0, 0.0))
    two = discretize(skfem.MeshTri(np.hstack([left.p, right.p]), np.hstack([left.t, right.t + 4])), "P1")
    nothing = np.zeros_like(two.nodes)
    with pytest.raises(ValueError, match=r"around \(2, 0\) mm is held nowhere"):
        solve(Membrane(two, NeoHookeanSheet(), held(two, lambda x: x[0] == 0.0), nothing, nothing))
    with pytest.raises(ValueError, match="no load step"):
        solve(
            Membrane(disc, NeoHookeanSheet(), held(disc, lambda x: x[1] == 1.0), 0 * disc.nodes, 0 * disc.nodes),
            steps=[],
        )


def test_options_act_and_bad_ones_are_refused():
    sheet = hung_net(aligned(4), stiffness=20.0)
    assert solve(sheet, NewtonOptions(rtol=1e-2)).statistics.iterations < solve(sheet).statistics.iterations
    tame = solve(sheet, NewtonOptions(max_gradient_step=0.02, soften_after=500))
    assert tame.statistics.iterations > solve(sheet, NewtonOptions(soften_after=500)).statistics.iterations
    assert max(h.softness for h in solve(sheet, NewtonOptions(soften_after=2)).history) > 1.0
    assert max(h.softness for h in solve(sheet, NewtonOptions(soften_after=500)).history) == 1.0
    jacobi = solve(sheet, NewtonOptions(linear=LinearOptions(method="jacobi", max_iterations=2000)))
    assert jacobi.statistics.linear_method == "jacobi"
    assert jacobi.steps[-1].potential == pytest.approx(solve(sheet).steps[-1].potential, rel=1e-9)
    few = solve(sheet, NewtonOptions(linear=LinearOptions(method="jacobi", max_iterations=4), max_iterations=5))
    assert max(h.linear_residual for h in few.history) > 1e-6  # an unfinished linear solve is on record
    for bad in ({"rtol": 0.0}, {"max_gradient_step": -1.0}, {"soften_ratio": 1.0}, {"max_iterations": -1}):
        with pytest.raises(ValueError, match=next(iter(bad))):
            NewtonOptions(**bad)
