"""What files say of the rings: radii, reference cell, density, mass, joint; their checks, and the mass that follows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rve.common.errors import InputError
from rve.common.values import BadValue, Check, checked, finite, string

STEEL_KG_PER_MM3 = 7.85e-6
LEAST_MM, MOST_MM = 1e-9, 1e9
"""Lengths of rings: their powers must stay numbers."""
LEAST_KG_PER_MM3, MOST_KG_PER_MM3 = 1e-12, 1e3
_length = finite(least=LEAST_MM, most=MOST_MM)
RING_CHECKS: dict[str, Check] = {
    "r1_mm": _length,
    "r2_mm": _length,
    "b_x_mm": _length,
    "b_y_mm": _length,
    "density_kg_per_mm3": finite(least=LEAST_KG_PER_MM3, most=MOST_KG_PER_MM3),
    "areal_mass_kg_per_m2": finite(above=0.0, most=1e18),
}
DENSITY_KG_PER_M3 = finite(least=100.0, most=30_000.0)
"""Densities a user may ask for: 7.85 would be g/cm3, 7.85e-6 kg/mm3."""


def check_rings(table: Mapping[str, Any], where: object) -> dict[str, float]:
    """The numbers of `RING_CHECKS` that `table` holds, by name; `where` names file and table.

    InputError for a number out of its range, wire as thick as its ring, or a side of the reference cell that such rings
    cannot have: less than the radius of the wire, or more than four rings side by side.

    >>> check_rings({"r1_mm": 5, "r2_mm": 0.5, "weave": "4-in-1"}, "law.json: cell")
    {'r1_mm': 5.0, 'r2_mm': 0.5}
    """
    found = {key: checked(table, key, check, where) for key, check in RING_CHECKS.items() if key in table}
    r1, r2 = found.get("r1_mm"), found.get("r2_mm")
    if r1 is not None and r2 is not None and not r2 < r1:
        raise InputError(f"{where} r2_mm = {r2:g}: must be less than r1_mm = {r1:g}")
    for key in ("b_x_mm", "b_y_mm"):
        side = found.get(key)
        if side is None or r1 is None or r2 is None:
            continue
        if not r2 <= side <= 8.0 * r1:
            raise InputError(
                f"{where} {key} = {side:g}: must be from r2_mm = {r2:g} to 8 r1_mm = {8.0 * r1:g} for these rings"
            )
    _check_mass(found, where)
    return found


def _check_mass(found: Mapping[str, float], where: object) -> None:
    """InputError if areal mass and density contradict each other: a cell holds a whole number of rings."""
    if not RING_CHECKS.keys() <= found.keys():
        return
    r1, r2, b_x, b_y, density, mass = (found[key] for key in RING_CHECKS)
    count = mass / areal_mass(r1, r2, b_x * b_y, density)
    if not 0.5 < count < 1e6 or abs(count - round(count)) > 1e-6 * count:
        raise InputError(
            f"{where} areal_mass_kg_per_m2 = {mass:g}: is that of {count:g} rings of density_kg_per_mm3 = {density:g} "
            "in a cell, not of a whole number of them"
        )


def ring_volume(r1_mm: float, r2_mm: float) -> float:
    """Volume of one ring, a torus, in mm3."""
    return 2.0 * math.pi**2 * r1_mm * r2_mm**2


def areal_mass(r1_mm: float, r2_mm: float, area_mm2: float, density_kg_per_mm3: float) -> float:
    """Mass of rings over their reference area in kg/m2; area_mm2: reference area of one ring.

    >>> round(areal_mass(5.0, 0.5, 11.0 * 12.646069623526 / 2, STEEL_KG_PER_MM3), 4)
    2.7848
    """
    return 1e6 * density_kg_per_mm3 * ring_volume(r1_mm, r2_mm) / area_mm2


@dataclass(frozen=True)
class Joint:
    """How the wire of a ring is closed: `name` as files have it, and where it may be open.

    name: "welded", "butted:worst" or "butted:ANGLE". angles_deg: angles at which a butted ring may be open, in degrees
    around the ring from the grain, counterclockwise as seen from the front; () for a welded ring.
    """

    name: str
    angles_deg: tuple[float, ...]

    @staticmethod
    def of(value: Any) -> Joint:
        """The joint of a name; "butted" is "butted:worst". BadValue (a ValueError) for other names.

        A stated angle stands for its mirror image as well: a ring may be woven with either side to the front, and the
        mirror image of a mesh has its joints there.

        >>> Joint.of("butted:30").angles_deg
        (30.0, -30.0)
        >>> len(Joint.of("butted").angles_deg)
        36
        """
        kind, colon, angle = string(value).partition(":")
        if kind == "welded" and not colon:
            return Joint("welded", ())
        if kind != "butted":
            raise BadValue("is not welded, butted:worst or butted:ANGLE with an angle in degrees from the grain")
        if angle == "worst" or not colon:
            return Joint("butted:worst", tuple(float(x) for x in range(0, 360, WORST_STEP_DEG)))
        try:
            degrees = finite(least=-360.0, most=360.0)(float(angle))
        except ValueError as error:
            raise BadValue("needs an angle from -360 to 360 degrees after butted:, or worst") from error
        return Joint(f"butted:{degrees:g}", (degrees, -degrees) if degrees % 180.0 else (degrees,))


WORST_STEP_DEG = 10
"""Step of the angles at which a joint is tried for the worst one. Free ends carry no load, so that the stress is the
same for all joints between two neighbouring contacts; only one between contacts nearer than the step is left out."""


def joint_name(value: Any) -> str:
    """The name of a joint as files have it: a check as in `rve.common.values`."""
    return Joint.of(value).name
