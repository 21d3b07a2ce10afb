"""Convex sets known exactly, and tables sampled from them: what the laws of this package are measured against."""

import numpy as np
import pytest

from homogenize.laws import LockedRows, ring_cell
from rve.common import WEIGHT, double_dot, from_disc, trace


class Ellipsoid:
    """K = centre + {E : E.A^-1 E <= 1} in components weighted like S:E; h = S:centre + sqrt(S.A S). Weave-symmetric."""

    A = np.array([[0.10, 0.0, -0.06], [0.0, 0.006, 0.0], [-0.06, 0.0, 0.08]])
    centre = np.array([0.05, 0.0, -0.05])

    def support(self, S):
        return double_dot(S, self.centre) + np.sqrt(np.einsum("ni,ij,nj->n", S, self.A, S))

    def strain(self, S):
        size = np.sqrt(np.einsum("ni,ij,nj->n", S, self.A, S))
        return self.centre + (S @ self.A) / size[:, None] / WEIGHT


def disc_grid(rings, spokes):
    """Loads of unit trace on rings of the disc, the rim included: (1 + rings * spokes, 3)."""
    radius = np.arange(1, rings + 1) / rings
    angle = 2.0 * np.pi * np.arange(spokes) / spokes
    points = radius[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return from_disc(np.vstack([np.zeros((1, 2)), points.reshape(-1, 2)]))


def rows_of(truth, S):
    S = S / trace(S)[:, None]
    E = truth.strain(S)
    return LockedRows(S, E, double_dot(S, E), np.ones(len(S), bool), np.arange(len(S)))


def table_of(S, E, *, status=None, unique=None):
    """A table in memory with the given loads and strains; angles are those of the load on the undeformed cell."""
    from rve import StrainTable
    from rve.table import Origin, RowQuality

    n = len(S)
    alpha = np.degrees(0.5 * np.arctan2(2.0 * S[:, 1], S[:, 0] - S[:, 2]))
    radius = np.hypot(0.5 * (S[:, 0] - S[:, 2]), S[:, 1])
    beta = np.degrees(np.arctan2(0.5 * trace(S) - radius, 0.5 * trace(S) + radius))
    unique = np.ones(n, bool) if unique is None else unique
    status = np.full(n, "converged") if status is None else status
    sides, quality = np.zeros((n, 2)), RowQuality(np.zeros(n), np.zeros(n), np.zeros(n, int), np.zeros(n, int))
    cell = ring_cell(5.0, 0.5, 11.0, 12.646069623526)
    return StrainTable(alpha, beta, E, S, sides, sides, unique, status, quality, origin=Origin(cell))


def derivative_errors(law, E, step=1e-6):
    """Largest error of S as gradient of the energy, and of C as derivative of S, per point, by central differences."""
    answer = law.response(E)
    of_energy, of_load = np.zeros(len(E)), np.zeros(len(E))
    for j in range(3):
        up, down = law.response(E + step * np.eye(3)[j]), law.response(E - step * np.eye(3)[j])
        slope = (up.energy - down.energy) / (2.0 * step)
        of_energy = np.maximum(of_energy, np.abs(slope - WEIGHT[j] * answer.S[:, j]))
        of_load = np.maximum(of_load, np.abs((up.S - down.S) / (2.0 * step) - answer.C[:, :, j]).max(axis=1))
    return of_energy, of_load


@pytest.fixture
def ellipsoid():
    return Ellipsoid()
