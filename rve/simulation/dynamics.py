"""The paper's rings in motion: options, mass and damping, energies, and the residual of eq. (9)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from msgspec import Meta

from rve.common import Array, Index, Typed
from rve.common.cell_fields import gyration_radius
from rve.geometry.contacts import CellContacts
from rve.geometry.pose import place_maps, turns_of
from rve.geometry.weave import Weave
from rve.locking.system import Equations

Positive = Annotated[float, Meta(gt=0.0, le=1e15)]
"""Products of two stay finite."""


@dataclass(frozen=True)
class StewartTrinkleOptions(Typed):
    """Parameters of the paper's section 3.1, in mm, kg, s; InputError for senseless values.

    Two are calibrated, see docs/explanation/paper_scheme.md: `rotational_damping` (the paper prints 0.1 kgm/s) and
    `load` (the paper states none).

    r1_mm: centre-circle radius; density in kg/mm3; damping in kg/s and rotational_damping in kg mm2/s: on each ring.
    stiffness: of one contact in kg/s2; load: size of the Cauchy line load s_hat in kg/s2, 1 kg/s2 = 1 N/m.
    h_max, h_min: largest time step and the one at which the solver gives up, s.
    tolerance: R of eq. (9) at which a case has converged; max_steps: accepted steps per case.
    restore: growth of the step after an accepted one; reach: contacts with a larger gap in r1 are ignored.
    largest_move: of a ring per step, in r1 and rad, so that rings do not pass through each other.
    curvature: the step includes the curvature of its contacts (`geometric_stiffness`).
    Without it, as eq. (6) is printed, some cases chatter between merging minima and end with the status "time-step".
    """

    r1_mm: Positive = 5.0
    density: Positive = 7.85e-6
    damping: Positive = 1.0
    rotational_damping: Positive = 100.0
    stiffness: Positive = 1e6
    load: Positive = 2.5
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

    mass (m_full, m_full) in s2; decay (m_full,): damping over mass of each velocity in 1/s; ring_mass in s2; stiffness
    (p,) of each pair of rings; ring_maps (rings, 2, m_full): from velocities v (n, m_full) = T u to those of centres.
    """

    weave: Weave
    mass: Array
    decay: Array
    ring_mass: float
    stiffness: Array
    ring_maps: Array

    @staticmethod
    def of(equations: Equations, options: StewartTrinkleOptions) -> Dynamics:
        """The motion of a cell with these options."""
        weave, wire, r1 = equations.weave, equations.wire, options.r1_mm
        ring_mass = options.density * 2.0 * np.pi**2 * r1**3 * wire**2 / options.load
        turning = options.rotational_damping / (options.load * r1**2 * ring_mass * gyration_radius(1.0, wire) ** 2)
        is_turn = np.arange(len(equations.mass)) >= turns_of(weave, 0).start
        decay = np.where(is_turn, turning, options.damping / (options.load * ring_mass))
        stiffness = options.stiffness / options.load * np.maximum(copies(weave), 1)
        return Dynamics(weave, ring_mass * equations.mass, decay, ring_mass, stiffness, place_maps(weave, weave.rings))

    def largest_motion(self, v: Array) -> Array:
        """Largest speed of a ring's centre (r1/s) or of its rotation (rad/s), (n,)."""
        speed = np.einsum("rxm,nm->nrx", self.ring_maps, v)
        spin = v[:, turns_of(self.weave, 0).start :].reshape(len(v), self.weave.classes, 3)
        return np.asarray(np.sqrt(np.maximum((speed**2).sum(axis=2).max(axis=1), (spin**2).sum(axis=2).max(axis=1))))

    def kinetic_energy(self, v: Array) -> Array:
        """Kinetic energy of all rings, (n,)."""
        return np.asarray(0.5 * (v * np.matmul(v[:, None, :], self.mass)[:, 0]).sum(axis=1))

    def energy(self, contacts: CellContacts, v: Array) -> Array:
        """Elastic energy of the penetrating contacts, and kinetic energy, (n,)."""
        pressed = np.where(contacts.present, np.minimum(contacts.gap, 0.0), 0.0)
        return np.asarray(0.5 * (self.stiffness[:, None] * pressed**2).sum(axis=(1, 2)) + self.kinetic_energy(v))

    def weighted_load(self, v_new: Array, v: Array, h: Array, load: Array) -> Array:
        """R of eq. (9) over all rings, (n,), with the contact and constraint forces of the step.

        By (6) their sum with the load is M (v+ - v)/h + D v+; the load on corners 1-4 is +-(f1 + f2)/2, +-(f1 - f2)/2.
        """
        y = (v_new - v) / h[:, None] + self.decay * v_new
        top = (y * np.matmul(y[:, None, :], self.mass)[:, 0]).sum(axis=1)
        return np.asarray(np.sqrt(top * self.ring_mass / (load**2).sum(axis=1)))


def copies(weave: Weave) -> Index:
    """How often each pair of `weave.pairs` occurs among the rings that carry mass, (p,): their stiffnesses add."""
    rings = {tuple(ring) for ring in weave.rings.tolist()}
    pairs = weave.pairs.tolist()
    return np.array([sum(c == a and (b, x + i, y + j) in rings for c, x, y in rings) for a, b, i, j in pairs])
