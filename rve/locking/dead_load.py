"""Dead second Piola-Kirchhoff line loads: their force, and locked states under them from given starts.

A dead line load S has the potential S:E per unit of reference area; the derivative of its force is symmetric.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rve.common import Array, Index
from rve.common.tensor import trace
from rve.geometry.cell import Cell, weave_sides
from rve.geometry.contacts import parallel_clearance
from rve.geometry.kinematics import deformation_gradient, second_pk
from rve.geometry.pose import Pose, start_pose
from rve.locking.interior_point import DirectOptions, Equilibrium, solve_equilibrium, unit_loads
from rve.locking.limits import loose_motions, polish, shortest
from rve.locking.system import Equations, on_coordinates


@dataclass(frozen=True)
class RestartOptions:
    """Numbers of restarts and of random poses."""

    margins: tuple[float, ...] = (1e-4, 1e-6)
    """Gaps of a restart in r1, tried in turn. Wider ones converge faster, but may slide into a state of less work."""
    near_margin: float = 1e-3
    """Gaps of restarts from near loads: they need not climb from where they start."""
    tolerance: float = 1e-10
    mu_end: float = 1e-12
    """Residual and last complementarity of restarts: states on the verge of giving way converge linearly in the last
    digits, and round-off of merging contacts allows no smaller gaps."""
    walk: int = 20
    stride: float = 0.12
    """Steps of a random walk from the slack pose, and the largest of them in r1 and radians."""
    start_gap: float = 1e-3
    """Gaps in r1 that random poses keep."""
    unstable: float = -1e-6
    """Stiffness in s r1^2 below which a motion gives way."""
    wide: float = 1e-2
    """First complementarity beside a balance that gives way: rings go far from there."""
    push: float = 0.06
    """Largest displacement of a start along such a motion, in radii of the wire: no ring passes another."""


RESTART = RestartOptions()


@dataclass(frozen=True)
class DeadLoad:
    """The `Force` of dead loads S (n, 3), weave axes, on a reference cell with sides (b1, b2) in r1: the potential is
    b1 b2 S:E, so the force on a1 is b1 b2 (S11 a1/b1^2 + S12 a2/(b1 b2)).
    """

    sides: tuple[float, float]

    def __call__(self, pose: Pose, T: Array, s: Array) -> tuple[Array, Array]:
        b1, b2 = self.sides
        A = np.stack([s[:, 0] * b2 / b1, s[:, 1], s[:, 1], s[:, 2] * b1 / b2], axis=1).reshape(-1, 2, 2)
        return on_coordinates(np.asarray(np.kron(A, np.eye(2)), dtype=float), pose, T)


@dataclass(frozen=True)
class LoadedCell:
    """What does not change: cell, its equations under Cauchy and under dead loads, sides of the reference cell in r1,
    options.
    """

    cell: Cell
    cauchy: Equations
    dead: Equations
    sides: tuple[float, float]
    options: DirectOptions

    @staticmethod
    def of(cell: Cell, sides_mm: tuple[float, float], options: DirectOptions) -> LoadedCell:
        """A cell, of the weave that it names, on a reference cell with sides b_x, b_y in mm."""
        equations, sides = Equations.of(cell.weave, cell.wire), weave_sides(cell, sides_mm)
        return LoadedCell(cell, equations, replace(equations, load=DeadLoad(sides)), sides, options)

    def conjugate(self, E: Array, s: Array) -> Array:
        """S (n, 3) of unit trace of the Cauchy loads s on cells with the strains E, by the rotation rule."""
        S = second_pk(deformation_gradient(E), s)
        return np.asarray(S / trace(S)[:, None])


def solve_dead(S: Array, equations: Equations, options: DirectOptions, start: Pose | None = None) -> Equilibrium:
    """Locked states under the dead loads S (n, 3) from the slack pose of the weave, or from `start` (n poses with
    positive gaps); equations with a `DeadLoad`.

    The force of a dead load grows with the stretch, so mu falls slowly. Just inside rank one the weak second load moves
    the cell along a curved valley, which steps with second-order corrections follow: they are tried next.
    """
    first = _once(options, shrink=0.3, max_iterations=options.max_iterations + 50)
    found = beside_saddles(solve_equilibrium(S, equations, first, start), S, equations, options)
    left = np.flatnonzero(found.status != "converged")
    if len(left) and options.attempts > 1:
        slower = replace(_patient(options), attempts=2, max_iterations=2 * options.max_iterations)
        again = solve_equilibrium(S[left], equations, slower, None if start is None else start.take(left))
        found = found.put(left, replace(again, attempts=again.attempts + 1))
    return found


def _patient(options: DirectOptions) -> DirectOptions:
    """Options of loads that stall: mu falls slowly, and steps follow curved valleys."""
    return _once(options, shrink=0.5, corrections=2, tolerance=max(options.tolerance, RESTART.tolerance))


def _once(options: DirectOptions, **changed: Any) -> DirectOptions:
    """One attempt that ends where round-off of merging contacts begins."""
    return replace(options, attempts=1, power=1.0, mu_end=max(RESTART.mu_end, options.mu_end), **changed)


def open_gaps(pose: Pose, equations: Equations, margin: float) -> Pose:
    """The poses with all gaps raised to about `margin` (in r1) by the shortest motions that do so to first order. A
    pose that cannot be opened is left as it is.
    """
    for _ in range(6):
        contacts = equations.contacts(pose)
        tight = np.flatnonzero(contacts.min_gap < 0.5 * margin)
        if not len(tight):
            break
        none = np.zeros(contacts.gap.shape)
        G = equations.assemble(pose, contacts, none, np.ones((len(none), 3))).G
        dq = np.zeros((len(G), G.shape[2]))
        for i in tight:
            gap = contacts.gap[i].ravel()
            near = gap < 10.0 * margin
            way = shortest(G[i][near], margin - gap[near])
            dq[i] = 0.0 if way is None else np.clip(way, -0.1, 0.1)
        pose = equations.moved(pose, dq)
    return pose


def restart(loads: Array, equations: Equations, start: Pose, margin: float, options: DirectOptions) -> Equilibrium:
    """Locked states under `loads` (n, 3) from the locked poses `start`, whose gaps are first opened to `margin`."""
    least, most = max(options.tolerance, RESTART.tolerance), min(90, options.max_iterations)
    near = _once(options, mu_start=margin, shrink=0.3, max_iterations=most, tolerance=least)
    return solve_equilibrium(loads, equations, near, open_gaps(start, equations, margin))


def solve_stable(loads: Array, equations: Equations, options: DirectOptions) -> Equilibrium:
    """Locked states under line loads from the slack pose, or beside it where its path ends in one that gives way."""
    found = solve_equilibrium(loads, equations, replace(options, attempts=1))
    found = beside_saddles(found, loads, equations, options)
    left = np.flatnonzero(found.status != "converged")
    if len(left) and options.attempts > 1:
        again = solve_equilibrium(loads[left], equations, options, made=1)
        found = found.put(left, replace(again, iterations=again.iterations + found.iterations[left]))
    return found


def beside_saddles(found: Equilibrium, loads: Array, equations: Equations, options: DirectOptions) -> Equilibrium:
    """The equilibria, with those that have stalled at a balance which gives way, as of rings that may buckle to either
    side, replaced by the ones that a push leads to. The path to such a balance converges linearly at best."""
    left = np.flatnonzero(found.status == "stalled")
    if not len(left) or not options.max_iterations:
        return found
    s = unit_loads(loads) if equations.is_relative else loads
    near = polish(found.last.take(left), equations, s[left])
    rows, ways = ways_down(near, s[left], equations, 1)
    if not len(rows):
        return found
    start = open_gaps(equations.moved(near.pose.take(rows), ways), equations, RESTART.near_margin)
    slow = replace(_patient(options), mu_start=RESTART.wide, corrections=options.corrections)
    new = solve_equilibrium(s[left[rows]], equations, slow, start)
    good = np.flatnonzero(new.status == "converged")
    new = replace(new, iterations=new.iterations + found.iterations[left[rows]])
    return found.put(left[rows[good]], new.take(good))


def ways_down(found: Equilibrium, s: Array, equations: Equations, most: int) -> tuple[Index, Array]:
    """Rows (k,) of locked states that give way, and displacements (k, m) along their softest motions, up to `most`."""
    rows, ways = [np.zeros(0, dtype=int)], [np.zeros((0, equations.modes.shape[1]))]
    for i, stiffness, motions in loose_motions(equations, found, s):
        gives = motions.T[np.flatnonzero(stiffness < RESTART.unstable)[:most]]
        rows.append(np.full(len(gives), i))
        ways.append(RESTART.push * equations.thinnest * gives / np.abs(gives).max(axis=1, keepdims=True))
    return np.concatenate(rows), np.concatenate(ways)


def restart_patiently(
    loads: Array, equations: Equations, start: Pose, options: DirectOptions, margin: float = RESTART.margins[0]
) -> Equilibrium:
    """`restart`; loads that stall, as of rank one do, from gaps of 1e-6 and along curved valleys, and if these lead
    nowhere by Newton's method with the contacts that are closed."""
    found = beside_saddles(restart(loads, equations, start, margin, options), loads, equations, options)
    left = np.flatnonzero(found.status != "converged")
    if len(left) and options.max_iterations:
        slower = replace(_patient(options), mu_start=RESTART.margins[1], max_iterations=200)
        opened = open_gaps(start.take(left), equations, RESTART.margins[1])
        found = found.put(left, solve_equilibrium(loads[left], equations, slower, opened))
        left = left[found.status[left] != "converged"]
    if len(left):
        s = unit_loads(loads[left]) if equations.is_relative else loads[left]
        near = polish(start.take(left), equations, s)
        good = np.flatnonzero(near.status == "converged")
        found = found.put(left[good], near.take(good))
    return found


def random_poses(equations: Equations, count: int) -> Pose:
    """Admissible poses (count,) that random walks reach from the slack pose, the same in every call. Steps that would
    make rings overlap or pass through each other are left out.
    """
    rng, pose = np.random.default_rng(0), start_pose(equations.weave, count)
    shape, stride = (count, equations.modes.shape[1]), np.full((count, 1), RESTART.stride)
    drift = rng.uniform(-1.0, 1.0, shape)
    for _ in range(RESTART.walk):
        step = stride * (0.4 * drift + 0.6 * rng.uniform(-1.0, 1.0, shape))
        there = equations.moved(pose, step)
        contacts = equations.contacts(there)
        good = contacts.links_intact & (contacts.min_gap > RESTART.start_gap)
        good &= parallel_clearance(pose, there, equations.weave, equations.wire) > 0.0
        rows = np.flatnonzero(good)
        pose = pose.put(rows, there.take(rows))
        stride = np.where(good[:, None], np.minimum(1.5 * stride, RESTART.stride), 0.5 * stride)
        drift = np.where(good[:, None], drift, rng.uniform(-1.0, 1.0, shape))
    return pose
