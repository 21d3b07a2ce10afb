"""Weaves: which rings a periodic cell has, which of them link, and where a slack cell starts.

Rings of one class are lattice translates: ring (k, i, j) is at c_k + i a1 + j a2, c_0 = 0. Lengths are in r1.
"""

from dataclasses import dataclass, replace

import numpy as np

from rve.common import Array, ByValue, Flags, Index, InputError, shown
from rve.common.typed import not_one_of


@dataclass(frozen=True, eq=False, repr=False)
class Weave(ByValue):
    """A periodic pattern of interlinked rings.

    pairs (m, 4): class of ring a, class of ring b, lattice shift (i, j) of ring b; every contact that can occur, each
    once. linked (m,): which of them interlink. rings (n, 3): class and shift of the rings whose mass weighs the
    residual (the ten rings of the paper for 4-in-1). The slack start pose, in units of r1: start_lattice (3,) = x2, y3,
    tan gamma; start_centres (K, 2), or (K, 3) where centres may leave the plane; start_normals (K, 3). is_mirrored:
    start pose and pairs are their own mirror image in x, so that (alpha, beta) and (-alpha, beta) are one load and the
    reference cell is a rectangle. jamming_ratio: r1/r2 below which no slack pose exists. planar_ratio: r1/r2 up to
    which no larger cell was found to do more work than the planar primitive cell. repeat: primitive cells along a1, a2.
    """

    name: str
    pairs: Index
    linked: Flags
    rings: Index
    start_lattice: Array
    start_centres: Array
    start_normals: Array
    is_mirrored: bool
    jamming_ratio: float
    planar_ratio: float = np.inf
    repeat: tuple[int, int] = (1, 1)

    def __repr__(self) -> str:
        return f"<Weave {self.name}, repeat {self.repeat}, centres in the {self.centres}>"

    @property
    def classes(self) -> int:
        """Independent rings in one lattice cell."""
        return len(self.start_centres)

    @property
    def has_images(self) -> bool:
        """Whether a mirror shows the poses of this weave as its poses (`rve.geometry.pose.mirrored`)."""
        return self.is_mirrored and self.classes == 2

    @property
    def coordinates(self) -> int:
        """Reduced coordinates of a pose: lattice, centres of all rings but the first, two tilts per ring."""
        return 3 + self.start_centres[1:].size + 2 * self.classes

    @property
    def is_larger(self) -> bool:
        """Whether this is more than the planar primitive cell."""
        return self.repeat != (1, 1) or self.centres == "space"

    @property
    def centres(self) -> str:
        """Where the centres of the rings may be, "plane" or "space"."""
        return "space" if self.start_centres.shape[1] == 3 else "plane"


def _two_rows(links: set[tuple[int, int]], reach: int, same: tuple[tuple[int, int], ...]) -> tuple[Index, Flags, Index]:
    """Pairs, links and weighing rings of rows A, B, A, B ...: ring A links the B rings at the shifts `links`."""
    pairs = [(0, 1, i, j) for i in range(-reach, reach) for j in range(-2, 2)]
    pairs += [(k, k, i, j) for k in range(2) for i, j in same]
    linked = [a != b and (i, j) in links for a, b, i, j in pairs]
    rings = [(0, i, j) for j in range(3) for i in range(2)] + [(1, i, j) for j in range(2) for i in range(2)]
    return np.array(pairs), np.array(linked), np.array(rings)


_NEAR = ((1, 0), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2))
_FARTHER = (*_NEAR, (3, 0), (0, 3), (2, 1), (2, -1), (3, 1), (3, -1))
_TILT = np.radians(34.114592859)
_ROW, _LEAN = 1.30114408, 0.23404368

# Start poses are those of largest clearance; half of it is the thickest wire, the jamming limit
# (tests/test_rve/test_weave.py finds poses and limits again by sequential linear programming).
FOUR_IN_ONE = Weave(
    "4-in-1",
    *_two_rows({(0, 0), (-1, 0), (0, -1), (-1, -1)}, 2, _NEAR),
    np.array([2.502395550, 1.246968277, 0.0]),
    np.array([[0.0, 0.0], [1.251197775, 0.6234841385]]),
    np.array([[0.0, np.sin(_TILT), np.cos(_TILT)], [0.0, -np.sin(_TILT), np.cos(_TILT)]]),
    True,
    3.980926980,
    12.0,
)

# Each ring links three rings of the row above and three of the row below, so the rings of a row overlap like shingles
# and lean along x too. The mirror image leans the other way: two mirror forms of one mesh.
SIX_IN_ONE = Weave(
    "6-in-1",
    *_two_rows({(i, j) for i in (-1, 0, 1) for j in (0, -1)}, 4, _FARTHER),
    np.array([1.22213041, _ROW, _LEAN]),
    np.array([[0.0, 0.0], [0.5 * _LEAN * _ROW, 0.5 * _ROW]]),
    np.array([[-0.41265208, 0.58663338, 0.69683536], [0.41265208, -0.58663338, 0.69683536]]),
    False,
    5.943203815,
    12.0,
)

WEAVES = {w.name: w for w in (FOUR_IN_ONE, SIX_IN_ONE)}


def named_weave(name: str) -> Weave:
    """The weave of this name; InputError says which there are."""
    if name not in WEAVES:
        raise InputError(f"weave = {shown(name)}: {not_one_of(name, WEAVES)}")
    return WEAVES[name]


def supercell(weave: Weave, nx: int, ny: int, centres: str = "plane") -> Weave:
    """The same weave with nx x ny independent primitive cells in one lattice cell, centres in the plane or in space:
    ring (class k, cell ix, iy) gets the class k + K (ix + nx iy).
    """
    count = weave.classes

    def placed(k: int, i: int, j: int) -> tuple[int, int, int]:
        (shift_x, ix), (shift_y, iy) = divmod(i, nx), divmod(j, ny)
        return k + count * (ix + nx * iy), shift_x, shift_y

    cells = [(ix, iy) for iy in range(ny) for ix in range(nx)]
    pairs = [
        (a + count * (ix + nx * iy), *placed(b, ix + i, iy + j))
        for a, b, i, j in weave.pairs.tolist()
        for ix, iy in cells
    ]
    x2, y3, t = weave.start_lattice
    a1, a2 = np.array([x2, t * x2]), np.array([t * y3, y3])
    places = np.array([centre[:2] + ix * a1 + iy * a2 for ix, iy in cells for centre in weave.start_centres])
    return replace(
        weave,
        pairs=np.array(pairs),
        linked=np.repeat(weave.linked, len(cells)),
        rings=np.array([(k, i, j) for k in range(count * nx * ny) for i in range(2) for j in range(2)]),
        start_lattice=np.array([nx * x2, ny * y3, t]),
        start_centres=np.pad(places, ((0, 0), (0, 1 if centres == "space" else 0))),
        start_normals=np.tile(weave.start_normals, (len(cells), 1)),
        repeat=(nx * weave.repeat[0], ny * weave.repeat[1]),
    )
