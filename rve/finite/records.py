"""Options, task, answer and statuses of the solver of finite meshes. Lengths are in units of r1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from rve.common.types import Array
from rve.finite.touching import Index, Placed, Touching

SENTENCES = {
    "converged": "a local minimum of the potential: forces balance, gaps and links are within tolerance",
    "out-of-reach": "held rings or walls did not reach their places: the mesh locks before; move them closer together",
    "stalled": "no step lowers the residual further; start from another disturbance, or allow a larger residual",
    "iterations": "the limit of iterations was reached before the residual; allow more iterations",
}


@dataclass(frozen=True)
class FiniteOptions:
    """Options of `FiniteMesh.solve`; lengths in units of r1, forces in units of the mean force on a link.

    tolerance: of the Karush-Kuhn-Tucker residual. patience: iterations in which the decrement of Newton's method did
    not fall by 30 % after which mu, the product of force and gap, is lifted, at most `retries` times before `stalled`.
    first, last: mu at the start and at the end.
    reach: gap beyond which a contact has no force.
    disturbance, seed: size of the random numbers added to z at the start in space, so that folds may form.
    by_motion: whether the rings move to rest, damped, before the equilibrium near them is looked for.
    """

    tolerance: float = 1e-8
    patience: int = 8
    retries: int = 20
    reach: float = 0.6
    max_iterations: int = 1000
    disturbance: float = 0.01
    seed: int = 0
    first: float = 0.1
    last: float = 1e-9
    by_motion: bool = False


@dataclass(frozen=True, eq=False)
class RingInertia:
    """The term |x - x_hat|^2_M / (2 (beta h)^2) of a time step, without units: weight (n,) over (beta h)^2, where the
    centres would go without forces (n, 3), the weight (n,) of normals and where these would go (n, 3).

    A ring that does not spin about its axis turns like a point of its mass on its axis, one radius of gyration about a
    diameter away from the centre.
    """

    weight: Array
    place: Array
    turning: Array
    normal: Array


@dataclass(frozen=True, eq=False)
class Task:
    """What is solved: linked pairs (m, 2), wire = r2/r1, dead forces (n, 3), held coordinates (n, 3) and their places,
    free coordinates (n, 5); beside: whether points beside soft minima are constraints too; guide (n, 3): places that
    pull at the centres while mu is large, nan where none does; load: the sum of the loads, by which residuals are
    measured; inertia: that of a time step; tie (k, u): the free coordinates of the u that rings on
    straight bars leave, None without bars."""

    linked: Index
    wire: float
    force: Array
    held: NDArray[np.bool_]
    at: Array
    free: NDArray[np.bool_]
    beside: bool = True
    guide: Array | None = None
    tie: sparse.csr_matrix | None = None
    load: float = 1.0
    inertia: RingInertia | None = None

    @property
    def keys(self) -> Index:
        """Keys of the linked pairs."""
        return np.asarray(self.linked[:, 0] * len(self.force) + self.linked[:, 1])


@dataclass(frozen=True, eq=False)
class Record:
    """One iteration: mu, unbalanced force over load, Newton decrement, part of the step taken, damping, and how many
    contacts, trials and factors it had."""

    mu: float
    residual: float
    decrement: float
    length: float
    damping: float
    contacts: int
    trials: int
    factors: int


@dataclass(frozen=True, eq=False)
class Found:
    """Where the rings are, their contacts and forces (m,), status, residual.

    Of iterates that do not converge, the one of least residual.
    """

    placed: Placed
    touching: Touching
    force: Array
    status: str
    residual: float
    history: tuple[Record, ...]
