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
coefficients: node 2 f + k belongs to end k (corner `facets[k, f]`) of edge f, node 2 n_facets + c to triangle c. In
space P is 3 x 2 and all of this holds component by component. Walls push evenly in every triangle.
"""

from dataclasses import dataclass, replace

import numpy as np

from macro_fem.curtain import CurtainProblem
from macro_fem.fem.assembly import load_vector
from macro_fem.fem.discretization import Discretization, discretize
from macro_fem.fem.hung_law import largest_stretch
from macro_fem.fem.supported import SupportedFem
from macro_fem.scene.loads import nodal_forces
from macro_fem.scene.meshing.mesh import CurtainMesh, facet_nodes
from macro_fem.scene.supports import Sliding, Supports, pin_sliding, sliding_nodes, straight_bars
from macro_fem.scene.tables import PointLoad, Wind
from macro_fem.solvers.walls import Walls
from rve.common import Array
from rve.geometry import padded


def at_dual_nodes(x: Array, mesh: CurtainMesh) -> Array:
    """Nodal positions x (n, d) of P1 at the nodes of the hybrid element."""
    ends, middle = x[mesh.mesh.facets.T], x[mesh.mesh.t].mean(axis=0)
    return np.concatenate([ends.reshape(-1, x.shape[1]), middle])


def dual_disc(mesh: CurtainMesh) -> Discretization:
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
    return replace(
        flat,
        element="equilibrium",
        nodes=at_dual_nodes(sk.p.T, mesh),
        cell_dofs=dofs,
        shape_values=np.tile(np.array([0.0] * 6 + [1.0]), (3, 1)),
        shape_gradients=_reference_gradients(flat.shape_gradients[0]),
        weight=np.tile(flat.weight / 3.0, 3),
    )


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
class DualProblem:
    """The hybrid problem: mesh, supported element, nodal forces, what spread loads may cost at every edge (n_facets,),
    N mm, and walls.

    Edges `facet` (k,) bear the reactions of single held points, which are at their ends `near` (k,) and held at
    `centre` (k, d), nan in components that are not.
    """

    mesh: CurtainMesh
    fem: SupportedFem
    force: Array
    load_cost: Array
    facet: np.ndarray
    near: np.ndarray
    centre: Array
    walls: Walls


def dual_problem(problem: CurtainProblem, near_slack: Array) -> DualProblem:
    """The hybrid problem that belongs to one in P1; edges at single held points are held at `near_slack`
    (n_nodes, d), positions of its nodes.
    """
    d = problem.fem.d
    scene, given, mesh = problem.scene, problem.supports, problem.mesh
    disc, facets = dual_disc(mesh), mesh.mesh.facets
    force, cost = dead_and_live(problem, disc)
    mask, positions = np.zeros(near_slack.shape, bool), padded(disc.nodes, d)

    single = [held for held in given.held if not len(held.facets)]
    corner = np.concatenate([np.zeros(0, int), *(held.nodes for held in single)])
    which, near, facet = np.nonzero(facets == corner[:, None, None])
    component = np.concatenate([np.zeros((0, d), bool), *(held.mask for held in single)])[which]
    centre = np.concatenate([np.zeros((0, d)), *(held.positions for held in single)])[which]
    nodes = facet_nodes(mesh, disc, facet).ravel()
    np.logical_or.at(mask, nodes, np.tile(component, (2, 1)))
    positions[nodes] = near_slack[nodes]

    whole, lines = np.asarray(mask.all(axis=1)), list[tuple[np.ndarray, Array]]()
    number = np.zeros(mesh.mesh.p.shape[1], int)
    for held in given.held:
        nodes = facet_nodes(mesh, disc, held.facets).ravel()
        number[held.nodes] = np.arange(len(held.nodes))
        which = number[facets[:, held.facets].ravel()]
        positions[nodes] = np.where(held.mask[which], held.positions[which], positions[nodes])
        mask[nodes] |= held.mask[which]
        if held.slide is None:
            whole[nodes] = mask[nodes].all(axis=1)
        elif len(nodes):
            lines.append((nodes, held.slide))
    sliding, no_pins = sliding_nodes(lines, whole, d), Sliding.none(d)
    supports = Supports(given.held, mask, positions, sliding, no_pins, straight_bars(scene, mesh, disc, mask))
    fem = pin_sliding(supports, disc, force, scene).fem(disc)
    centre = np.where(component, centre, np.nan)
    return DualProblem(mesh, fem, force, cost, facet, near, centre, _walls(problem.walls, disc))


def dead_and_live(problem: CurtainProblem, disc: Discretization) -> tuple[Array, Array]:
    """Nodal forces (n_nodes, d), and the most that point loads spread over edges (n_facets,) may change the potential
    there, N mm."""
    scene, mesh, factor = problem.scene, problem.mesh, problem.factor
    others = tuple(
        one for one in scene.items if not (isinstance(one, PointLoad) or (isinstance(one, Wind) and one.is_shaped))
    )
    force = nodal_forces(replace(scene, items=others), mesh, disc, problem.law.cell, factor)
    if problem.wind is not None:
        force += load_vector(disc, np.tile(problem.disc.cell_mean(problem.wind), (3, 1)))
    cost = np.zeros(mesh.mesh.facets.shape[1])
    for point in scene.of(PointLoad):  # even over the edges at the nearest corner; costs |f| times the mean distance
        load, corners = factor * scene.vector(point.force), mesh.mesh.p.T
        facets = np.nonzero(mesh.mesh.facets == np.linalg.norm(corners - point.at, axis=1).argmin())[1]
        edges = mesh.sides[facets]
        lengths = np.hypot(*edges.T)
        force[facet_nodes(mesh, disc, facets)] += (0.5 * lengths / lengths.sum())[:, None] * load
        cost[facets] += (
            np.linalg.norm(load) * largest_stretch(problem.last_law, edges) * lengths**2 / (2.0 * lengths.sum())
        )
    return force, cost


def _walls(walls: Walls, disc: Discretization) -> Walls:
    """The planes that the nodes of the primal problem stay inside of, for the mean of every triangle.

    The law of the continuous curtain has them at all points, so that any pushes, even in every triangle, give a bound.
    """
    planes, n_cells = np.unique(np.column_stack([walls.normal, walls.offset]), axis=0), disc.n_cells
    middles = disc.at_nodes[np.tile(np.arange(disc.n_nodes - n_cells, disc.n_nodes), len(planes))]
    even = np.repeat(planes, n_cells, axis=0)
    return Walls(middles, even[:, :-1], even[:, -1], np.zeros(len(even), int))
