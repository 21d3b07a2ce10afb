"""Cholesky factors of block matrices of pairs of rings: nested dissection by place, one dense front per part.

Rings are halved along their longest side again and again. Rings of one half that have a partner in the other one
separate both and are eliminated after them. A front holds the rings that it eliminates and those that they lead to; all
its work is that of dense matrices, so that the time is that of LAPACK (Liu, SIAM Review 34 (1992), 82-109).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dsyrk, dtrsm, dtrsv
from scipy.linalg.lapack import dpotrf

from rve.common.types import Array

Index = NDArray[np.intp]
Solve = Callable[[Array], Array]

BLOCK = 5
_LEAF = 24
"""Rings of the smallest parts; fewer make more fronts, more make larger ones."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """A symmetric matrix of n x n blocks of 5 x 5: own (n, 5, 5) on the diagonal, and off (p, 5, 5) in row a and column
    b of each pair, its transpose in row b and column a."""

    a: Index
    b: Index
    own: Array
    off: Array


@dataclass(frozen=True, eq=False)
class Front:
    """What a front holds: its own rings `first` to `last` in the order of elimination, the later ones that they lead
    to, rows (k,); the pairs that enter it and their places in it, transposed or not; children and the places (k,) of
    their rows in it."""

    first: int
    last: int
    rows: Index
    pairs: Index
    at: tuple[Index, Index]
    turned: NDArray[np.bool_]
    children: tuple[tuple[int, Index], ...]


@dataclass(frozen=True, eq=False)
class Plan:
    """The order of elimination of the rings (n,), and the fronts, children before parents."""

    order: Index
    fronts: tuple[Front, ...]


def dissected(points: Array, a: Index, b: Index) -> list[tuple[Index, tuple[int, ...]]]:
    """Parts of the rings at points (n, d) with pairs a, b: the rings of each, and the parts that it separates."""
    parts: list[tuple[Index, tuple[int, ...]]] = []
    side = np.zeros(len(points), dtype=np.int8)

    def divide(rings: Index, a: Index, b: Index) -> int:
        below: tuple[int, ...] = ()
        if len(rings) > _LEAF:
            x = points[rings]
            x = x[:, np.ptp(x, axis=0).argmax()]
            left = x < np.median(x)
            side[rings] = np.where(left, 1, 2)
            between = np.unique(np.where(side[a] == 1, a, b)[side[a] != side[b]])
            side[between] = 0
            halves = [(rings[side[rings] == half], (side[a] == half) & (side[b] == half)) for half in (1, 2)]
            if all(len(half) for half, _ in halves):
                below = tuple([divide(half, a[mine], b[mine]) for half, mine in halves])
                rings = between
        parts.append((rings, below))
        return len(parts) - 1

    divide(np.arange(len(points)), a, b)
    return parts


def plan(points: Array, a: Index, b: Index) -> Plan:
    """The order of elimination for pairs a, b (p,), and what each front holds."""
    parts = dissected(points, a, b)
    order = np.concatenate([rings for rings, _ in parts])
    rank = np.empty(len(order), dtype=np.intp)
    rank[order] = np.arange(len(order))
    ends = np.cumsum([len(rings) for rings, _ in parts])
    early, late = np.minimum(rank[a], rank[b]), np.maximum(rank[a], rank[b])
    sort = np.argsort(early, kind="stable")
    cuts = np.searchsorted(early[sort], np.concatenate([[0], ends]))
    fronts: list[Front] = []
    for k, (rings, below) in enumerate(parts):
        last = int(ends[k])
        first = last - len(rings)
        pairs = sort[cuts[k] : cuts[k + 1]]
        led = np.concatenate([late[pairs], *(fronts[child].rows for child in below)])
        rows = np.unique(led[led >= last])

        def place(at: Index, first: int = first, last: int = last, rows: Index = rows) -> Index:
            return np.where(at < last, at - first, last - first + np.searchsorted(rows, at))

        children = tuple((child, place(fronts[child].rows)) for child in below)
        at = place(late[pairs]), early[pairs] - first
        fronts.append(Front(first, last, rows, pairs, at, rank[a[pairs]] < rank[b[pairs]], children))
    return Plan(order, tuple(fronts))


def factored(plan: Plan, blocks: Blocks) -> Solve | None:
    """A function that solves with the matrix, or None where it is not positive definite."""
    rests: dict[int, Array] = {}
    factors: list[tuple[Array, Array]] = []
    for k, front in enumerate(plan.fronts):
        F = _assembled(plan, blocks, front, rests)
        own = BLOCK * (front.last - front.first)
        top, info = dpotrf(F[:own, :own], lower=1)
        if info != 0:
            return None
        low = dtrsm(1.0, top, F[own:, :own], side=1, lower=1, trans_a=1)
        if len(front.rows):
            rests[k] = dsyrk(-1.0, low, beta=1.0, c=F[own:, own:], lower=1)
        factors.append((top, low))
    return lambda v: _solved(plan, factors, v)


def _assembled(plan: Plan, blocks: Blocks, front: Front, rests: dict[int, Array]) -> Array:
    """The lower half of a front: blocks of its pairs, and what its children leave."""
    count, five = front.last - front.first, np.arange(BLOCK)
    size = count + len(front.rows)
    F = np.zeros((BLOCK * size, BLOCK * size), order="F")
    by_block = F.T.reshape(size, BLOCK, size, BLOCK)  # column, its number, row, its number
    own = np.arange(count)
    by_block[own, :, own, :] = blocks.own[plan.order[front.first : front.last]]
    off = blocks.off[front.pairs]
    row, column = front.at
    by_block[column, :, row, :] = np.where(front.turned[:, None, None], off, off.transpose(0, 2, 1))
    for child, place in front.children:
        if len(place):
            at = (BLOCK * place[:, None] + five).ravel()
            F.T[at[:, None], at] += rests.pop(child).T
    return F


def _solved(plan: Plan, factors: list[tuple[Array, Array]], v: Array) -> Array:
    x = v.reshape(-1, BLOCK)[plan.order]
    for front, (top, low) in zip(plan.fronts, factors, strict=True):
        y = dtrsv(top, x[front.first : front.last].ravel(), lower=1)
        x[front.first : front.last] = y.reshape(-1, BLOCK)
        if len(front.rows):
            x[front.rows] -= (low @ y).reshape(-1, BLOCK)
    for front, (top, low) in zip(reversed(plan.fronts), reversed(factors), strict=True):
        y = x[front.first : front.last].ravel()
        if len(front.rows):
            y = y - x[front.rows].ravel() @ low
        x[front.first : front.last] = dtrsv(top, y, lower=1, trans=1).reshape(-1, BLOCK)
    out = np.empty_like(x)
    out[plan.order] = x
    return np.asarray(out.ravel())
