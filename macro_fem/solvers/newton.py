"""Equilibrium of an elastic membrane: semi-smooth Newton with a line search on the total potential.

For a tensile, convex law the potential is convex in the displacement (docs/newton.md), so that every step that lowers
it leads to the one minimum, whatever the start. Three things stand in the way, and each has its rule.

Slack. Where the law is slack its tangent is zero. The matrix that is factorized is K + eps L, L the stiffness of a unit
spring in every displacement gradient, with eps proportional to the residual (regularised Newton of Li,
Fukushima, Qi and Yamashita, Comput. Optim. Appl. 28, 2004). Energy and residual never contain eps: it bends the path,
not the answer. What remains at the end is the residual r, and convexity bounds its effect:
Pi(u) - min Pi <= sum |r_i| |u_i - u*_i|, reported as `energy_bound` with the diagonal of the box around the reference
and the deformed sheet for |u_i - u*_i|.

Kinks. The tangent jumps between taut, wrinkled and slack. The line search accepts a step only if the potential falls
and its slope along the step has lost half of its size, so that a jump behind the first half of the step is seen.

Stiffness. A sheet that hardly stretches under its load has a potential with steep walls, along which Newton creeps. If
the plain attempt fails and the law has one compliance, the sheet is first made so soft that it does stretch, then
hardened by equal ratios while it remembers the stress (`macro_fem.solvers.softened`, `soften_*` in `NewtonOptions`).
The stress of ideal locking, from the rigid solver, saves most of that way: see `stress` in `solve`.

Example: a strip hung by its top edge, 2 mm high, pulled by its weight.
    >>> import numpy as np, skfem
    >>> from macro_fem.fem.assembly import discretize, load_vector
    >>> from macro_fem.fem.materials import TensionFieldSheet
    >>> disc = discretize(skfem.MeshTri.init_tensor(np.linspace(0, 1, 3), np.linspace(0, 2, 5)), "P1")
    >>> held = np.repeat(disc.nodes[:, 1:] == 2.0, 2, axis=1)
    >>> weight = load_vector(disc, np.array([0.0, -1e-3]))
    >>> sheet = Membrane(disc, TensionFieldSheet(young=1.0, poisson=0.0), held, np.zeros_like(weight), weight)
    >>> solution = solve(sheet)
    >>> solution.status.name, float(round(solution.reactions[:, 1].sum(), 9))
    ('CONVERGED', 0.002)
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from scipy import sparse

from macro_fem.fem.assembly import Array, gradient, internal_force
from macro_fem.fem.membrane import Membrane, State, full_tangent
from macro_fem.solvers.descent import Stage, Work, balance_of, descend
from macro_fem.solvers.newton_records import (
    LoadStep,
    NewtonOptions,
    NewtonRecord,
    NewtonSolution,
    NewtonStatistics,
    NewtonStatus,
    StepResult,
)
from macro_fem.solvers.softened import CompliantLaw, softnesses

__all__ = [
    "LoadStep",
    "Membrane",
    "NewtonOptions",
    "NewtonRecord",
    "NewtonSolution",
    "NewtonStatistics",
    "NewtonStatus",
    "StepResult",
    "solve",
]


def solve(
    membrane: Membrane,
    options: NewtonOptions | None = None,
    start: Array | None = None,
    steps: Sequence[LoadStep] = (LoadStep(),),
    stress: Array | None = None,
) -> NewtonSolution:
    """Equilibria of a membrane along load steps; stops at the first step that fails.

    start (n_nodes, d): a displacement to begin with, None for the reference state. stress (n_points, 3): line loads S
    that nearly balance the first load step, such as those of the rigid solver; it needs a law with a compliance. Raises
    ValueError for a sheet that is not held (a part of the mesh free to move along some axis) and for no load step.
    """
    begin = time.perf_counter()
    options = options or NewtonOptions()
    if not steps:
        raise ValueError("there is no load step")
    _refuse_loose_parts(membrane)
    work = Work.of(membrane, options)
    u = np.zeros(membrane.fixed.shape) if start is None else np.array(start, dtype=float)
    results: list[StepResult] = []
    for number, load in enumerate(steps):
        result = _solve_step(work, number, load, u, results, stress if number == 0 else None)
        results.append(result)
        u = result.u
        if not result.status.is_solution:
            break
    statistics = NewtonStatistics(
        iterations=len(work.history),
        factorizations=work.factorizations,
        evaluations=work.evaluations,
        assembly_s=work.assembly_s,
        linear_s=work.linear_s,
        wall_s=time.perf_counter() - begin,
        unknowns=len(work.gather(u)),
        matrix_entries=len(work.spring),
        linear_method=work.solver.method,
    )
    return NewtonSolution(tuple(results), tuple(work.history), statistics)


def _solve_step(
    work: Work, number: int, load: LoadStep, u: Array, past: Sequence[StepResult], stress: Array | None
) -> StepResult:
    options = work.options
    state = _start_of_step(work, load, u, past)
    plain = Stage(number, load, 1.0, options.rtol)
    status, count = NewtonStatus.ITERATION_LIMIT, 0
    if stress is None:
        status, state, count = descend(work, plain, state, 0, min(options.soften_after, options.max_iterations))
    if status is NewtonStatus.ITERATION_LIMIT:
        state, count = _from_soft_to_hard(work, plain, state, count, stress)
        status, state, count = descend(work, plain, state, count, options.max_iterations)
    if status is NewtonStatus.NOT_FINITE:
        return StepResult(load, u, status, np.inf, np.inf, np.inf, np.inf, options.rtol, count, np.zeros_like(u))
    balance = balance_of(work, state, load)
    reach = _bounding_diagonal(work.membrane.disc.nodes, state.u)
    return StepResult(
        load=load,
        u=state.u,
        status=status,
        potential=balance.potential,
        stored=state.stored,
        energy_bound=reach * float(np.abs(work.gather(balance.residual)).sum()),
        residual=balance.relative,
        tolerance=balance.tolerance,
        iterations=count,
        reactions=np.where(work.membrane.fixed, state.internal - load.force * work.membrane.force, 0.0),
    )


def _from_soft_to_hard(work: Work, plain: Stage, state: State, count: int, stress: Array | None) -> tuple[State, int]:
    """The state after all softened stages, ready for the true law; unchanged if the law has no compliance."""
    law, options = work.true.law, work.options
    if not isinstance(law, CompliantLaw):
        return state, count
    warm = None if stress is None else options.soften_warm
    S = np.zeros_like(state.response.S) if stress is None else stress
    for softness in softnesses(law, work.line_load(plain.load), options.soften_ratio, warm):
        work.soften(law, softness, S)
        stage = Stage(plain.number, plain.load, softness, options.soften_rtol)
        # A stage that stalls or runs out of iterations is no failure: the next one has another law.
        limit = min(count + options.soften_iterations, options.max_iterations)
        _, state, count = descend(work, stage, work.evaluate(state.u), count, limit)
        S = state.response.S
    work.harden()
    return work.evaluate(state.u), count


def _start_of_step(work: Work, load: LoadStep, u: Array, past: Sequence[StepResult]) -> State:
    """Where Newton starts: the last displacement with the supports moved, extrapolated or along the tangent.

    Of several extrapolations the one with the lowest potential is taken: all obey the same supports.
    """
    fixed = work.membrane.fixed
    target = load.displacement * work.membrane.displacement
    jump = np.where(fixed, target - u, 0.0)
    if not np.any(jump):
        return work.evaluate(u)
    guesses = _extrapolations(load, past, work.options.predictor_order)
    states = [work.evaluate(np.where(fixed, target, guess)) for guess in guesses]
    states = [state for state in states if state.is_finite]
    if states:
        return min(states, key=lambda state: balance_of(work, state, load).potential)
    state = work.evaluate(u)
    if not state.is_finite:
        return state
    A, data = work.tangent(state)
    factored = work.factorize(data, 1e-6 * (work.stiffest or work.line_load(load)))
    if factored is None:
        return work.evaluate(np.where(fixed, target, u))
    factor, eps = factored
    H = gradient(work.membrane.disc, jump)
    dP = np.einsum("pijkl,pkl->pij", full_tangent(A), H) + eps * H
    solved = work.solve(factor, -internal_force(work.membrane.disc, dP))
    return work.evaluate(u + jump + (0.0 if solved is None else solved[0]))


def _extrapolations(load: LoadStep, past: Sequence[StepResult], highest: int) -> list[Array]:
    """Polynomials through the last 2, 3, ... load steps at this one's displacement share, the reference state included.

    Empty if the path turned: then the past says nothing about what comes.
    """
    shares = [0.0, *(step.load.displacement for step in past)]
    fields = [np.zeros_like(past[0].u) if past else np.zeros(0), *(step.u for step in past)]
    path = np.diff([*shares, load.displacement])
    same_force = all(step.load.force == load.force for step in past)
    if not past or not same_force or not (np.all(path > 0.0) or np.all(path < 0.0)):
        return []
    guesses = []
    for order in range(1, min(highest, len(past)) + 1):
        s, v = shares[-order - 1 :], fields[-order - 1 :]
        lagrange = [np.prod([(load.displacement - b) / (a - b) for b in s if b != a]) for a in s]
        guesses.append(sum((c * f for c, f in zip(lagrange, v, strict=True)), np.zeros_like(v[0])))
    return guesses


def _bounding_diagonal(nodes: Array, u: Array) -> float:
    """Diagonal of the box around the reference and the deformed sheet, mm."""
    x = u.copy()
    x[:, :2] += nodes
    flat = np.zeros_like(u)
    flat[:, :2] = nodes
    both = np.concatenate([x, flat])
    return float(np.linalg.norm(both.max(axis=0) - both.min(axis=0)))


def _refuse_loose_parts(membrane: Membrane) -> None:
    """ValueError if a connected part of the mesh is held nowhere along some axis."""
    disc = membrane.disc
    used = np.unique(disc.cell_dofs)
    n_local = disc.cell_dofs.shape[1]
    first = np.repeat(disc.cell_dofs[:, 0], n_local)
    graph = sparse.coo_matrix((np.ones(len(first)), (first, disc.cell_dofs.ravel())), shape=(disc.n_nodes,) * 2)
    _, part = sparse.csgraph.connected_components(graph, directed=False)
    for i in range(membrane.d):
        loose = np.setdiff1d(part[used], part[membrane.fixed[:, i]])
        if len(loose):
            where = disc.nodes[used[part[used] == loose[0]][0]]
            raise ValueError(
                f"the part of the mesh around ({where[0]:g}, {where[1]:g}) mm is held nowhere along axis {'xyz'[i]}: "
                "add a support"
            )
