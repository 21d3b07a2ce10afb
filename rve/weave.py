"""Weaves: which rings a periodic cell has, which of them link, and where a slack cell starts.

All rings with the same class are lattice translates of each other. Class 0 sits at the origin, class k at c_k, and ring
(k, i, j) at c_k + i a1 + j a2. A weave holds no radii: poses are in units of the centre-circle radius r1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Weave:
    """A periodic pattern of interlinked rings.

    pairs (m, 4): class of ring a, class of ring b, lattice shift (i, j) of ring b; every contact that can occur, each
    once. linked (m,): which of them interlink. rings (n, 3): class and shift of the rings whose mass weighs the
    residual (the ten rings of the paper for 4-in-1). start_cell: sides of the slack rectangular cell over r1;
    start_offset (K, 2): ring centres in lattice coordinates; start_tilt_deg (K,): rotation of each ring about x.
    partner (K,): class that the half turn about z maps each class to. repeat: primitive cells along a1 and a2.
    jamming_ratio: r1/r2 below which no slack pose exists.
    """

    name: str
    pairs: NDArray[np.intp]
    linked: NDArray[np.bool_]
    rings: NDArray[np.intp]
    start_cell: tuple[float, float]
    start_offset: Array
    start_tilt_deg: Array
    partner: NDArray[np.intp]
    jamming_ratio: float
    repeat: tuple[int, int] = (1, 1)

    @property
    def classes(self) -> int:
        """Independent rings in one lattice cell."""
        return len(self.start_offset)


def _same_class_pairs(count: int) -> list[tuple[int, int, int, int]]:
    shifts = ((1, 0), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2))
    return [(k, k, i, j) for k in range(count) for i, j in shifts]


def _two_class_weave(
    name: str,
    links: set[tuple[int, int]],
    cell: tuple[float, float],
    offset: tuple[float, float],
    tilt: float,
    jam: float,
) -> Weave:
    """Rows of rings with tilts +theta and -theta; ring A links B rings at the lattice shifts `links`."""
    cross_pairs = [(0, 1, i, j) for i in range(-2, 2) for j in range(-2, 2)]
    pairs = cross_pairs + _same_class_pairs(2)
    linked = [a != b and (i, j) in links for a, b, i, j in pairs]
    rings = [(0, i, j) for j in range(3) for i in range(2)] + [(1, i, j) for j in range(2) for i in range(2)]
    return Weave(
        name,
        np.array(pairs),
        np.array(linked),
        np.array(rings),
        cell,
        np.array([(0.0, 0.0), offset]),
        np.array([-tilt, tilt]),
        np.array([1, 0]),
        jam,
    )


# The pose of largest clearance. Its clearance is the jamming limit: with thicker wire no pose is free of overlap
# (tests/test_rve/test_weave.py finds pose and limit again by sequential linear programming).
FOUR_IN_ONE = _two_class_weave(
    "4-in-1",
    {(0, 0), (-1, 0), (0, -1), (-1, -1)},
    (2.502395550, 1.246968277),
    (0.5, 0.5),
    34.114592859,
    3.980926980,
)

WEAVES = {w.name: w for w in (FOUR_IN_ONE,)}
