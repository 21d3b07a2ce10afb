"""The rigid curtain as other solvers of cone programs take it, with flat deformation gradients as a matrix of unknowns.

    minimise -l.z   subject to   b - A x in second-order cones,   x = z / size:   (c_i, F_q(z) L_i),   S_i = L_i L_i^T

A cone has 1 + d rank S_i components, c_i^2 = 2 h_i + tr S_i.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from macro_fem.fem import SupportedFem
from macro_fem.solvers import Cones
from rve.common import Array

FLAT = 1e-12
"""Eigenvalues of S below this (S has unit trace) count as zero: the half-space of a single direction."""


@dataclass(frozen=True, eq=False)
class ConeForm:
    """A and b of these half-spaces in a curtain of extent `size`; B: free unknowns to flat gradients."""

    fem: SupportedFem
    cones: Cones
    size: float
    B: sparse.csr_matrix

    @cached_property
    def dimension(self) -> np.ndarray:
        """Components of each cone (nc,)."""
        return 1 + self.fem.d * self._roots[1]

    @cached_property
    def start(self) -> np.ndarray:
        """Where each cone begins, and where the last one ends (nc + 1,)."""
        return np.concatenate([[0], np.cumsum(self.dimension)])

    @cached_property
    def c(self) -> Array:
        """First component of each cone (nc,)."""
        return np.sqrt(2.0 * self.cones.size)

    @cached_property
    def M(self) -> sparse.csr_matrix:
        """Flat gradients to the other components of all cones."""
        (L, rank), d, point = self._roots, self.fem.d, self.cones.point
        rows, columns, values = [], [], []
        for k in range(2):
            use = np.flatnonzero(rank > k)
            for a in range(d):
                for j in range(2):
                    rows.append(self.start[use] + 1 + k * d + a)
                    columns.append((point[use] * d + a) * 2 + j)
                    values.append(L[use, j, k])
        shape = (int(self.start[-1]), self.B.shape[0])
        return sparse.csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape)

    @cached_property
    def A(self) -> sparse.csc_matrix:
        """What x takes from b."""
        return sparse.csc_matrix(-self.size * (self.M @ self.B))

    @cached_property
    def b(self) -> Array:
        """Cone vectors at x = 0."""
        b = np.asarray(self.M @ self.fem.gradient(np.zeros(self.fem.n)).ravel())
        b[self.start[:-1]] = self.c
        return b

    @cached_property
    def _roots(self) -> tuple[Array, np.ndarray]:
        """L (nc, 2, 2) with L L^T = S, larger column first, and the ranks (nc,) 1 or 2."""
        S = self.cones.S
        values, vectors = np.linalg.eigh(np.stack([S[:, [0, 1]], S[:, [1, 2]]], axis=1))
        values = values[:, ::-1]
        return vectors[:, :, ::-1] * np.sqrt(np.maximum(values, 0.0))[:, None, :], 1 + (values[:, 1] > FLAT)


def gradient_matrix(fem: SupportedFem) -> sparse.csr_matrix:
    """B (nq d 2, n): free unknowns to flat deformation gradients."""
    disc, d = fem.disc, fem.d
    n_points, dofs = disc.n_points, np.tile(disc.cell_dofs, (disc.n_quad, 1))
    point = np.repeat(np.arange(n_points), dofs.shape[1])
    scalar = [
        sparse.csr_matrix((disc.grad[:, :, j].ravel(), (point, dofs.ravel())), shape=(n_points, disc.n_nodes))
        for j in range(2)
    ]
    rows, columns, values = [], [], []
    for a in range(d):
        for j in range(2):
            entry = scalar[j].tocoo()
            rows.append((entry.row * d + a) * 2 + j)
            columns.append(entry.col * d + a)
            values.append(entry.data)
    shape = (n_points * d * 2, disc.n_nodes * d)
    full = sparse.csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape)
    return (full @ fem.T).tocsr()


def by_clarabel(form: ConeForm, q: Array, gap: float) -> tuple[Array, str]:
    """Unknowns over the size, and how it ended."""
    import clarabel

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = gap
    kinds = [clarabel.SecondOrderConeT(int(n)) for n in form.dimension]
    n = len(q)
    answer = clarabel.DefaultSolver(sparse.csc_matrix((n, n)), q, form.A, form.b, kinds, settings).solve()
    return np.array(answer.x), f"{answer.status}, {answer.iterations} steps"


def by_qoco(form: ConeForm, q: Array, gap: float) -> tuple[Array, str]:
    """Unknowns over the size, and how it ended."""
    import qoco

    solver, (m, n) = qoco.QOCO(), form.A.shape
    sizes = form.dimension
    solver.setup(n, m, 0, None, q, None, None, form.A, form.b, 0, len(sizes), sizes, abstol=gap, reltol=gap)
    answer = solver.solve()
    return np.array(answer.x), f"{answer.status.removeprefix('QOCO_').lower()}, {answer.iters} steps"
