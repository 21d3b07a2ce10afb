"""Algebra of many second-order cones at once.

A vector v = (v0, v1) of each cone is kept as head (n,) and tail (n, m); it lies in the cone if v0 >= |v1|. The Jordan
product is v o u = (v0 u0 + v1.u1, v0 u1 + u0 v1) with the unit e = (1, 0). Nesterov and Todd's scaling W of a primal
vector s and a dual vector y maps both to one point: W y = W^-1 s. Formulas: L. Vandenberghe, "The CVXOPT linear and
quadratic cone program solvers" (2010), section 5; Y. Nesterov, M. Todd, doi 10.1137/S1052623495290209.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rve.common import Array


@dataclass(frozen=True)
class Vectors:
    """Vectors of n cones: head (n,) and tail (n, m)."""

    head: Array
    tail: Array

    def __add__(self, other: Vectors) -> Vectors:
        return Vectors(self.head + other.head, self.tail + other.tail)

    def __sub__(self, other: Vectors) -> Vectors:
        return Vectors(self.head - other.head, self.tail - other.tail)

    def __mul__(self, factor: float) -> Vectors:
        return Vectors(factor * self.head, factor * self.tail)

    def dot(self, other: Vectors) -> Array:
        """Inner products (n,)."""
        return self.head * other.head + row_dot(self.tail, other.tail)

    def margin(self) -> Array:
        """v0 - |v1| (n,): positive inside."""
        return self.head - np.sqrt(row_dot(self.tail, self.tail))

    def determinant(self) -> Array:
        """v0^2 - |v1|^2 (n,), as a product that keeps its sign near the boundary."""
        size = np.sqrt(row_dot(self.tail, self.tail))
        return (self.head - size) * (self.head + size)

    def lifted(self, least: Array) -> Vectors:
        """The vectors with heads raised where they are less than `least` (n,) inside their cones."""
        return Vectors(np.maximum(self.head, np.sqrt(row_dot(self.tail, self.tail)) + least), self.tail)


def row_dot(a: Array, b: Array) -> Array:
    """Sums over the last axis of products (n,)."""
    return np.asarray(np.einsum("nm,nm->n", a, b))


def product(a: Vectors, b: Vectors) -> Vectors:
    """a o b."""
    return Vectors(a.dot(b), a.head[:, None] * b.tail + b.head[:, None] * a.tail)


def divide(a: Vectors, d: Vectors) -> Vectors:
    """The x with a o x = d, for a inside its cone."""
    head = (a.head * d.head - row_dot(a.tail, d.tail)) / a.determinant()
    return Vectors(head, (d.tail - head[:, None] * a.tail) / a.head[:, None])


def inverse(a: Vectors, mu: float) -> Vectors:
    """mu a^-1, the vector on the central path of a: a o x = mu e."""
    scale = mu / a.determinant()
    return Vectors(scale * a.head, -scale[:, None] * a.tail)


@dataclass(frozen=True)
class Scaling:
    """Nesterov and Todd's W = eta (2 v v^T - J)^(1/2) of each cone: eta (n,), point w on the unit hyperboloid."""

    eta: Array
    w: Vectors

    def apply(self, v: Vectors) -> Vectors:
        """W v."""
        return self._turn(v, 1.0, self.eta)

    def undo(self, v: Vectors) -> Vectors:
        """W^-1 v."""
        return self._turn(v, -1.0, 1.0 / self.eta)

    def undo_twice(self, v: Vectors) -> Vectors:
        """W^-2 v."""
        along, inv2 = 2.0 * (row_dot(self.w.tail, v.tail) - self.w.head * v.head), 1.0 / self.eta**2
        head = -(along * self.w.head + v.head) * inv2
        return Vectors(head, (along[:, None] * self.w.tail + v.tail) * inv2[:, None])

    def _turn(self, v: Vectors, sign: float, scale: Array) -> Vectors:
        w0, w1 = self.w.head, self.w.tail
        along = row_dot(w1, v.tail)
        head = scale * (w0 * v.head + sign * along)
        tail = scale[:, None] * ((sign * v.head + along / (1.0 + w0))[:, None] * w1 + v.tail)
        return Vectors(head, tail)


def scaling(s: Vectors, y: Vectors) -> Scaling:
    """The scaling with W y = W^-1 s for s and y inside their cones."""
    det_s, det_y = s.determinant(), y.determinant()
    s_unit = Vectors(s.head / np.sqrt(det_s), s.tail / np.sqrt(det_s)[:, None])
    y_unit = Vectors(y.head / np.sqrt(det_y), y.tail / np.sqrt(det_y)[:, None])
    twice = 2.0 * np.sqrt(0.5 * (1.0 + s_unit.dot(y_unit)))
    tail = (s_unit.tail - y_unit.tail) / twice[:, None]
    # the head from the tail, so that w0^2 - |w1|^2 = 1 holds to rounding
    return Scaling((det_s / det_y) ** 0.25, Vectors(np.sqrt(1.0 + row_dot(tail, tail)), tail))


def largest_step(v: Vectors, dv: Vectors) -> float:
    """The largest t such that v + t dv is in every cone, for v inside; infinite if it never leaves."""
    a = dv.head**2 - row_dot(dv.tail, dv.tail)
    b = v.head * dv.head - row_dot(v.tail, dv.tail)
    c = v.determinant()
    root = np.maximum(b * b - a * c, 0.0)  # never negative for v inside; 0 and its rounding where dv is along v
    leaves = (a < 0.0) | (b < 0.0)
    if not leaves.any():
        return np.inf
    # the least positive root of c + 2 b t + a t^2, in the form that does not cancel for b < 0
    with np.errstate(divide="ignore"):
        return float((c[leaves] / np.maximum(np.sqrt(root[leaves]) - b[leaves], 0.0)).min())
