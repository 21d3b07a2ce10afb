"""A load of one's own, and a material: wet dirt in the lowest part of a curtain of a wire that is not listed.

python -m macro_fem run SCENE --plugin examples/own_load.py --out FOLDER

    [load.dirt]
    pressure = 40.0
    height = 300.0

    [material]
    material = "wire of my mill"
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import rve
from macro_fem import Load

Array = NDArray[np.float64]
rve.MATERIALS["wire of my mill"] = rve.Material(
    "wire of my mill", density_kg_per_mm3=7.9e-6, young_N_per_mm2=190e3, yield_N_per_mm2=820.0, ultimate_N_per_mm2=None
)


@dataclass(frozen=True)
class Dirt(Load, kind="dirt"):
    """A weight of `pressure` N/m2 at y = 0 that fades evenly up to `height` mm.

    Load combinations and histories scale `pressure`; a load along an edge has a field `edge`, and `per_length`.
    """

    pressure: float
    height: float

    def per_area(self, X: Array) -> Array:
        """Force per area of the flat sheet (n, 2), N/mm2, at its points X (n, 2), mm."""
        share = np.clip(1.0 - X[:, 1] / self.height, 0.0, 1.0)
        return np.column_stack([np.zeros(len(X)), -1e-6 * self.pressure * share])
