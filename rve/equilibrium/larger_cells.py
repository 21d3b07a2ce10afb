"""Larger cells, with centres in the plane or in space: where they do more work than the planar primitive cell.

A locked state of the primitive cell is one of every larger cell, but need not be a maximum of the work there: rings of
neighbouring cells may move against each other, up and down. Starts for better states are the motions that keep every
loaded contact closed and on which the second derivative of the potential is negative, and a small disturbance of all
rings at random, which finds states beyond a barrier.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from rve.common.tensor import double_dot
from rve.common.types import Array
from rve.equilibrium.dead_load import NEAR_MARGIN, restart
from rve.equilibrium.interior_point import DirectOptions, Equilibrium, unit_loads
from rve.equilibrium.largest_work import GAIN, KnownStates, Largest, climbed
from rve.equilibrium.limits import contact_forces, loose_motions, touching
from rve.equilibrium.system import Equations
from rve.geometry.pose import Pose, moved, strain_of, tiled

TOUCHING = 1e-6
"""Gap in r1 of contacts that may carry force in a locked state."""
UNSTABLE = -1e-6
"""Stiffness in s r1^2 below which a motion gives way; round-off leaves 1e-8."""
MODES = 3
"""Motions of a state that are followed, those of least stiffness."""
PUSH, DISTURBED = 0.06, 0.2
"""Largest displacement of a start along a motion, and of one at random, in radii of the wire: none passes another."""


def in_cell(found: Equilibrium, s: Array, equations: Equations, reach: float) -> Equilibrium:
    """Locked states of the planar primitive cell under the loads s (n, 3), in the larger cell of `equations`."""
    made = balanced(tiled(found.pose, equations.weave), s, equations, reach)
    R = np.where(found.status == "converged", made.R, found.R)
    return replace(found, pose=made.pose, contacts=made.contacts, lam=made.lam, R=R)


def balanced(pose: Pose, s: Array, equations: Equations, reach: float) -> Equilibrium:
    """Locked poses as equilibria under the loads s (n, 3), with nonnegative forces that balance every ring in space.

    The solver leaves the balance across the plane open where centres stay in it.
    """
    contacts = equations.contacts(pose, reach)
    lam = np.zeros(contacts.gap.shape)
    bare = equations.assemble(pose, contacts, lam, s)
    lam = contact_forces(bare, touching(contacts, TOUCHING).reshape(len(s), -1)).reshape(lam.shape)
    R = equations.assemble(pose, contacts, lam, s).weighted_residual
    none = np.zeros(len(s), dtype=int)
    return Equilibrium(pose, lam, contacts, R, none, np.full(len(s), "converged", dtype="<U16"), none)


def unstable_motions(found: Equilibrium, s: Array, equations: Equations) -> Iterator[tuple[int, Array]]:
    """For every locked state of these equations that gives way: its number, and the motions (k, m) that do."""
    for i, stiffness, motions in loose_motions(equations, found, s):
        gives = np.flatnonzero(stiffness < UNSTABLE)[:MODES]
        if len(gives):
            yield i, motions[:, gives].T


def states_beyond(
    found: Equilibrium, S: Array, equations: Equations, sides: tuple[float, float], options: DirectOptions
) -> KnownStates:
    """States that do more work under the dead loads S (n, 3) of unit trace than these locked ones of a larger cell."""
    rows, ways = [np.arange(len(S))], [DISTURBED * equations.wire * random_motions(equations, len(S))]
    for i, motions in unstable_motions(found, unit_loads(S), equations):
        rows.append(np.full(len(motions), i))
        ways.append(PUSH * equations.wire * motions / np.abs(motions).max(axis=1, keepdims=True))
    row, way = np.concatenate(rows), np.concatenate(ways)
    here = found.pose.take(row)
    new = restart(S[row], equations, moved(here, equations.displacement(way, here)), NEAR_MARGIN, options)
    E = strain_of(new.pose, sides)
    more = double_dot(S[row], E - strain_of(here, sides)) > GAIN
    keep = np.flatnonzero(more & (new.status == "converged"))
    return KnownStates(new.pose.take(keep), S[row[keep]], E[keep])


def random_motions(equations: Equations, count: int) -> Array:
    """Motions (count, m) of the rings alone, of size up to 1, the same in every call."""
    ways = np.random.default_rng(0).uniform(-1.0, 1.0, (count, equations.modes.shape[1]))
    ways[:, :3] = 0.0
    return ways


def largest_beyond(
    planar: Largest, known: KnownStates | None, equations: Equations, sides: tuple[float, float], options: DirectOptions
) -> Largest:
    """The largest work in the larger cell of `equations` that is reached from the states of the primitive cell."""
    best = replace(planar, found=in_cell(planar.found, unit_loads(planar.S), equations, options.reach))
    states = best.states(sides) if known is None else best.states(sides).plus(known)
    ended = np.flatnonzero(np.isfinite(best.h))
    beyond = states_beyond(best.found.take(ended), best.S[ended], equations, sides, options)
    return climbed(best, states.plus(beyond), equations, sides, options)
