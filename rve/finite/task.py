"""What the solver of finite meshes solves: options, task, iterate, answer and statuses. Lengths are in units of r1."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray
from scipy import sparse

from rve.common import Array, Index, Typed
from rve.finite.touching import NOWHERE, FixedPoints, Placed, Touching, find_touching, handed_on, of_pairs
from rve.geometry.ring_pair import cross, dot, tangent_frame

BLOCK = 5
"""Unknowns of a ring: its centre (3) and two tilts about the axes of its tangent frame."""
_TIE = 0.1
"""Stiffness of the spring between a ring and its guide over mu, in 1/r1^2."""
_TIED = 1e-3
"""mu below which rings are guided no more."""

Share = Annotated[float, Meta(gt=0.0, le=1.0)]

SENTENCES = {
    "converged": "a local minimum of the potential: forces balance, gaps and links are within tolerance",
    "out-of-reach": "held rings or walls did not reach their places: the mesh locks before; move them closer together",
    "stalled": "no step lowers the residual further; start from another disturbance, or allow a larger residual",
    "iterations": "the limit of iterations was reached: allow more, and hold what slides on a floor without friction",
}


@dataclass(frozen=True)
class FiniteOptions(Typed):
    """Options of `FiniteMesh.solve`; lengths in units of r1, forces in units of the mean force on a link.

    tolerance: of the Karush-Kuhn-Tucker residual. patience: iterations in which the decrement of Newton's method did
    not fall by 30 % after which mu, the product of force and gap, is lifted, at most `retries` times before `stalled`.
    first, last: mu at the start and at the end.
    reach: gap beyond which a contact has no force.
    disturbance, seed, starts: size and seed of the random numbers added to z at the start in space, so that folds may
    form, and how many seeds, one after the other, are tried where a path of `max_iterations` does not converge.
    """

    tolerance: Share = 1e-8
    patience: Annotated[int, Meta(ge=1, le=1_000_000)] = 8
    retries: Annotated[int, Meta(ge=0, le=1_000_000)] = 20
    reach: Share = 0.6
    max_iterations: Annotated[int, Meta(ge=1, le=1_000_000)] = 1000
    disturbance: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.01
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 0
    starts: Annotated[int, Meta(ge=1, le=1000)] = 2
    first: Share = 0.1
    last: Share = 1e-9

    def check(self) -> None:
        if self.last > self.first:
            self.refuse(f"last = {self.last:g}: is more than first = {self.first:g}")


@dataclass(frozen=True, eq=False)
class RingInertia:
    """The term |x - x_hat|^2_M / (2 (beta h)^2) of a time step, without units: weight (n,) over (beta h)^2, where the
    centres would go without forces (n, 3), the weight (n,) of normals and where these would go (n, 3); see `step`.
    """

    weight: Array
    place: Array
    turning: Array
    normal: Array


@dataclass(frozen=True, eq=False)
class Task:
    """What is solved: linked pairs (m, 2), wire = r2/r1, dead forces (n, 3), held coordinates (n, 3) and their places,
    motions (5 n, u): those that are free, rings on straight bars going with the ends of their bar; beside: whether
    points beside soft minima are constraints too; points: of pairs that touch at fixed ones; guide (n, 3): places that
    pull at the centres while mu is large, nan where none does; load: the sum of the loads, by which residuals are
    measured; inertia: that of a time step; unit: that of forces, in N."""

    linked: Index
    wire: float
    force: Array
    held: NDArray[np.bool_]
    at: Array
    motions: sparse.csr_matrix
    beside: bool = True
    points: FixedPoints = NOWHERE
    guide: Array = field(default_factory=lambda: np.array(np.nan))
    load: float = 1.0
    inertia: RingInertia | None = None
    unit: float = 1.0

    @property
    def keys(self) -> Index:
        """Keys of the linked pairs."""
        return np.asarray(self.linked[:, 0] * len(self.force) + self.linked[:, 1])

    def find(self, placed: Placed, reach: float) -> Touching:
        """The contacts of placed rings."""
        return find_touching(placed, self.linked, self.wire, reach, beside=self.beside, points=self.points)

    def way_left(self, placed: Placed) -> Array:
        """The way (n, 3) of held coordinates to their places, 0 for others."""
        return np.where(self.held, self.at - placed.x, 0.0)

    def springs(self, placed: Placed, mu: float) -> tuple[float, Array, Array]:
        """Energy, generalised forces (n, 5) and stiffness (n, 5) of the springs to the guide, none at a small mu, and
        of the inertia of a time step."""
        energy, pull, stiff = 0.0, np.zeros((len(placed.x), BLOCK)), np.zeros((len(placed.x), BLOCK))
        own, ends = self.inertia, []
        if mu >= _TIED:
            guided = np.isfinite(self.guide)
            ends.append((np.where(guided, _TIE * mu, 0.0), np.where(guided, self.guide, 0.0)))
        if own is not None:
            ends.append((own.weight[:, None], own.place))
            energy += 0.5 * float((own.turning * ((placed.normal - own.normal) ** 2).sum(axis=1)).sum())
            torque = own.turning[:, None] * cross(placed.normal, own.normal)
            pull[:, 3:] = np.stack([dot(torque, e) for e in tangent_frame(placed.normal)], axis=1)
            stiff[:, 3:] = (own.turning * dot(placed.normal, own.normal))[:, None]
        for weight, end in ends:
            away = end - placed.x
            energy += 0.5 * float((weight * away**2).sum())
            pull[:, :3] += weight * away
            stiff[:, :3] += weight
        return energy, pull, stiff

    def barrier(self, con: Touching, mu: Array) -> float:
        """-f.x + sum mu `Touching.barrier` and the energy of springs and inertia, all without units, mu (n,) of the
        rings: falls along a step at one mu."""
        energy = self.springs(con.placed, float(mu.max()))[0] - (self.force * con.placed.x).sum()
        return float(energy + (con.greater(mu)[con.minima.pair] * con.barrier(con.gap)).sum())


@dataclass(frozen=True, eq=False)
class State:
    """An iterate: forces (m,) of contacts; mu (n,) of rings, of which a contact has the greater; damping of all pairs,
    and `local` (p,) of single ones on top of it; convex (p,): which part of the negative curvature of each pair is left
    out; extra (m,): what contacts are stiffer by in the step from it; gain (n,): what the step to it could have gained,
    by rings, negative where there was none."""

    touching: Touching
    force: Array
    mu: Array
    damping: float
    local: Array
    convex: Array
    extra: Array
    gain: Array

    @property
    def contact_mu(self) -> Array:
        """mu (m,) of the contacts."""
        return np.asarray(self.touching.greater(self.mu)[self.touching.minima.pair])

    def at(self, touching: Touching) -> State:
        """The iterate with other contacts, forces handed on."""
        row = of_pairs(self.touching.key, touching.key)
        local, convex = (np.where(row >= 0, of[row], 0.0) for of in (self.local, self.convex))
        new = replace(self, touching=touching, local=local, convex=convex, extra=np.zeros(len(touching.gap)))
        return replace(new, force=handed_on(self.touching, self.force, touching, new.contact_mu))


@dataclass(frozen=True, eq=False)
class Record:
    """One iteration: the part of the step taken, and how many trials and factors it had."""

    length: float
    trials: int
    factors: int


@dataclass(frozen=True, eq=False)
class Found:
    """Where the rings are, their contacts and forces (m,), status, residual.

    Of iterates that do not converge, the one of least residual.
    """

    touching: Touching
    force: Array
    status: str
    residual: float
    history: tuple[Record, ...]
