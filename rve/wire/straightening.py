"""One ring drawn to a string: the exact rigid-plastic path under equal forces in its plane, m of them, evenly spread.

By symmetry half a sector of h = pi/m is looked at, from a force to the middle between two. An arc of it turns by psi
about a hinge at the force. The other hinge travels from the middle towards the force and leaves straight wire behind,
R psi of it, square to the middle's radius: what turned further would shorten the way. So

    reach = R (psi + sin(h - psi)) / sin h,    force = 4 M_p/R sin h / (1 - cos(h - psi)),    work = 4 m M_p psi,

from the circle at the collapse load to the polygon of a string at psi = h. The work is 4 pi M_p there, for every m.
"""

from dataclasses import dataclass

import numpy as np

from rve.common import Array, ByValue, InputError
from rve.wire.strength import BENDING


@dataclass(frozen=True, eq=False)
class StraightenedRing(ByValue):
    """From circle to string, (k,) each: reach in mm of the forces from the centre, each force in N, work of all of them
    in N mm. The force grows beyond bounds towards the end, at which it is infinite."""

    reach_mm: Array
    force_N: Array
    work_Nmm: Array


def straightened_ring(
    r1: float, r2: float, yield_N_per_mm2: float, forces: int = 2, steps: int = 200
) -> StraightenedRing:
    """The path of a ring of radius r1 and wire radius r2 in mm under so many forces, 2 or more.

    >>> path = straightened_ring(5.0, 0.5, 235.0)
    >>> path.force_N[:1].round(2), path.reach_mm[-1:].round(4)  # collapse; half of half the circumference
    (array([31.33]), array([7.854]))
    """
    if forces < 2:
        raise InputError(f"forces = {forces}: a ring is drawn by two or more")
    h, moment = np.pi / forces, BENDING * r2**3 * yield_N_per_mm2
    psi = h * np.linspace(0.0, 1.0, steps)
    with np.errstate(divide="ignore"):
        force = 4.0 * moment / r1 * np.sin(h) / (1.0 - np.cos(h - psi))
    return StraightenedRing(r1 * (psi + np.sin(h - psi)) / np.sin(h), force, 4.0 * forces * moment * psi)
