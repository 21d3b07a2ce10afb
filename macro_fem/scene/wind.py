"""Wind as a pressure: that of a speed, by the drag of a screen with the solidity of the rings.

p = C_D rho v^2 / 2 per area of the front, with C_D of a free-standing porous plate (K. Steiros, M. Hultmark, J. Fluid
Mech. 853 (2018) R3, equations 2.12 and 2.15). With the open share beta = 1 - solidity, the resistance k = 1/beta^2 - 1
and the speed u of the air in the plane of the plate over that of the wind,

    C_D = 4/3 (1 - u)(2 + u)/(2 - u) = k u^2 - 4/3 (1 - u)^3/(2 - u)^2.

n layers of solidity s behind each other are one screen of solidity 1 - (1 - s)^n on the front that they share.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from homogenize import CellInfo
from macro_fem.scene.tables import Wind
from rve import cell_of_sides
from rve import solidity as solidity_of
from rve.common import Array

AIR_DENSITY = 1.25
"""kg/m3, the recommended value of EN 1991-1-4:2005, 4.5 (1), note 2."""
SOLID = 4.0 / 3.0
"""C_D of a plate without holes."""
BREEZE = 1.0
"""m/s, the speed of `breeze` in still air; forces of moving nodes are this one's, scaled."""
HALVINGS = 60
"""Halvings of the interval of u, after which it is known to rounding."""


def dynamic_pressure(wind: Wind) -> float:
    """rho v^2 / 2 of a wind with a speed, N/mm2."""
    assert wind.speed is not None
    return 0.5e-6 * (AIR_DENSITY if wind.air_density is None else wind.air_density) * wind.speed**2


def breeze(wind: Wind) -> Wind:
    """The wind, with the speed BREEZE in place of one that is 0 now, in whose still air the mesh moves."""
    return wind if wind.speed is None else replace(wind, speed=wind.speed or BREEZE)


def wind_pressure(wind: Wind, cell: CellInfo | None) -> float:
    """Pressure on one flat layer square to the wind, N/mm2."""
    if wind.speed is None:
        assert wind.pressure is not None
        return 1e-6 * wind.pressure
    return dynamic_pressure(wind) * float(layered_drag(cell, np.ones(1))[0])


def layered_solidity(solidity: float, layers: Array) -> Array:
    """Solidity (k,) of `layers` (k,), not necessarily whole, of one solidity behind each other."""
    return np.asarray(1.0 - (1.0 - solidity) ** layers)


def layered_drag(cell: CellInfo | None, layers: Array) -> Array:
    """C_D (k,) per area of a front of `layers` (k,) of the rings of a law."""
    assert cell is not None  # see `nodal_forces`
    return drag_coefficient(layered_solidity(ring_solidity(cell), layers))


@lru_cache(maxsize=8)
def ring_solidity(cell: CellInfo) -> float:
    """Projected area of the rings of a law over the reference area, see `rve.solidity`."""
    return solidity_of(cell_of_sides(cell.r1_mm, cell.r2_mm, (cell.b_x_mm, cell.b_y_mm)))


def drag_coefficient(solidity: Array | float) -> Array:
    """C_D (...) of free-standing screens, per total area, from 0 (nothing there) to 4/3 (solid); see the module header.

    >>> drag_coefficient(np.array([0.8, 0.7, 0.5, 0.3])).round(2).tolist()
    [1.29, 1.22, 1.0, 0.64]
    """
    open_2 = np.clip(1.0 - np.asarray(solidity), 0.0, 1.0) ** 2
    low, high = np.zeros_like(open_2), np.ones_like(open_2)
    for _ in range(HALVINGS):
        u = 0.5 * (low + high)
        # both formulas of C_D are equal where C_D + 4/3 (1 - u)^3/(2 - u)^2, here times (2 - u)^2, is k u^2
        is_left = open_2 * SOLID * (1.0 - u) * (5.0 - 2.0 * u) > (1.0 - open_2) * (u * (2.0 - u)) ** 2
        low, high = np.where(is_left, u, low), np.where(is_left, high, u)
    return np.where(open_2 < 1.0, SOLID * (1.0 - u) * (2.0 + u) / (2.0 - u), 0.0)
