"""The locked cell as a nonlinear programme for a solver that knows nothing of rings: SLSQP.

It maximises S:E over the nine coordinates with all gaps >= 0 and analytic first derivatives. S is the second
Piola-Kirchhoff load of the answer, given to it because a fixed Cauchy load has no potential.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import NonlinearConstraint, minimize

from rve.geometry import Pose, distance_gradient, local_minima, pair_geometry, start_pose, tangent_frame
from rve.locking import Equations

Array = NDArray[np.float64]
BOX = (-1.5, 1.5)  # without bounds on the coordinates the first step of SLSQP unlinks the rings


class Programme:
    """Maximise S:E with gaps >= 0 in a chart: x2, y3, t, the offset of ring B, and two numbers for each normal."""

    def __init__(self, S: Array, equations: Equations, sides: tuple[float, float]) -> None:
        """S (3,): second Piola-Kirchhoff load; sides of the reference cell in units of r1."""
        self.S, self.equations, self.sides = S, equations, sides
        self.start = start_pose(equations.weave, 1)
        self.frames = tangent_frame(self.start.normals[0])
        self.calls = 0

    def pose(self, q: Array) -> tuple[Pose, Array]:
        """The pose of q (9,), and the lengths of the unnormalised normals (2,)."""
        e1, e2 = self.frames
        n = self.start.normals[0] + q[5:9:2, None] * e1 + q[6:9:2, None] * e2
        length = np.linalg.norm(n, axis=1)
        centres = self.start.centres.copy()
        centres[0, 1] += q[3:5]
        return Pose(self.start.lattice + q[:3], centres, (n / length[:, None])[None]), length

    def coordinates(self, pose: Pose, case: int) -> Array:
        """The q of a pose, moved so that ring A is at the origin as in the start pose."""
        e1, e2 = self.frames
        n, up = pose.normals[case], self.start.normals[0]
        n = n / (n * up).sum(axis=1, keepdims=True)
        q = np.zeros(9)
        q[:3] = pose.lattice[case] - self.start.lattice[0]
        q[3:5] = pose.centres[case, 1] - pose.centres[case, 0] - self.start.centres[0, 1] + self.start.centres[0, 0]
        q[5:9:2], q[6:9:2] = (n * e1).sum(axis=1), (n * e2).sum(axis=1)
        return q

    def strain(self, q: Array) -> tuple[Array, Array]:
        """E (3,) and its derivative (3, 9)."""
        x2, y3, t = self.start.lattice[0] + q[:3]
        bx, by = self.sides
        E = [((1 + t * t) * x2 * x2 / bx**2 - 1) / 2, t * x2 * y3 / bx / by, ((1 + t * t) * y3 * y3 / by**2 - 1) / 2]
        d = np.zeros((3, 9))
        d[0, 0], d[0, 2] = (1 + t * t) * x2 / bx**2, t * x2 * x2 / bx**2
        d[1, :3] = t * y3 / bx / by, t * x2 / bx / by, x2 * y3 / bx / by
        d[2, 1], d[2, 2] = (1 + t * t) * y3 / by**2, t * y3 * y3 / by**2
        return np.array(E), d

    def loss(self, q: Array) -> float:
        """-S:E."""
        return -float((self.S * [1, 2, 1]) @ self.strain(q)[0])

    def slope(self, q: Array) -> Array:
        """Derivative of the loss, (9,)."""
        return np.asarray(-(self.S * [1, 2, 1]) @ self.strain(q)[1])

    def gaps(self, q: Array) -> tuple[Array, Array]:
        """Gaps (c,) and derivatives (c, 9): two for each linked pair, the smallest for every other."""
        self.calls += 1
        weave = self.equations.weave
        pose, length = self.pose(q)
        d, n_a, n_b = (part[0] for part in pair_geometry(pose, weave))
        found = local_minima(d, n_a, n_b)
        g = np.matmul(distance_gradient(found)[:, None, :], self.equations.maps[found.pair])[:, 0]
        slopes = g @ self._velocities(pose, length)
        size = len(weave.pairs) + int(weave.linked.sum())
        gap, slope = np.ones(size), np.zeros((size, 9))
        row = 0
        for pair, linked in enumerate(weave.linked):
            mine = np.flatnonzero(found.pair == pair)
            # An order that stays when both are equally near, as in the answer.
            mine = mine[np.argsort(found.rho_a[mine, 0] if linked else found.distance[mine])]
            # A far pair may have no isolated minimum; a linked pair whose minima have merged counts its only one twice.
            for k in range(2 if linked else 1):
                if len(mine):
                    best = mine[min(k, len(mine) - 1)]
                    gap[row], slope[row] = found.distance[best] - 2.0 * self.equations.wire, slopes[best]
                row += 1
        return gap, slope

    def _velocities(self, pose: Pose, length: Array) -> Array:
        """Derivative (12, 9) of the cell's generalised coordinates with respect to q."""
        full = np.zeros((12, 9))
        x2, y3, t = pose.lattice[0]
        full[0, 0], full[1, 0], full[1, 2] = 1.0, t, x2
        full[3, 1], full[2, 1], full[2, 2] = 1.0, t, y3
        full[4, 3] = full[5, 4] = 1.0
        for k in range(2):
            n = pose.normals[0, k]
            for i, e in enumerate(self.frames):
                full[6 + 3 * k : 9 + 3 * k, 5 + 2 * k + i] = np.cross(n, e[k]) / length[k]
        return full


def slsqp(programme: Programme, q0: Array, tolerance: float) -> Array:
    """The answer (9,) from q0 (9,) by SciPy's sequential quadratic programmes; `tolerance` on the loss."""
    bound = NonlinearConstraint(lambda q: programme.gaps(q)[0], 0.0, np.inf, jac=lambda q: programme.gaps(q)[1])
    given: dict[str, Any] = {"jac": programme.slope, "constraints": [bound], "bounds": [BOX] * 9}
    options = {"ftol": tolerance, "maxiter": 1000}
    return np.asarray(minimize(programme.loss, q0, method="SLSQP", options=options, **given).x)
