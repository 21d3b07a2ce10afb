"""Equilibrium of an elastic membrane: semi-smooth Newton with a line search on the total potential.

For a tensile, convex law the potential is convex in the displacement (docs/newton.md), so that every step that lowers
it leads to the one minimum, whatever the start. Three things stand in the way, and each has its rule.

Slack. Where the law is slack its tangent is zero. The matrix that is factorized is K + eps L, L the stiffness of a unit
spring in every displacement gradient, with eps proportional to the residual (regularised Newton for singular convex
problems, doi 10.1023/B:COAP.0000026881.96694.32). Energy and residual never contain eps: it bends the path, not the
answer. What remains at the end is the residual r, and convexity bounds its effect:
Pi(u) - min Pi <= sum |r_i| |u_i - u*_i|, reported as `energy_bound` with the diagonal of the box around the reference
and the deformed sheet for |u_i - u*_i|.

Kinks. The tangent jumps between taut, wrinkled and slack. The line search accepts a step only if the potential falls
and its slope along the step has lost half of its size, so that a jump behind the first half of the step is seen.

Stiffness. A sheet that hardly stretches under its load has a potential with steep walls, along which Newton creeps. As
only the ratio of load to stiffness matters, the sheet is first solved under a load so large that it does stretch, and
the excess is taken away by equal ratios (`overload_*` in `NewtonOptions`); this happens if the plain attempt fails.

Example: a strip hung by its top edge, 2 mm high, pulled by its weight.
    >>> import numpy as np, skfem
    >>> from macro_fem.assembly import discretize, load_vector
    >>> from macro_fem.materials import TensionFieldSheet
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

from macro_fem.assembly import Array, gradient, internal_force
from macro_fem.descent import Stage, Work, balance_of, descend
from macro_fem.membrane import Membrane, State, full_tangent
from macro_fem.newton_records import (
    LoadStep,
    NewtonOptions,
    NewtonRecord,
    NewtonSolution,
    NewtonStatistics,
    NewtonStatus,
    StepResult,
)

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
) -> NewtonSolution:
    """Equilibria of a membrane along load steps; stops at the first step that fails.

    start (n_nodes, d): a displacement to begin with, None for the reference state. Raises ValueError for a sheet that
    is not held (a part of the mesh free to move along some axis) and for no load step.
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
        result = _solve_step(work, number, load, u, results)
        results.append(result)
        u = result.u
        if result.status is not NewtonStatus.CONVERGED:
            break
    statistics = NewtonStatistics(
        iterations=len(work.history),
        factorizations=work.factorizations,
        evaluations=work.evaluations,
        assembly_s=work.assembly_s,
        linear_s=work.linear_s,
        wall_s=time.perf_counter() - begin,
        unknowns=work.pattern.n,
        matrix_entries=work.pattern.nnz,
        linear_method=work.solver.method,
    )
    return NewtonSolution(tuple(results), tuple(work.history), statistics)


def _solve_step(work: Work, number: int, load: LoadStep, u: Array, past: Sequence[StepResult]) -> StepResult:
    state = _start_of_step(work, load, u, past)
    options = work.options
    plain = Stage(number, load, 1.0, options.rtol)
    status, state, count = descend(work, plain, state, 0, min(options.overload_after, options.max_iterations))
    if status is NewtonStatus.ITERATION_LIMIT:
        for overload in _overloads(work, load):
            # A stage that stalls is no failure: the next one has another load.
            stage = Stage(number, load, overload, options.overload_rtol)
            _, state, count = descend(work, stage, state, count, options.max_iterations)
        status, state, count = descend(work, plain, state, count, options.max_iterations)
    balance = balance_of(work, state, load)
    reach = _bounding_diagonal(work.membrane.disc.nodes, state.u)
    return StepResult(
        load=load,
        u=state.u,
        status=status,
        potential=balance.potential,
        stored=state.stored,
        energy_bound=reach * float(np.abs(balance.residual).sum()),
        residual=balance.relative,
        tolerance=balance.tolerance,
        iterations=count,
        reactions=np.where(work.membrane.fixed, state.internal - load.force * work.membrane.force, 0.0),
    )


def _overloads(work: Work, load: LoadStep) -> list[float]:
    """Falling factors > 1 on the dead force; the first one stretches the sheet by about as much as its size.

    Empty for a sheet without dead force and for one whose potential was seen not to be convex: it may not carry more.
    """
    if not (work.is_convex and load.force != 0.0 and np.any(work.membrane.force)):
        return []
    ratio = work.options.overload_ratio
    count = int(np.ceil(np.log(max(work.stiffest / work.line_load(load), 1.0)) / np.log(ratio)))
    return [ratio**k for k in range(count, 0, -1)]


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
    return work.evaluate(u + jump + work.solve(factor, -internal_force(work.membrane.disc, dP)))


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
