"""Materials of rings: density, elastic constants and strength once, with units, and a short table of named ones.

Strengths are the least values of the standards for hot-rolled or annealed products. Drawn wire may be two or three
times as strong, and the weld of a ring weaker than its wire: take the values of the certificate of the wire at hand.
Elastic constants are the nominal values of the standards; measured ones differ by some 3 % (titanium: 102 to 110
kN/mm2, Poisson's ratio 0.32 to 0.37, in data sheets).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from rve.common.errors import InputError
from rve.common.rings import DENSITY_KG_PER_M3, LEAST_KG_PER_MM3, MOST_KG_PER_MM3, STEEL_KG_PER_MM3
from rve.common.values import Check, checked, entry, finite, optional, read_record, shown, shown_key, string

YOUNG = finite(least=500.0, most=2e6)
"""N/mm2: from soft plastics to diamond. Values in GPa (steel 210, tungsten 411) are below and refused."""
POISSON = finite(least=0.0, most=0.5)
STRESS = finite(above=0.0, most=2e4)
_DENSITY = finite(least=LEAST_KG_PER_MM3, most=MOST_KG_PER_MM3)


@dataclass(frozen=True)
class Material:
    """A material: name, density in kg/mm3, Young's modulus, yield and ultimate stress in N/mm2, Poisson's ratio.

    Yield and ultimate stress may be unknown, None. `check_material` finds numbers that no material has.
    """

    name: str = entry(lambda value: str(value), "steel")
    density_kg_per_mm3: float = entry(_DENSITY, STEEL_KG_PER_MM3)
    young_N_per_mm2: float = entry(YOUNG, 210e3)
    poisson: float = entry(POISSON, 0.3)
    yield_N_per_mm2: float | None = entry(optional(STRESS), 235.0)
    ultimate_N_per_mm2: float | None = entry(optional(STRESS), 360.0)

    def __post_init__(self) -> None:
        """InputError for numbers out of range, and for an ultimate stress below the yield stress."""
        checks = {name: field.metadata["check"] for name, field in self.__dataclass_fields__.items() if name != "name"}
        for name, check in checks.items():
            checked(vars(self), name, check, f"material {self.name!r}:")
        low, high = self.yield_N_per_mm2, self.ultimate_N_per_mm2
        if low is not None and high is not None and high < low:
            raise InputError(
                f"material {self.name!r}: ultimate_N_per_mm2 = {high:g}: is less than yield_N_per_mm2 = {low:g}"
            )


STEEL = Material()
"""Steel S235, EN 10025-2, up to 16 mm; elastic constants as in EN 1993-1-1, density as all unalloyed steels."""
MATERIALS = {
    material.name: material
    for material in (
        STEEL,
        # EN 10088-1 (density, Young's modulus), EN 10088-3 (least 0.2 % proof and tensile strength, solution annealed).
        Material("steel 1.4301", 7.9e-6, 200e3, 0.3, 190.0, 500.0),
        Material("steel 1.4404", 8.0e-6, 200e3, 0.3, 200.0, 500.0),
        # ASTM B348, grade 2, annealed (least strength); ASM Handbook 2 (density, elastic constants).
        Material("titanium grade 2", 4.51e-6, 105e3, 0.37, 275.0, 345.0),
    )
}
"""Named materials. Strengths are least values of the standards named beside them."""


def named_material(name: str, where: str = "material") -> Material:
    """The material of this name; InputError says which there are.

    >>> named_material("steel 1.4404").young_N_per_mm2
    200000.0
    """
    if name not in MATERIALS:
        raise InputError(
            f"{where} = {shown(name)}: known are {', '.join(MATERIALS)}; or give density, young and poisson"
        )
    return MATERIALS[name]


_KEYS: dict[str, tuple[str, Check]] = {
    "density": ("density_kg_per_mm3", DENSITY_KG_PER_M3),
    "young": ("young_N_per_mm2", YOUNG),
    "poisson": ("poisson", POISSON),
    "yield": ("yield_N_per_mm2", STRESS),
    "ultimate": ("ultimate_N_per_mm2", STRESS),
}


def material_of(given: Mapping[str, Any], where: str = "", prefix: str = "", base: Material = STEEL) -> Material:
    """The material that a user describes: `material` names one; density (kg/m3), young, yield, ultimate (N/mm2) and
    poisson replace its values, or those of `base` if no name is given. Keys with the value None count as absent;
    `prefix` stands before keys in messages.

    A new density or elastic constant keeps the strength of the named material. InputError for values out of range. A
    yield stress above the named ultimate one makes that unknown, None.

    >>> material_of({"material": "steel 1.4404", "yield": 450.0}).yield_N_per_mm2
    450.0
    """
    name = given.get("material")
    base = base if name is None else named_material(name, f"{where} {prefix}material".strip())
    values: dict[str, Any] = {}
    for key, (field, check) in _KEYS.items():
        if given.get(key) is not None:
            values[field] = checked({prefix + key: given[key]}, prefix + key, check, where)
    if "density_kg_per_mm3" in values:
        values["density_kg_per_mm3"] /= 1e9
    low, high = values.get("yield_N_per_mm2", base.yield_N_per_mm2), values.get("ultimate_N_per_mm2")
    if low is not None and high is not None and high < low:
        raise InputError(f"{where} {prefix}ultimate = {high:g}: is less than the yield stress, {low:g}".lstrip())
    strength = values.get("yield_N_per_mm2", 0.0)
    if "ultimate_N_per_mm2" not in values and strength > (base.ultimate_N_per_mm2 or strength):
        values["ultimate_N_per_mm2"] = None
    changed = base.name if not values or base.name.endswith(", changed") else f"{base.name}, changed"
    return replace(base, name=changed, **values)


def described(table: Any, where: str) -> tuple[tuple[str, Any], ...]:
    """Keys and values of a table that describes a material for `material_of`; InputError for what it does not know."""
    if not isinstance(table, dict):
        raise InputError(f"{where} is not a table of names and values")
    known = ("material", *_KEYS)
    for key, value in table.items():
        if key not in known:
            raise InputError(f"{where} {shown_key(key)} = {shown(value)}: unknown key; known are {', '.join(known)}")
    if "material" in table:
        named_material(checked(table, "material", string, where), f"{where} material")
    for key, (_, check) in _KEYS.items():
        if key in table:
            checked(table, key, check, where)
    return tuple(table.items())


def read_material(table: Mapping[str, Any], where: str) -> Material:
    """The material that a file holds, as `dataclasses.asdict` writes it; InputError names file, key and value."""
    try:
        return read_record(Material, table, where)
    except InputError as error:
        text = str(error)
        raise error if text.startswith(where) else InputError(f"{where} {text}") from None
