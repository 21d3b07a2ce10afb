"""Rings in motion: options, masses, damping and friction, energies, and the residual of the paper's eq. (9)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from msgspec import Meta

from rve.common import Array, Index, Typed
from rve.common.cell_fields import gyration_radius
from rve.geometry.cell import Cell
from rve.geometry.contacts import CellContacts, slip_gradient
from rve.geometry.pose import Pose, place_maps, reduction, turns_of
from rve.geometry.weave import Weave
from rve.locking.system import Equations

Positive = Annotated[float, Meta(gt=0.0, le=1e15)]
"""Products of two stay finite."""


@dataclass(frozen=True)
class SimulationOptions(Typed):
    """Parameters of the paper's section 3.1, in kg, s and N/m, and friction; InputError for senseless values.

    Two are calibrated, see docs/explanation/paper_scheme.md: `rotational_damping` (the paper prints 0.1 kgm/s) and
    `load` (the paper states none).

    damping: of each ring in kg/s, of several sizes in proportion to their masses; rotational_damping: in damping times
    the square of the ring's radius, so that rings of every size tilt as fast as they move; 4 is 100 kg mm2/s for
    r1 = 5 mm. stiffness of one contact in N/m = kg/s2: rings sink into each other
    by load over stiffness, in r1. load: line load s_hat of the size 1, N/m; only the clock depends on it.
    friction: Coulomb's coefficient; directions: sides of the polygon that stands for the circle of friction forces,
    which is too small by up to 1 - cos(180 deg/directions), 2 % for 16.
    h_max, h_min: largest time step and the one at which the solver gives up, s.
    tolerance: R of eq. (9) at which a case has converged; max_steps: accepted steps per case and load.
    restore: growth of the step after an accepted one; reach: contacts with a larger gap in r1 are ignored.
    largest_move: of a ring per step, in r1 and rad, so that rings do not pass through each other.
    curvature: the step includes the curvature of its contacts (`geometric_stiffness`).
    Without it, as eq. (6) is printed, some cases chatter between merging minima and end with the status "time-step".

    >>> SimulationOptions(friction=0.2).directions
    16
    """

    damping: Positive = 1.0
    rotational_damping: Positive = 4.0
    stiffness: Positive = 1e6
    load: Positive = 2.5
    friction: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.0
    directions: Annotated[int, Meta(ge=4, le=64)] = 16
    h_max: Positive = 1.0
    h_min: Positive = 1e-9
    tolerance: Positive = 1e-9
    max_steps: Annotated[int, Meta(ge=1, le=1_000_000_000)] = 20000
    restore: Annotated[float, Meta(ge=1.0, le=1e15)] = 2.0
    reach: Positive = 0.2
    largest_move: Positive = 0.4
    curvature: bool = True


@dataclass(frozen=True)
class Dynamics:
    """The motion in scaled units: length r1, line load s_hat, hence energy s_hat r1^2; time in seconds.

    mass (m_full, m_full) in s2 and drag (m_full, m_full) in s: of the velocities v (n, m_full) = T u, on which friction
    acts through the spin of rings as well; ring_mass in s2, of a mean ring; stiffness (p,) of each pair of rings;
    ring_maps (rings, 2 or 3, m_full): from v to the velocities of centres.
    """

    equations: Equations
    options: SimulationOptions
    mass: Array
    inverse_mass: Array
    drag: Array
    ring_mass: float
    stiffness: Array
    ring_maps: Array

    @staticmethod
    def of(cell: Cell, options: SimulationOptions) -> Dynamics:
        """The motion of a cell, of the weave that it names, with these options."""
        equations = Equations.of(cell.weave, cell.wire)
        ring_mass = cell.ring_mass / options.load
        drag = options.damping / options.load
        # Every turn of a ring has the inertia of one about a diameter: about its axis damping outweighs inertia by
        # four powers of ten, and an isotropic inertia has no gyroscopic torque.
        weave, turns = cell.weave, np.ones(len(equations.mass))
        for ring, (radius, wire) in enumerate(zip(weave.radii, cell.wire * weave.wires, strict=True)):
            turns[turns_of(weave, ring)] = options.rotational_damping * (radius / gyration_radius(radius, wire)) ** 2
        return Dynamics(
            equations,
            options,
            ring_mass * equations.mass,
            np.asarray(np.linalg.inv(ring_mass * equations.mass), dtype=float),
            drag * equations.mass * turns,
            ring_mass,
            options.stiffness / options.load * np.maximum(copies(weave), 1),
            place_maps(weave, weave.rings),
        )

    def velocities(self, pose: Pose) -> Array:
        """T(q) (n, m_full, m), v = T u; with friction the last of u are the spins of rings, which move no pose."""
        T = reduction(pose)
        if not self.options.friction:
            return T
        weave = self.equations.weave
        spins = np.zeros((*T.shape[:2], weave.classes))
        for ring in range(weave.classes):
            spins[:, turns_of(weave, ring), ring] = pose.normals[:, ring]
        return np.concatenate([T, spins], axis=2)

    def slip(self, pose: Pose, contacts: CellContacts, T: Array) -> Array:
        """Slip of every contact along two tangents with respect to u, (n, p SLOTS, 2, m), 0 in empty slots."""
        minima, weave, wire = contacts.minima, self.equations.weave, self.equations.wire
        case, pair = np.divmod(minima.pair, len(weave.pairs))
        a, b = weave.pairs[pair, 0], weave.pairs[pair, 1]
        local = slip_gradient(minima, pose.normals[case, a], wire * weave.wires[a], wire * weave.wires[b])
        out = np.zeros((*contacts.present.shape, 2, T.shape[2]))
        out[contacts.present] = np.matmul(local, np.matmul(self.equations.maps[pair], T[case]))
        return out.reshape(len(T), -1, 2, T.shape[2])

    def polygon(self) -> Array:
        """The corners (directions, 2) of the polygon of friction forces under a unit normal force."""
        angle = 2.0 * np.pi * np.arange(self.options.directions) / self.options.directions
        return self.options.friction * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def largest_motion(self, v: Array) -> Array:
        """Largest speed of a ring's centre (r1/s) or of its rotation (rad/s), (n,)."""
        speed = np.einsum("rxm,nm->nrx", self.ring_maps, v)
        spin = v[:, turns_of(self.equations.weave, 0).start :].reshape(len(v), -1, 3)
        return np.asarray(np.sqrt(np.maximum((speed**2).sum(axis=2).max(axis=1), (spin**2).sum(axis=2).max(axis=1))))

    def kinetic_energy(self, v: Array) -> Array:
        """Kinetic energy of all rings, (n,)."""
        return 0.5 * (v * np.matmul(v[:, None, :], self.mass)[:, 0]).sum(axis=1)

    def energy(self, contacts: CellContacts, v: Array) -> Array:
        """Elastic energy of the penetrating contacts, and kinetic energy, (n,)."""
        pressed = np.where(contacts.present, np.minimum(contacts.gap, 0.0), 0.0)
        return 0.5 * (self.stiffness[:, None] * pressed**2).sum(axis=(1, 2)) + self.kinetic_energy(v)

    def weighted_load(self, v_new: Array, v: Array, h: Array, load: Array) -> Array:
        """R of eq. (9) over all rings, (n,), with the contact and constraint forces of the step.

        By (6) their sum with the load is M (v+ - v)/h + D v+; the load on corners 1-4 is +-(f1 + f2)/2, +-(f1 - f2)/2.
        A load below a thousandth of s_hat r1 counts as that.
        """
        left = np.matmul(((v_new - v) / h[:, None])[:, None], self.mass) + np.matmul(v_new[:, None], self.drag)
        top = (left * np.matmul(left, self.inverse_mass)).sum(axis=(1, 2))
        size = np.maximum((load**2).sum(axis=1), LEAST_LOAD**2)
        return np.asarray(np.sqrt(np.maximum(top, 0.0) * self.ring_mass / size))


LEAST_LOAD = 1e-3
"""Load on a cell in s_hat r1 from which on it is what residuals are measured against."""


def copies(weave: Weave) -> Index:
    """How often each pair of `weave.pairs` occurs among the rings that carry mass, (p,): their stiffnesses add."""
    rings = {tuple(ring) for ring in weave.rings.tolist()}
    pairs = weave.pairs.tolist()
    return np.array([sum(c == a and (b, x + i, y + j) in rings for c, x, y in rings) for a, b, i, j in pairs])
