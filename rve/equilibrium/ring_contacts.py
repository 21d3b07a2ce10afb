"""Where contacts act on the rings of locked cells, and the flexibility between them.

Lengths are in r1, Young's modulus is 1, so that flexibilities are to be divided by E r1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rve.common import Array, Flags, Index, Rows
from rve.equilibrium.interior_point import Equilibrium
from rve.equilibrium.system import Equations
from rve.geometry.circles import cross, dot, tangent_frame
from rve.ring.kernels import flexibility
from rve.ring.section import Ring

TOUCHING = 1e-6
"""Gap in r1 below which a contact may carry force; working contacts end at 1e-13 over their force."""


@dataclass(frozen=True)
class Ends(Rows):
    """Where contacts act on the rings of n cells: slot (n, c) of each contact, present (n, c); of its two ends, first
    all on ring a, then all on ring b: ring (n, 2c), angle phi (n, 2c), direction (n, 2c, 3) in the ring's local axes,
    zero for padding. Of each ring, grain (n, k): the angle at which it is farthest along the grain, and sense (n, k):
    1 where angles grow counterclockwise as seen from the front, else -1."""

    slot: Index
    present: Flags
    ring: Index
    phi: Array
    direction: Array
    grain: Array
    sense: Array

    def joints(self, angle_deg: float) -> Array:
        """The angles (n, k) of joints that are `angle_deg` degrees around each ring from the grain."""
        return self.grain + np.radians(angle_deg) * self.sense

    def on(self, k: int) -> tuple[Array, Array, Index]:
        """Angles (n, e), directions (n, e, 3), contacts (n, e) of the ends on ring k; padding has no direction."""
        mine = (self.ring == k) & (self.direction != 0.0).any(axis=2)
        count = int(mine.sum(axis=1).max(initial=1))
        column = np.argsort(~mine, axis=1, kind="stable")[:, :count]
        there = np.take_along_axis(mine, column, axis=1)
        direction = np.take_along_axis(self.direction, column[..., None], axis=1) * there[..., None]
        return np.take_along_axis(self.phi, column, axis=1), direction, column % self.slot.shape[1]


def contact_ends(equations: Equations, found: Equilibrium, near: float = TOUCHING) -> Ends:
    """The ends of all contacts of locked states whose gap in r1 is less than `near`."""
    contacts, n = found.contacts, len(found.lam)
    touching = (contacts.present & (contacts.gap < near)).reshape(n, -1)
    count = int(touching.sum(axis=1).max(initial=1))
    slot = np.argsort(~touching, axis=1, kind="stable")[:, :count]
    present = np.take_along_axis(touching, slot, axis=1)
    where = np.zeros(contacts.present.size, dtype=int)
    where[contacts.present.ravel()] = np.arange(len(contacts.minima.pair))
    m = contacts.minima.take(where.reshape(n, -1)[np.arange(n)[:, None], slot].ravel())
    pair = slot // contacts.gap.shape[2]
    rings = equations.weave.pairs[pair][..., :2]
    parts = []
    for k, (rho, push) in enumerate(((m.rho_a, -m.normal), (m.rho_b, m.normal))):
        normal = found.pose.normals[np.arange(n)[:, None], rings[..., k]].reshape(-1, 3)
        e1, e2 = tangent_frame(normal)
        phi, radial = np.arctan2(dot(rho, e2), dot(rho, e1)), rho / np.sqrt(dot(rho, rho))[:, None]
        local = np.stack([dot(push, radial), dot(push, cross(normal, radial)), dot(push, normal)], axis=1)
        parts.append((phi.reshape(n, count), np.where(present[..., None], local.reshape(n, count, 3), 0.0)))
    phi, direction = (np.concatenate(part, axis=1) for part in zip(*parts, strict=True))
    e1, e2 = tangent_frame(found.pose.normals)
    grain, sense = np.arctan2(e2[..., 1], e1[..., 1]), np.copysign(1.0, found.pose.normals[..., 2])
    return Ends(slot, present, np.concatenate([rings[..., 0], rings[..., 1]], axis=1), phi, direction, grain, sense)


def contact_flexibility(ends: Ends, ring: Ring, joint: Array | None = None) -> Array:
    """The flexibility C (n, c, c) between the contacts of each cell, by its rings of curved wire.

    joint (n, k): angles at which butted rings are open, None for welded ones.
    """
    mine = [ends.direction * (ends.ring == k)[..., None] for k in range(ends.grain.shape[1])]
    open_at = [None] * len(mine) if joint is None else list(joint.T)
    parts = [flexibility(ends.phi, d, ring.curved(), x) for d, x in zip(mine, open_at, strict=True)]
    full = np.sum(parts, axis=0)
    c = ends.slot.shape[1]
    return np.asarray(full[:, :c, :c] + full[:, :c, c:] + full[:, c:, :c] + full[:, c:, c:])
