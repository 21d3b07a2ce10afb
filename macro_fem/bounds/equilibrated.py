"""Equilibrated stresses: the hybrid element whose cone program bounds the potential from below.

In every triangle the stress P is linear, its tractions P n are continuous (linear on every edge, the element of
Brezzi, Douglas and Marini, doi 10.1007/BF01389710), -div P = q in every triangle. Any such P gives, for the
*continuous* curtain,

    -l.x  >=  sum of support tractions times held positions  -  integral of psi*(P),   psi*(P) = max of P:F in the law,

and the integral is at most the mean over the corners of each triangle, psi* being convex. The best such bound is
again a cone program, and its unknowns look like displacements: u_T in each triangle (for -div P = q) and two values
u_e at the ends of each edge (for the tractions). The gradient that P sees at the corner v of a triangle is

    G(v) = -3 u_T (x) grad lam_v - 6 sum over edges e of  (integral of lam_v u_e over e / |e|) (x) grad lam_opposite(e),

so the arrays of `macro_fem.fem.discretization.Discretization` describe it: seven nodes, three points, constant
coefficients. In space P is 3 x 2 and all of this holds component by component. Walls push evenly in every triangle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from homogenize import MembraneLaw
from macro_fem.fem.assembly import load_vector
from macro_fem.fem.cells import in_space_of
from macro_fem.fem.discretization import Discretization, Points, discretize
from macro_fem.fem.hung_law import largest_stretch
from macro_fem.fem.supported import SupportedFem
from macro_fem.scene.loads import disk_areas, weight_per_area, wind_per_area
from macro_fem.scene.meshing.mesh import CurtainMesh
from macro_fem.scene.schema import Scene
from macro_fem.scene.sites import Held, Sliding, sliding_nodes
from macro_fem.scene.supports import Supports, pin_sliding, straight_ties
from macro_fem.scene.tables import Bar, EdgeLoad, PatchLoad, PointLoad, Wind
from macro_fem.solution import CurtainSolution, slackened
from macro_fem.solvers.walls import Walls
from rve.common import Array


@dataclass(frozen=True, eq=False)
class DualMesh:
    """The hybrid element on a mesh: `disc`, and where its unknowns sit.

    Node 2 f + k belongs to end k (corner `facets[k, f]`) of edge f, node 2 n_facets + c to triangle c.
    """

    mesh: CurtainMesh
    disc: Discretization

    @property
    def facets(self) -> np.ndarray:
        """Corner numbers (2, n_facets) of the ends of the edges."""
        return self.mesh.mesh.facets

    @cached_property
    def edges(self) -> Array:
        """Every edge from its first to its second end (n_facets, 2), mm."""
        first, second = self.mesh.mesh.p.T[self.facets]
        return np.asarray(second - first)

    @cached_property
    def edge_lengths(self) -> Array:
        """Length of every edge (n_facets,), mm."""
        return np.hypot(*self.edges.T)


def dual_mesh(mesh: CurtainMesh) -> DualMesh:
    """The hybrid element on a mesh of triangles."""
    sk, flat = mesh.mesh, discretize(mesh.mesh, "P1")
    n_facets, n_cells = sk.facets.shape[1], sk.t.shape[1]
    dofs = np.empty((n_cells, 7), dtype=np.int64)
    # skfem numbers the edges of a triangle (0, 1), (1, 2), (0, 2); the corner opposite to each:
    for local, (a, b) in enumerate(((0, 1), (1, 2), (0, 2))):
        facet = sk.t2f[local]
        for column, corner in ((2 * local, a), (2 * local + 1, b)):
            dofs[:, column] = 2 * facet + (sk.facets[1, facet] == sk.t[corner])
    dofs[:, 6] = 2 * n_facets + np.arange(n_cells)
    ends = sk.p[:, sk.facets]  # (2, end, facet)
    nodes = np.concatenate([ends.transpose(2, 1, 0).reshape(-1, 2), sk.p[:, sk.t].mean(axis=1).T])
    disc = replace(
        flat,
        element="equilibrium",
        nodes=nodes,
        cell_dofs=dofs,
        shape_values=np.tile(np.array([0.0] * 6 + [1.0]), (3, 1)),
        shape_gradients=_reference_gradients(flat.shape_gradients[0]),
        weight=np.tile(flat.weight / 3.0, 3),
    )
    return DualMesh(mesh, disc)


def _reference_gradients(corner_gradients: Array) -> Array:
    """Coefficients (3 corners, 2, 7) of G(v) from grad lam (2, 3) of the reference triangle; see the module header."""
    result = np.zeros((3, 2, 7))
    for v in range(3):
        result[v, :, 6] = -3.0 * corner_gradients[:, v]
        for local, (a, b, opposite) in enumerate(((0, 1, 2), (1, 2, 0), (0, 2, 1))):
            shares = {a: (1.0 / 3.0, 1.0 / 6.0), b: (1.0 / 6.0, 1.0 / 3.0)}.get(v, (0.0, 0.0))
            for k in range(2):
                result[v, :, 2 * local + k] = -6.0 * shares[k] * corner_gradients[:, opposite]
    return result


@dataclass(frozen=True, eq=False)
class Tethers:
    """Edges that stand for a point: reaction or load is spread over them instead of acting at corner `corner`.

    facet (k,), near (k,): which end of the facet the point is at; centre (k, d): where the point is held (nan for
    loads).
    """

    facet: np.ndarray
    near: np.ndarray
    centre: Array


@dataclass(frozen=True, eq=False)
class DualProblem:
    """The hybrid problem: supported element, nodal forces, tethers of points, what spread loads may cost, and walls."""

    dual: DualMesh
    fem: SupportedFem
    force: Array
    tethers: Tethers
    point_load_cost: float
    walls: Walls | None = None


def traction_forces(dual: DualMesh, facets: np.ndarray, traction: Array) -> Array:
    """Nodal forces (n_nodes, d) of an even traction (d,) in N/mm on edges: half of each edge's force at each end."""
    force = np.zeros((dual.disc.n_nodes, len(traction)))
    half = 0.5 * dual.edge_lengths[facets][:, None] * traction
    np.add.at(force, 2 * facets, half)
    np.add.at(force, 2 * facets + 1, half)
    return force


def edges_at_corner(dual: DualMesh, corner: int) -> tuple[np.ndarray, np.ndarray]:
    """The edges that meet at a corner of the mesh and which of their ends it is."""
    near, facet = np.nonzero(dual.facets == corner)
    return facet, near


def dead_and_live(
    scene: Scene, dual: DualMesh, law: MembraneLaw, factor: float, shaped: Array | None
) -> tuple[Array, float]:
    """Nodal forces (n_nodes, d) and the most that spreading point loads over edges may change the potential, N mm.

    shaped: what wind on the present shape presses the cells with (n_cells, d), N/mm2.
    """
    disc, mesh = dual.disc, dual.mesh
    force = load_vector(disc, weight_per_area(scene, law.cell))
    for bar in scene.of(Bar):
        facets = mesh.edge(bar.edge, "[load.bar] edge")
        weight = bar.mass * np.array(scene.load.acceleration[: scene.d])
        force += traction_forces(dual, facets, weight / dual.edge_lengths[facets].sum())
    for wind in scene.of(Wind):
        force += 0.0 if wind.is_shaped else load_vector(disc, factor * wind_per_area(wind, scene, law.cell))
    if shaped is not None:
        force += load_vector(disc, np.tile(shaped, (3, 1)))
    for edge in scene.of(EdgeLoad):
        force += traction_forces(dual, mesh.edge(edge.edge, "[load.edge] edge"), factor * scene.vector(edge.force))
    cost = 0.0
    for point in scene.of(PointLoad):
        part, extra = _spread_point(dual, law, np.array(point.at), factor * scene.vector(point.force))
        force += part
        cost += extra
    for patch in scene.of(PatchLoad):  # as in P1: even within each triangle, by the area in the disk
        shares = disk_areas(mesh.mesh.p.T[mesh.mesh.t.T], np.array(patch.at), patch.radius)
        even = shares[:, None] / shares.sum() * (factor * scene.vector(patch.force))
        force[2 * dual.facets.shape[1] :] += even
    return force, cost


def _spread_point(dual: DualMesh, law: MembraneLaw, at: Array, load: Array) -> tuple[Array, float]:
    """A point load spread evenly over the edges at the nearest corner, and its cost: |f| times the mean distance."""
    corner = int(np.argmin(np.linalg.norm(dual.mesh.mesh.p.T - at, axis=1)))
    facets, _ = edges_at_corner(dual, corner)
    lengths = dual.edge_lengths[facets]
    stretch = largest_stretch(law, dual.edges[facets])
    moved = float((stretch * lengths**2).sum() / (2.0 * lengths.sum()))
    return traction_forces(dual, facets, load / lengths.sum()), float(np.linalg.norm(load)) * moved


def dual_problem(solution: CurtainSolution, factor: float, inward: float) -> DualProblem:
    """The hybrid problem that belongs to a P1 solution.

    Edges at held points are held where the curtain is, drawn the share `inward` towards its slack start.
    """
    problem = solution.problem
    scene, mesh, given = problem.scene, problem.mesh, problem.supports
    dual = dual_mesh(mesh)
    force, cost = dead_and_live(scene, dual, problem.law, factor, problem.wind)
    d = problem.fem.d
    mask = np.zeros((dual.disc.n_nodes, d), bool)
    positions = in_space_of(dual.disc.nodes, d)
    near_point = slackened(solution, inward)
    tethers = [(np.zeros(0, int), np.zeros(0, int), np.zeros((0, d)))]
    for held in given.held:
        if len(held.facets):
            continue
        for node, component, centre in zip(held.nodes, held.mask, held.positions, strict=True):
            facet, near = edges_at_corner(dual, int(node))
            for end in range(2):
                mask[2 * facet + end] |= component
                positions[2 * facet + end] = near_point[dual.facets[end, facet]]
            tethers.append((facet, near, np.tile(np.where(component, centre, np.nan), (len(facet), 1))))
    whole: np.ndarray = np.asarray(mask.all(axis=1))
    lines: list[tuple[np.ndarray, Array]] = []
    for held in given.held:
        if len(held.facets):
            _hold_edge(dual, held, mask, positions)
            nodes = np.concatenate([2 * held.facets, 2 * held.facets + 1])
            if held.slide is None:
                whole[nodes] = mask[nodes].all(axis=1)
            else:
                lines.append((nodes, held.slide))
    sliding = sliding_nodes(lines, whole, d)
    supports = Supports(given.held, mask, positions, sliding, Sliding.none(d), _bars(solution, dual))
    supports = pin_sliding(supports, dual.disc, force, scene.source)
    parts = Tethers(*(np.concatenate(part) for part in zip(*tethers, strict=True)))
    return DualProblem(dual, supports.fem(dual.disc), force, parts, cost, _walls(problem.walls, dual))


def _hold_edge(dual: DualMesh, held: Held, mask: np.ndarray, positions: Array) -> None:
    """Holds both ends of every facet of an edge support where the primal support holds the corners; in place."""
    number = np.full(dual.mesh.mesh.p.shape[1], -1)
    number[held.nodes] = np.arange(len(held.nodes))
    for end in range(2):
        which = number[dual.facets[end, held.facets]]
        node = 2 * held.facets + end
        positions[node] = np.where(held.mask[which], held.positions[which], positions[node])
        mask[node] |= held.mask[which]


def _walls(walls: Walls | None, dual: DualMesh) -> Walls | None:
    """The planes that the nodes of the primal problem stay inside of, for the mean of every triangle.

    Their pushes are even in every triangle. The law of the continuous curtain has them at all points, so that any such
    pushes give a lower bound.
    """
    if walls is None or not len(walls):
        return None
    planes = np.unique(np.column_stack([walls.normal, walls.offset]), axis=0)
    n_cells, first = dual.disc.n_cells, 2 * dual.facets.shape[1]
    middles = Points.of(np.tile(first + np.arange(n_cells), len(planes)))
    even = np.repeat(planes, n_cells, axis=0)
    return Walls(middles, even[:, :-1], even[:, -1], np.zeros(len(even), int))


def _bars(solution: CurtainSolution, dual: DualMesh) -> sparse.csc_matrix | None:
    """The straight bars' edges, kept on a line in the dual as they are in the primal problem."""
    lines = []
    X = dual.disc.nodes
    for bar in solution.problem.scene.of(Bar):
        if bar.straight:
            facets = dual.mesh.edge(bar.edge, "[load.bar] edge")
            nodes = np.concatenate([2 * facets, 2 * facets + 1])
            along = X[nodes] @ np.ptp(X[nodes], axis=0)
            lines.append(nodes[np.argsort(along, kind="stable")])
    return straight_ties(lines, X) if lines else None


def at_dual_nodes(x: Array, dual: DualMesh) -> Array:
    """Nodal positions x of P1 at the unknowns of the dual (n_nodes, d)."""
    corners = x[dual.facets]  # (2, n_facets, d)
    middle = x[dual.mesh.mesh.t].mean(axis=0)
    return np.concatenate([corners.transpose(1, 0, 2).reshape(-1, x.shape[1]), middle])
