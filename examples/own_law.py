"""A law of one's own: a woven fabric whose warp and weft straighten at two stretches and turn freely where they cross.

python examples/own_law.py woven.json
python -m macro_fem run SCENE --law woven.json --plugin examples/own_law.py --out FOLDER
"""

import sys
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import homogenize
from homogenize.laws import HalfSpaces

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class WovenLaw(homogenize.Law, kind="woven"):
    """Warp along x, weft along y, taut at the stretches `warp` and `weft`; line loads beyond by `stiffness`, N/mm."""

    warp: float
    weft: float
    stiffness: float = 500.0

    def half_spaces(self) -> HalfSpaces:
        """E11 and E22 are at most (stretch^2 - 1)/2. All else follows from these two."""
        limits = 0.5 * (np.array([self.warp, self.weft]) ** 2 - 1.0)
        return HalfSpaces(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), limits)

    @property
    def compliance(self) -> Array:
        """Strain per line load beyond the limits, mm/N; leave it out for a fabric that does not stretch."""
        return np.eye(3) / self.stiffness

    def support(self, S: Array) -> Array:
        """max S:E, where the fabric is folded to a line along one diagonal. The default is the same to 1e-4."""
        drawn = S[:, 0] * self.warp**2 + 2.0 * np.abs(S[:, 1]) * self.warp * self.weft + S[:, 2] * self.weft**2
        return np.asarray(0.5 * (drawn - S[:, 0] - S[:, 2]))


if __name__ == "__main__":
    WovenLaw(warp=1.02, weft=1.08, areal_mass_kg_per_m2=0.9).save(sys.argv[1])
