"""Wind as a pressure: that of a speed, by the drag of a screen with the solidity of the rings.

p = C_D rho v^2 / 2 per reference area, along the direction of the wind. C_D is that of a free-standing porous plate
that the air flows through and around (K. Steiros, M. Hultmark, Drag on flat plates of arbitrary porosity, J. Fluid
Mech. 853 (2018) R3, doi 10.1017/jfm.2018.621, equations 2.12 and 2.15). With the open share beta = 1 - solidity,
the resistance k = 1/beta^2 - 1 (G. I. Taylor, R. M. Davies, The aerodynamics of porous sheets, ARC R&M 2237, 1944) and
the speed u of the air in the plane of the plate over that of the wind, both of

    C_D = 4/3 (1 - u)(2 + u)/(2 - u),        C_D = k u^2 - 4/3 (1 - u)^3/(2 - u)^2

hold. It is 4/3 of a solid plate, and was compared with measurements down to beta = 0.23; k is that of sharp-edged
holes, which round wires stay below. Where the mesh closes an opening, the air cannot flow around it: give
`drag_coefficient`.
"""

from __future__ import annotations

from functools import lru_cache

from scipy.optimize import brentq

from homogenize import CellInfo
from macro_fem.scene.schema import Scene
from macro_fem.scene.tables import Wind
from rve import cell_of_sides
from rve import solidity as solidity_of
from rve.common.errors import InputError

AIR_DENSITY = 1.25
"""kg/m3, the recommended value of EN 1991-1-4:2005, 4.5 (1), note 2."""


def wind_pressure(wind: Wind, cell: CellInfo | None, where: str) -> float:
    """Pressure of the wind in N/mm2 of reference area; InputError, which begins with `where`, without rings."""
    if wind.speed is None:
        assert wind.pressure is not None
        return 1e-6 * wind.pressure
    density = AIR_DENSITY if wind.air_density is None else wind.air_density
    return 0.5e-6 * _drag(wind, cell, where) * density * wind.speed**2


def _drag(wind: Wind, cell: CellInfo | None, where: str) -> float:
    if wind.drag_coefficient is not None:
        return wind.drag_coefficient
    if cell is None:
        raise InputError(
            f"{where} speed = {wind.speed:g}: the law has no rings to tell the drag; give drag_coefficient"
        )
    return drag_coefficient(ring_solidity(cell))


def wind_summary(scene: Scene, cell: CellInfo | None) -> dict[str, list[dict[str, float]]]:
    """What winds with a speed press with, and by which drag; nothing without them."""
    found = []
    for wind in scene.load.wind:
        if wind.speed is not None:
            told = {"solidity": ring_solidity(cell)} if wind.drag_coefficient is None and cell is not None else {}
            where = f"{scene.source}: [load.wind]"
            pressure = 1e6 * wind_pressure(wind, cell, where)
            told |= {"drag_coefficient": _drag(wind, cell, where), "pressure_N_per_m2": pressure}
            found.append({"speed_m_per_s": wind.speed} | told)
    return {"wind": found} if found else {}


@lru_cache(maxsize=8)
def ring_solidity(cell: CellInfo) -> float:
    """Projected area of the rings of a law over the reference area, see `rve.solidity`."""
    return solidity_of(cell_of_sides(cell.r1_mm, cell.r2_mm, (cell.b_x_mm, cell.b_y_mm)))


def drag_coefficient(solidity: float) -> float:
    """C_D of a free-standing screen, per total area, from 0 (nothing there) to 4/3 (solid); see the module header.

    >>> [round(drag_coefficient(1.0 - beta), 2) for beta in (0.2, 0.3, 0.5, 0.7)]
    [1.29, 1.22, 1.0, 0.64]
    """
    beta = 1.0 - solidity
    if beta >= 1.0:
        return 0.0
    if beta <= 0.0:
        return 4.0 / 3.0

    def excess(u: float) -> float:
        through = u**2 * (1.0 / beta**2 - 1.0) - 4.0 / 3.0 * (1.0 - u) ** 3 / (2.0 - u) ** 2
        return _drag_at(u) - through

    return _drag_at(float(brentq(excess, 0.0, 1.0, xtol=1e-14)))


def _drag_at(u: float) -> float:
    return 4.0 / 3.0 * (1.0 - u) * (2.0 + u) / (2.0 - u)
