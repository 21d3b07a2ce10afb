"""What a curtain is at one moment, at rest or in motion: what pictures, files and the judgement of strength read."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from macro_fem.curtain.problem import CurtainProblem
from macro_fem.fem.assembly import gradient
from macro_fem.fem.cells import recovered
from macro_fem.scene.obstacles import PlacedObstacle
from macro_fem.solvers.cones import green_strain
from rve.common import Array


@dataclass(frozen=True, eq=False)
class InnerForces:
    """Line loads at the points, P = F S (nq, d, 2) and S (nq, 3), in N per mm of reference length; the even tension in
    N/mm that P balances besides the load; wall_forces (m,), N: the push of each half-space along its normal. S_strings
    (nq, 3): the part of S that rings drawn to strings bear, None where rings do not flow.
    """

    P: Array
    S: Array
    tension: float = 0.0
    wall_forces: Array = field(default_factory=lambda: np.zeros(0))
    S_strings: Array | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class CurtainState(ABC):
    """A curtain at a moment, under what acts in its `problem`: x (n_nodes, d) positions, mm; `inner`: line loads."""

    problem: CurtainProblem
    x: Array
    inner: InnerForces

    P = property(lambda self: self.inner.P)
    S = property(lambda self: self.inner.S)

    @property
    @abstractmethod
    def reactions(self) -> Array:
        """Forces of the supports on the curtain (n_nodes, d), N."""

    @property
    @abstractmethod
    def obstacles(self) -> list[PlacedObstacle]:
        """Obstacles and bodies, where they are."""

    @property
    @abstractmethod
    def pushed(self) -> Array:
        """Forces of each of the `obstacles` on the nodes (k, n_nodes, d), N."""

    @property
    @abstractmethod
    def blown(self) -> Array:
        """Forces of winds that depend on the shape (n_nodes, d), N."""

    @cached_property
    def F(self) -> Array:
        """Deformation gradients (nq, d, 2)."""
        return gradient(self.problem.disc, self.x)

    @property
    def E(self) -> Array:
        """Green strain (nq, 3)."""
        return green_strain(self.F)

    @property
    def corners(self) -> Array:
        """Positions of the corners of the mesh (n_corners, d), mm: the first nodes of every element."""
        return self.x[: self.problem.mesh.mesh.p.shape[1]]

    def principal(self) -> tuple[Array, Array]:
        """Principal line loads (n_cells, 2), larger first, and the reference direction of the larger (n_cells, 2).

        These are the singular values of P, averaged over neighbours first: forces per reference length, which the
        rings of a pitch carry, finite even where the mesh is drawn together to a line.
        """
        _, values, Vt = np.linalg.svd(self.recovered(self.P))
        return values, Vt[:, 0, :]

    def recovered(self, values: Array) -> Array:
        """Values at points, (n_cells, ...) averaged over cells and neighbours: `macro_fem.fem.cells.recovered`."""
        return recovered(self.problem.mesh.mesh.t.T, self.problem.disc.cell_mean(values), self.problem.disc.cell_area)

    def state(self) -> np.ndarray:
        """Per cell 0 where it is slack, 1 where it is drawn in one direction (wrinkled), 2 where it is taut in both."""
        values, _ = self.principal()
        # A larger principal line load below this part of the greatest one anywhere counts as none: slack.
        is_drawn = values[:, 0] > 1e-3 * float(values.max(initial=0.0))
        # A smaller principal line load below this part of the larger one beside it counts as none: drawn in one
        # direction.
        return is_drawn.astype(int) + (is_drawn & (values[:, 1] > 0.05 * values[:, 0]))
