"""A mesh of triangles and an element as arrays: nodes, cells, quadrature points, shape functions and areas.

The point p is the leading axis, p = q * n_cells + cell for quadrature point q. Nodal fields are (n_nodes, d). Other
points of cells are rows (m, n_nodes) of shares of the nodes: for nodes at x (n_nodes, d) they are at points @ x.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import skfem
from scipy import sparse

from rve.common import Array
from rve.common.records import Index

ELEMENTS: dict[str, tuple[Any, int]] = {"P1": (skfem.ElementTriP1, 0), "P2": (skfem.ElementTriP2, 2)}
"""Element and order of its quadrature, the fewest points that integrate the stiffness without spurious modes."""

MEETS = np.array([[0.0, 1.0, 0.0, 0.5, 0.5, 0.0, 1.0 / 3.0], [0.0, 0.0, 1.0, 0.0, 0.5, 0.5, 1.0 / 3.0]])
"""Corners, middles of sides and middle of the reference triangle, where a cell meets bodies."""
FINE = 4
"""Parts of a side of the points at which a cell is looked at between those."""
CONTROL = np.block(
    [[np.eye(3), np.zeros((3, 3))], [-0.5 * (np.eye(3) + np.roll(np.eye(3), 1, axis=1)), 2.0 * np.eye(3)]]
)
"""Control points of P2 (6, 6) as sums of its nodes: corners, then middles of sides."""


@dataclass(frozen=True, eq=False)
class Discretization:
    """A mesh and an element as arrays.

    nodes (n_nodes, 2): positions of the unknowns in the reference state, mm.
    cell_dofs (n_cells, n_local): node numbers of each cell.
    shape_values (n_quad, n_local) and shape_gradients (n_quad, 2, n_local): in the reference element.
    inverse_jacobian (2, 2, 1, n_cells): dX_J/dx_j, constant in each cell.
    weight (n_points,): quadrature weight times area, mm2.
    """

    element: str
    nodes: Array
    cell_dofs: Index
    shape_values: Array
    shape_gradients: Array
    inverse_jacobian: Array
    weight: Array

    @property
    def n_nodes(self) -> int:
        return int(self.nodes.shape[0])

    @property
    def n_cells(self) -> int:
        return int(self.cell_dofs.shape[0])

    @property
    def n_quad(self) -> int:
        """Quadrature points in a cell."""
        return int(self.shape_values.shape[0])

    @property
    def n_points(self) -> int:
        """Quadrature points of the whole mesh."""
        return self.n_quad * self.n_cells

    @cached_property
    def grad(self) -> Array:
        """The gradients of the shape functions at each point, (n_points, n_local, 2), 1/mm."""
        inverse = np.broadcast_to(self.inverse_jacobian, (2, 2, self.n_quad, self.n_cells))
        g = np.einsum("qJa,Jjqc->qcaj", self.shape_gradients, inverse)
        return np.asarray(g.reshape(self.n_points, -1, 2))

    @cached_property
    def points(self) -> Array:
        """Positions of the points in the reference state, (n_points, 2), mm."""
        local = self.nodes.T[:, self.cell_dofs.T]
        return np.asarray(np.matmul(self.shape_values, local).reshape(2, -1).T)

    @cached_property
    def cell_area(self) -> Array:
        """Reference area of each cell (n_cells,), mm2."""
        return np.asarray(self.weight.reshape(self.n_quad, self.n_cells).sum(axis=0))

    @cached_property
    def at_nodes(self) -> sparse.csr_matrix:
        """The nodes themselves."""
        return sparse.eye(self.n_nodes, format="csr")

    @cached_property
    def hull(self) -> sparse.csr_matrix:
        """Points whose convex hull holds all cells: nodes of P1, Bernstein coefficients of P2."""
        return self.at_nodes if self.element == "P1" else self._points_of(CONTROL)

    @cached_property
    def meeting(self) -> sparse.csr_matrix:
        """Where the mesh meets bodies: corners, middles of sides and middles of cells."""
        return self.points_at(MEETS)

    @cached_property
    def lattice(self) -> sparse.csr_matrix:
        """Points in all cells, FINE along a side."""
        return self.lattice_of(FINE)

    def lattice_of(self, fine: int) -> sparse.csr_matrix:
        """Points in all cells that cut every side into `fine` parts."""
        X = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, fine + 1)] * 2)).reshape(2, -1)
        return self.points_at(X[:, X.sum(axis=0) < 1.0 + 1e-9])

    def points_at(self, X: Array) -> sparse.csr_matrix:
        """The points of all cells at the places X (2, n) of the reference element, those that cells share once."""
        return self._points_of(reference_shapes(ELEMENTS[self.element][0](), X, self.cell_dofs.shape[1])[0])

    def _points_of(self, shape: Array) -> sparse.csr_matrix:
        """The points of all cells with weights `shape` (n, n_local) of a cell's nodes, those that cells share once."""
        share = np.repeat(np.where(np.abs(shape) > 1e-12, shape, 0.0), self.n_cells, axis=0)
        node = np.where(share != 0.0, np.tile(self.cell_dofs, (len(shape), 1)), -1)
        order = np.argsort(node, axis=1, kind="stable")
        node, share = np.take_along_axis(node, order, axis=1), np.take_along_axis(share, order, axis=1)
        key = np.concatenate([node, np.rint(1e6 * share).astype(np.int64)], axis=1)
        first = np.sort(np.unique(key, axis=0, return_index=True)[1])
        node, share = node[first][:, ::-1], share[first][:, ::-1]
        start = node.shape[1] * np.arange(len(first) + 1)
        points = sparse.csr_matrix((share.ravel(), np.maximum(node, 0).ravel(), start), (len(first), self.n_nodes))
        points.eliminate_zeros()
        return points

    def cell_mean(self, values: Array) -> Array:
        """The area mean in each cell (n_cells, ...) of values at the points (n_points, ...)."""
        w = self.weight.reshape(self.n_quad, self.n_cells)
        stacked = values.reshape(self.n_quad, self.n_cells, -1)
        mean = np.einsum("qc,qcx->cx", w / self.cell_area, stacked)
        return np.asarray(mean.reshape((self.n_cells, *values.shape[1:])))


def reference_shapes(element: Any, X: Array, n_local: int) -> tuple[Array, Array]:
    """Shape functions (n, n_local) of a scikit-fem element and their gradients (n, 2, n_local) at places X (2, n)."""
    local = [element.lbasis(X, a) for a in range(n_local)]
    values = np.stack([value * np.ones(X.shape[1]) for value, _ in local], axis=-1)
    gradients = np.stack([np.asarray(gradient) * np.ones_like(X) for _, gradient in local], axis=-1)
    return values, gradients.transpose(1, 0, 2).copy()


def discretize(mesh: Any, element: str) -> Discretization:
    """The arrays of a scikit-fem mesh of triangles (`MeshTri`) with an element of `ELEMENTS`, which names the degree
    that is integrated exactly."""
    element_type, degree = ELEMENTS[element]
    # scikit-fem starts at three points on a triangle; a constant gradient needs one.
    rule = (np.full((2, 1), 1 / 3), np.array([0.5])) if degree <= 1 else None
    basis = skfem.CellBasis(mesh, element_type(), intorder=degree, quadrature=rule)
    shape_values, shape_gradients = reference_shapes(element_type(), basis.X, basis.element_dofs.shape[0])
    # A transposed copy, because the cell is the fast axis of every product below.
    inverse = np.ascontiguousarray(np.moveaxis(basis.mapping.invDF(basis.X), -1, 2)[:, :, :1])
    weight = np.ascontiguousarray(basis.dx.T).ravel()
    return Discretization(
        element=element,
        nodes=np.ascontiguousarray(basis.doflocs.T),
        cell_dofs=np.ascontiguousarray(basis.element_dofs.T.astype(np.int64)),
        shape_values=shape_values,
        shape_gradients=shape_gradients,
        inverse_jacobian=inverse,
        weight=weight,
    )
