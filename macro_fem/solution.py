"""From a scene to a curtain: mesh, supports, loads, solver; the record that pictures and files are made of."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from homogenize.law import Array, InputError, MembraneLaw
from macro_fem.assembly import Discretization, cell_mean, discretize, internal_force, load_vector
from macro_fem.cones import Cones, green_strain
from macro_fem.fem import SupportedFem
from macro_fem.interior import Iteration
from macro_fem.loads import nodal_forces
from macro_fem.mesh import CurtainMesh, build_mesh
from macro_fem.rigid import RigidOptions, RigidResult, solve_rigid
from macro_fem.scene import Scene
from macro_fem.supports import Supports, build_supports, pin_sliding
from macro_fem.turned import turned

SLACK = 1e-3
"""Principal line loads below this part of the greatest one count as none: rules only what pictures call slack."""


@dataclass(frozen=True, eq=False)
class Problem:
    """A scene made discrete at one load step: everything a solver needs."""

    scene: Scene
    mesh: CurtainMesh
    disc: Discretization
    law: MembraneLaw
    supports: Supports
    fem: SupportedFem
    force: Array  # (n_nodes, d), N


@dataclass(frozen=True, eq=False)
class CurtainSolution:
    """The curtain at one load step.

    x (n_nodes, d) positions, mm; at the points F, E, P = F S (nq, d, 2) in N per mm of reference length, and S; primal
    and dual values of the potential -sum force . (x - X), N mm; residual: unbalanced force relative to the load;
    reactions (n_nodes, d), N.
    """

    problem: Problem
    status: str
    message: str
    x: Array
    F: Array
    P: Array
    S: Array
    primal: float
    dual: float
    residual: float
    iterations: int
    wall_s: float
    cones: Cones | None = field(default=None, repr=False)
    history: tuple[Iteration, ...] = field(default=(), repr=False)

    @property
    def E(self) -> Array:
        """Green strain (nq, 3)."""
        return green_strain(self.F)

    @property
    def displacement(self) -> Array:
        """x - X (n_nodes, d), mm."""
        return self.x - self.problem.disc.nodes

    @property
    def reactions(self) -> Array:
        """Forces of the supports on the curtain (n_nodes, d), N."""
        balance = internal_force(self.problem.disc, self.P) - self.problem.force
        return np.where(self.problem.supports.mask, balance, 0.0)

    def mean_height(self) -> float:
        """Mean of y over the reference area, mm."""
        disc = self.problem.disc
        ones = load_vector(disc, np.array([1.0]))[:, 0]
        return float(ones @ self.x[:, 1] / ones.sum())

    def principal(self) -> tuple[Array, Array]:
        """Principal line loads (n_cells, 2), larger first, and the reference direction of the larger (n_cells, 2).

        These are the singular values of P, forces per reference length: what the rings of a pitch carry, finite even
        where the mesh is drawn together to a line.
        """
        _, values, Vt = np.linalg.svd(cell_mean(self.problem.disc, self.P))
        return values, Vt[:, 0, :]

    def state(self) -> np.ndarray:
        """Per cell 0 where it is slack, 1 where it is drawn in one direction (wrinkled), 2 where it is taut in both."""
        values, _ = self.principal()
        least = SLACK * float(values.max(initial=0.0))
        return (values > least).sum(axis=1)


def make_problem(scene: Scene, law: MembraneLaw, mesh: CurtainMesh, factor: float = 1.0) -> Problem:
    """The discrete problem of a scene on a mesh, live loads and moves scaled by `factor`; InputError as found."""
    try:
        disc = discretize(mesh.mesh, scene.mesh.element)
    except ValueError as error:
        raise InputError(f"{scene.source}: [mesh] {error}") from error
    force = nodal_forces(scene, mesh, disc, law.cell, factor)
    supports = pin_sliding(build_supports(scene, mesh, disc, factor), mesh, disc, force, scene.source)
    hung = turned(law, scene.curtain.hang)
    return Problem(scene, mesh, disc, hung, supports, supports.fem(disc), force)


def solve_scene(scene: Scene, law: MembraneLaw) -> CurtainSolution:
    """The curtain of a scene at its full load.

    >>> from homogenize.law import default_law
    >>> from macro_fem.scene import read_scene
    >>> scene = read_scene({"curtain": {"width": 100.0, "height": 100.0}, "mesh": {"cells": 4},
    ...                     "support": {"kind": "top"}})
    >>> solution = solve_scene(scene, default_law())
    >>> solution.status
    'converged'
    """
    mesh = build_mesh(scene, law.cell)
    return solve_problem(make_problem(scene, law, mesh))


def solve_problem(problem: Problem) -> CurtainSolution:
    """The rigid curtain of a discrete problem."""
    begin = time.perf_counter()
    spec = problem.scene.solver
    options = RigidOptions(gap=spec.tolerance, max_iterations=spec.max_iterations)
    fem = problem.fem
    tension = spread_tension(problem)
    load = fem.gather(problem.force) + fem.force(tension * _unit(problem))
    result = solve_rigid(fem, problem.law, load, fem.unknowns(gathered_start(problem)), problem.mesh.size, options)
    return _solution(problem, result, tension, time.perf_counter() - begin)


def spread_tension(problem: Problem) -> float:
    """The even tension in N/mm that opens out slack parts; see `scene.Solver`."""
    return problem.scene.solver.spread * float(np.abs(problem.force).sum()) / problem.mesh.size


def spread_allowance(problem: Problem, tension: float) -> float:
    """How much more than the spread problem's a bound of the load's own potential must allow, N mm.

    -l.z = -(l + l_e).z + l_e.z, and l_e.z = tension times the integral of tr F over the area, |tr F|^2 <= 2 tr C with
    tr C = 2 + 2 tr E <= 2 + 4 h(I/2).
    """
    half = np.array([[0.5, 0.0, 0.5]])
    largest = np.sqrt(2.0 * (2.0 + 4.0 * float(problem.law.support(half)[0])))
    return tension * largest * float(problem.disc.weight.sum())


def _unit(problem: Problem) -> Array:
    """The unit tensor at every point (nq, d, 2)."""
    return np.broadcast_to(np.eye(problem.fem.d, 2), (problem.disc.n_points, problem.fem.d, 2))


def gathered_start(problem: Problem) -> Array:
    """Positions (n_nodes, d) of the curtain drawn up into a line through its supports: slack wherever it can be."""
    X, mask, held = problem.disc.nodes, problem.supports.mask, problem.supports.positions
    start = np.empty_like(X)
    for axis in range(2):
        nodes = mask[:, axis]
        if np.count_nonzero(nodes) and np.ptp(X[nodes, axis]) > 0.0:
            slope = np.polyfit(X[nodes, axis], held[nodes, axis], 1)[0]
            start[:, axis] = np.clip(slope, 0.0, 1.0) * (X[:, axis] - X[nodes, axis].mean()) + held[nodes, axis].mean()
        else:
            start[:, axis] = held[nodes, axis].mean() if nodes.any() else X[:, axis].mean()
    return start


def _solution(problem: Problem, result: RigidResult, tension: float, wall_s: float) -> CurtainSolution:
    """The record. The dual value is that of the spread problem, made a bound for the load's own potential."""
    fem = problem.fem
    x = fem.positions(result.z)
    primal = -float((problem.force * (x - problem.disc.nodes)).sum())
    own_load = fem.gather(problem.force)
    shift = primal + float(own_load @ result.z)  # what supports and the choice of origin add to -l.z
    held_part = float(
        (fem.weight[:, None, None] * tension * _unit(problem) * fem.gradient(np.zeros_like(result.z))).sum()
    )
    allowance = spread_allowance(problem, tension) + held_part
    return CurtainSolution(
        problem=problem,
        status=result.status,
        message=result.message,
        x=x,
        F=problem.fem.gradient(result.z),
        P=result.P,
        S=result.S,
        primal=primal,
        dual=result.dual + shift - allowance,
        residual=result.residual,
        iterations=result.iterations,
        wall_s=wall_s,
        cones=result.cones,
        history=result.history,
    )
