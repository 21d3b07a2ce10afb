"""Contact forces of the rings of a cell under the line load of a curtain, and their virial."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rve.common import Array, ByValue, NotConverged, checked
from rve.common.tensor import WEIGHT
from rve.geometry.cell import Cell
from rve.geometry.kinematics import cauchy_line_load, load_angles
from rve.geometry.pattern import padded, supercell
from rve.geometry.pose import pair_geometry, tiled
from rve.locking.interior_point import DirectOptions, LockedStates
from rve.locking.system import Equations
from rve.solve import locked_block, locked_states


@dataclass(frozen=True, eq=False)
class CellForces(ByValue):
    """Contacts of one locked cell: rings a and b (m, 3) as (class, i, j), point (m, 3) in mm from the centre of ring
    (0, 0, 0), normal (m, 3) from a to b, force (m,) in N that b feels along it; branch (m, 3) in mm from centre to
    centre, area in mm2, line load s (3,) in N/mm. In the frame of the rotation rule (5) of the weave."""

    a: NDArray[np.intp]
    b: NDArray[np.intp]
    point: Array
    normal: Array
    force: Array
    branch: Array
    area: float
    s: Array
    status: str
    alpha_deg: float
    beta_deg: float

    @property
    def virial(self) -> Array:
        """Line load (3,) in N/mm of the contacts: - sum of force x branch over the area of the cell."""
        pull = -self.force[:, None] * self.normal[:, :2]
        sums = pull.T @ self.branch[:, :2] / self.area
        return np.array([sums[0, 0], 0.5 * (sums[0, 1] + sums[1, 0]), sums[1, 1]])


def central_forces(states: LockedStates) -> Array:
    """Contact forces (n, p, SLOTS) of locked states that balance every ring, also across the plane, with the largest
    product: the end of the central path, of which gaps rounded to 1e-16 determine three digits only."""
    space, lam = supercell(states.cell.weave, 1, 1, "space"), states.found.lam.copy()
    equations, pose = Equations.of(space, states.cell.wire), tiled(states.pose, space)
    system = equations.assemble(pose, states.found.contacts, lam, states.s)
    for i in np.flatnonzero(states.found.status == "converged"):
        works = lam[i] > 1e-7
        for _ in range(4):  # Newton's method from three digits
            W = lam[i][works][:, None] * system.G[i][works.ravel()]
            lam[i][works] *= 2.0 + np.linalg.lstsq(W.T, -system.f[i] - 2.0 * W.sum(axis=0), rcond=1e-9)[0]
    return lam


@checked
def cell_forces(s: Array, cell: Cell) -> CellForces:
    """Contacts and their forces in the locked cell under one line load s (3,) in N/mm, in weave axes.

    `status` is "converged" or the name of a failure; there are no contacts then.
    """
    alpha, beta, size = load_angles(s[None])
    states = locked_block(alpha, beta, replace(cell, grain="y"), DirectOptions())
    pose, con, weave, status = states.pose, states.found.contacts, states.cell.weave, str(states.found.status[0])
    force = central_forces(states)[con.present]
    works = (force > 1e-9) & (status == "converged")
    minima = con.minima.take(works)
    a, b, i, j = weave.pairs[minima.pair].T
    start, branch = padded(pose.centres[0, a]), pair_geometry(pose, weave)[0][0, minima.pair]
    a1, a2 = pose.a1[0], pose.a2[0]
    share = (weave.wires[a] / (weave.wires[a] + weave.wires[b]))[:, None]  # of the way between both centre circles
    return CellForces(
        np.stack([a, 0 * a, 0 * a], axis=1),
        np.stack([b, i, j], axis=1),
        cell.r1 * (start + (1.0 - share) * minima.rho_a + share * (minima.rho_b + branch)),
        minima.normal,
        force[works] * size[0] * cell.r1,
        cell.r1 * branch,
        cell.r1**2 * float(a1[0] * a2[1] - a1[1] * a2[0]),
        size[0] * cauchy_line_load(alpha, beta)[0],
        status,
        float(alpha[0]),
        float(beta[0]),
    )


@checked
def largest_forces(s: Array, cell: Cell, step: float = 2.0) -> Array:
    """Largest contact force (n, K) in N on a ring of each class under the line loads s (n, 3) in N/mm, in weave axes.

    Directions are rounded to `step` degrees, so that many cells share a solve; the smaller load is at least tan(step/2)
    of the larger one, where the locked state is unique. A direction that is not solved takes the nearest that is.
    """
    alpha, beta, size = load_angles(s)
    out = np.zeros((len(s), cell.weave.classes))
    loaded = np.flatnonzero(size > 0.0)
    if not len(loaded):
        return out
    rounded = np.stack([step * np.round(alpha[loaded] / step), step * np.round(beta[loaded] / step)], axis=1)
    rounded[:, 0] = np.mod(rounded[:, 0] + 90.0, 180.0) - 90.0
    rounded[:, 1] = np.maximum(rounded[:, 1], 0.5 * step)
    # The mirror image of a weave that has one carries the load of the other sign of alpha.
    flip = (rounded[:, 0] < 0.0) & (rounded[:, 0] > -90.0) & cell.weave.has_images
    rounded[flip, 0] *= -1.0
    keys, back = np.unique(rounded, axis=0, return_inverse=True)
    states = locked_states(keys[:, 0], keys[:, 1], replace(cell, grain="y"), DirectOptions())
    per_pair, pairs = central_forces(states).max(axis=2), states.cell.weave.pairs[:, :2]
    per_ring = [per_pair[:, (pairs == ring).any(axis=1)].max(axis=1) for ring in range(cell.weave.classes)]
    unit = np.where((states.found.status == "converged")[:, None], np.stack(per_ring, axis=1), np.nan)
    good = np.flatnonzero(np.isfinite(unit).all(axis=1))
    if not len(good):
        raise NotConverged(f"contact forces: none of {len(keys)} load directions of the curtain was solved")
    loads = cauchy_line_load(*keys.T)
    for row in np.flatnonzero(~np.isfinite(unit).all(axis=1)):
        unit[row] = unit[good[np.argmin((loads[good] - loads[row]) ** 2 @ WEIGHT)]]
    forces = unit[back.ravel()]
    if flip.any():
        forces[np.flatnonzero(flip)[:, None], cell.weave.images[:, 0]] = forces[flip]
    out[loaded] = size[loaded, None] * cell.r1 * forces
    return out
