"""Patterns: which rings a periodic cell has, which of them link, and where a slack cell starts.

Rings of one class are lattice translates: ring (k, i, j) is at c_k + i a1 + j a2, c_0 = 0. Lengths are in r1.
"""

from dataclasses import dataclass, field, replace
from typing import Literal, TypeVar

import numpy as np

from rve.common import Array, ByValue, Flags, Index

Centres = Literal["plane", "space"]
"""Where the centres of rings may be."""


@dataclass(frozen=True, eq=False, repr=False)
class Pattern(ByValue):
    """A periodic pattern of interlinked rings.

    pairs (m, 4): class of ring a, class of ring b, lattice shift (i, j) of ring b; every contact that can occur, each
    once. linked (m,): which of them interlink. rings (n, 3): class and shift of the rings whose mass weighs the
    residual (the ten rings of the paper for 4-in-1). The slack start pose, in units of r1: start_lattice (3,) = x2, y3,
    tan gamma; start_centres (K, 2), or (K, 3) where centres may leave the plane; start_normals (K, 3). radii,
    wires (K,): radii and wire radii of the classes over those of the first, r1 and r2. jamming_ratio: r1/r2 below which
    no slack pose exists. planar_ratio: r1/r2 up to which no larger cell was found to do more work than the planar
    primitive cell. repeat: primitive cells along a1, a2.
    mirror (3,): signs of x, y, z by which a mirror or a half turn, which exchanges shears of both signs, shows start
    pose and pairs as themselves; the image of ring (k, 0, 0) is at ring images[k] (K, 3). Zero and empty if none does.
    """

    name: str
    pairs: Index
    linked: Flags
    rings: Index
    start_lattice: Array
    start_centres: Array
    start_normals: Array
    radii: Array
    wires: Array
    jamming_ratio: float
    planar_ratio: float = np.inf
    repeat: tuple[int, int] = (1, 1)
    mirror: Array = field(default_factory=lambda: np.zeros(3))
    images: Index = field(default_factory=lambda: np.zeros((0, 3), dtype=int))

    def __repr__(self) -> str:
        return f"<Weave {self.name}, repeat {self.repeat}, centres in the {self.centres}>"

    @property
    def classes(self) -> int:
        """Independent rings in one lattice cell."""
        return len(self.start_centres)

    @property
    def is_of_equal_rings(self) -> bool:
        """Whether all rings have one size."""
        return bool((self.radii == 1.0).all() and (self.wires == 1.0).all())

    @property
    def pair_radii(self) -> tuple[Array, Array]:
        """Radii (m,) of the first and of the second ring of the pairs, in r1."""
        return self.radii[self.pairs[:, 0]], self.radii[self.pairs[:, 1]]

    @property
    def pair_wires(self) -> Array:
        """Sums (m,) of the wire radii of both rings of the pairs, in r2."""
        return np.asarray(self.wires[self.pairs[:, :2]].sum(axis=1))

    @property
    def masses(self) -> Array:
        """Masses (K,) of the rings over that of the first."""
        return np.asarray(self.radii * self.wires**2)

    @property
    def is_mirrored(self) -> bool:
        """Whether (alpha, beta) and (-alpha, beta) are one load and the reference cell is a rectangle."""
        return len(self.images) > 0

    @property
    def has_images(self) -> bool:
        """Whether a mirror shows the poses of this weave as its poses (`rve.geometry.pose.mirrored`)."""
        return len(self.images) == self.classes

    @property
    def coordinates(self) -> int:
        """Reduced coordinates of a pose: lattice, centres of all rings but the first, two tilts per ring."""
        return 3 + self.start_centres[1:].size + 2 * self.classes

    @property
    def is_larger(self) -> bool:
        """Whether this is more than the primitive cell with centres in the plane, where they lie in one."""
        return self.repeat != (1, 1) or (self.centres == "space" and self.is_flat)

    @property
    def is_flat(self) -> bool:
        """Whether all centres of the slack pose lie in one plane."""
        return not self.start_centres[:, 2:].any()

    @property
    def centres(self) -> Centres:
        """Where the centres of the rings may be, "plane" or "space"."""
        return "space" if self.start_centres.shape[1] == 3 else "plane"


AnyPattern = TypeVar("AnyPattern", bound=Pattern)


def padded(vectors: Array, d: int = 3) -> Array:
    """Vectors (..., k) as (..., d), k <= d, with further components of 0; a copy."""
    return np.concatenate([vectors, np.zeros((*vectors.shape[:-1], d - vectors.shape[-1]))], axis=-1)


def supercell(weave: AnyPattern, nx: int, ny: int, centres: str = "plane") -> AnyPattern:
    """The same weave with nx x ny independent primitive cells in one lattice cell, centres in the plane or in space,
    and always in space where they lie in no plane: ring (class k, cell ix, iy) gets the class k + K (ix + nx iy).
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
    centres_of = weave.start_centres
    places = np.array([np.append(c[:2] + ix * a1 + iy * a2, c[2:]) for ix, iy in cells for c in centres_of])
    return replace(
        weave,
        pairs=np.array(pairs),
        linked=np.repeat(weave.linked, len(cells)),
        rings=np.array([(k, i, j) for k in range(count * nx * ny) for i in range(2) for j in range(2)]),
        start_lattice=np.array([nx * x2, ny * y3, t]),
        start_centres=padded(places) if centres == "space" else places,
        start_normals=np.tile(weave.start_normals, (len(cells), 1)),
        radii=np.tile(weave.radii, len(cells)),
        wires=np.tile(weave.wires, len(cells)),
        repeat=(nx * weave.repeat[0], ny * weave.repeat[1]),
    )
