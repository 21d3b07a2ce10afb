"""What files say of the rings: radii, reference cell, density, mass, joint; their checks, and the mass that follows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from msgspec import Meta

from rve.common.errors import InputError, shown
from rve.common.typed import read_entry

STEEL_KG_PER_MM3 = 7.85e-6
LEAST_R1_MM, MOST_R1_MM = 0.1, 200.0
"""Radii of rings that a command takes: from jewellery to anti-submarine nets."""
Length = Annotated[float, Meta(ge=1e-9, le=1e9, title="mm")]
"""Lengths of rings in mm: their powers must stay numbers."""
Density = Annotated[float, Meta(ge=1e-12, le=1e3, title="kg/mm3")]
"""kg/mm3."""
ArealMass = Annotated[float, Meta(gt=0.0, le=1e18, title="kg/m2")]
RING_TYPES: dict[str, Any] = {
    "r1_mm": Length,
    "r2_mm": Length,
    "b_x_mm": Length,
    "b_y_mm": Length,
    "density_kg_per_mm3": Density,
    "areal_mass_kg_per_m2": ArealMass,
}
DensityPerM3 = Annotated[float, Meta(ge=100.0, le=30_000.0, title="kg/m3")]
"""Densities a user may ask for: 7.85 would be g/cm3, 7.85e-6 kg/mm3."""


def check_ring_size(r1: float, option: str) -> None:
    """InputError for rings outside 0.1 to 200 mm, with the value in mm where metres were probably meant.

    >>> check_ring_size(0.006, "--r1")
    Traceback (most recent call last):
    ...
    rve.common.errors.InputError: --r1 = 0.006: rings are from 0.1 to 200 mm; lengths are in mm, did you mean 6?
    """
    if not LEAST_R1_MM <= r1 <= MOST_R1_MM:
        hint = f"; lengths are in mm, did you mean {1e3 * r1:g}?" if LEAST_R1_MM <= 1e3 * r1 <= MOST_R1_MM else ""
        raise InputError(f"{option} = {r1:g}: rings are from {LEAST_R1_MM:g} to {MOST_R1_MM:g} mm{hint}")


def check_rings(table: Mapping[str, Any], where: object) -> dict[str, float]:
    """The numbers of `RING_TYPES` that `table` holds, by name; `where` names file and table.

    InputError for a number out of its range, wire as thick as its ring, or a side of the reference cell that is less
    than the radius of the wire or more than four rings side by side.

    >>> check_rings({"r1_mm": 5, "r2_mm": 0.5, "weave": "4-in-1"}, "law.json: cell")
    {'r1_mm': 5.0, 'r2_mm': 0.5}
    """
    values = {key: read_entry(table, key, kind, str(where)) for key, kind in RING_TYPES.items() if key in table}
    if not {"r1_mm", "r2_mm"} <= values.keys():
        return values
    r1, r2 = values["r1_mm"], values["r2_mm"]
    if not r2 < r1:
        raise InputError(f"{where} r2_mm = {r2:g}: must be less than r1_mm = {r1:g}")
    for key in {"b_x_mm", "b_y_mm"} & values.keys():
        if not r2 <= values[key] <= 8.0 * r1:
            limits = f"from r2_mm = {r2:g} to 8 r1_mm = {8.0 * r1:g}"
            raise InputError(f"{where} {key} = {values[key]:g}: must be {limits} for these rings")
    return values


def ring_volume(r1_mm: float, r2_mm: float) -> float:
    """Volume of one ring, a torus, in mm3."""
    return 2.0 * math.pi**2 * r1_mm * r2_mm**2


def gyration_radius(r1_mm: Any, r2_mm: Any) -> Any:
    """The radius of gyration in mm of a ring about a diameter; of many if radii are arrays.

    >>> round(gyration_radius(5.0, 0.5), 6)
    3.557562
    """
    return (r1_mm**2 / 2.0 + 5.0 * r2_mm**2 / 8.0) ** 0.5


def areal_mass(r1_mm: float, r2_mm: float, area_mm2: float, density_kg_per_mm3: float) -> float:
    """Mass of rings over their reference area in kg/m2; area_mm2: reference area of one ring.

    >>> round(areal_mass(5.0, 0.5, 11.0 * 12.646069623526 / 2, STEEL_KG_PER_MM3), 4)
    2.7848
    """
    return 1e6 * density_kg_per_mm3 * ring_volume(r1_mm, r2_mm) / area_mm2


@dataclass(frozen=True)
class Joint:
    """How the wire of a ring is closed.

    name: "welded", "butted:worst" or "butted:ANGLE". angles_deg: angles at which a butted ring may be open, in degrees
    around the ring from the grain, counterclockwise as seen from the front; () for a welded ring.
    """

    name: str
    angles_deg: tuple[float, ...]

    @staticmethod
    def of(value: Any, where: str = "joint") -> Joint:
        """The joint of a name; "butted" is "butted:worst". InputError, which begins with `where`, for other names.

        A stated angle stands for its mirror image as well: a ring may be woven with either side to the front.

        >>> Joint.of("butted:30").angles_deg
        (30.0, -30.0)
        >>> len(Joint.of("butted").angles_deg)
        36
        """
        kind, _, angle = str(value).partition(":")
        if value == "welded":
            return Joint("welded", ())
        if value in ("butted", "butted:worst"):
            return Joint("butted:worst", tuple(float(x) for x in range(0, 360, WORST_STEP_DEG)))
        try:
            degrees = float(angle) if kind == "butted" else math.nan
        except ValueError:
            degrees = math.nan
        if not -360.0 <= degrees <= 360.0:
            known = "welded, butted:worst or butted:ANGLE with degrees from the grain, -360 to 360"
            raise InputError(f"{where} = {shown(value)}: is not {known}")
        return Joint(f"butted:{degrees:g}", (degrees, -degrees) if degrees % 180.0 else (degrees,))


WORST_STEP_DEG = 10
"""Step of the angles at which a joint is tried for the worst one: the stress is the same for all joints between two
neighbouring contacts, so that only one between contacts nearer than the step is left out."""
