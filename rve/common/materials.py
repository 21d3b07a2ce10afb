"""Materials of rings: density, elastic constants and strength.

Strengths are the least values of the standards for hot-rolled or annealed products. Drawn wire may be two or three
times as strong, and the weld of a ring weaker than its wire: take the values of the certificate of the wire at hand.
Elastic constants are nominal; data sheets differ by some 3 % (titanium: 102 to 110 kN/mm2, Poisson's ratio 0.32 to
0.37).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any

from msgspec import Meta

from rve.common.cell_fields import STEEL_KG_PER_MM3, Density, DensityPerM3
from rve.common.errors import InputError, shown
from rve.common.plugins import load_installed
from rve.common.typed import Typed, did_you_mean, read_entry, refuse_unknown, types_of

Young = Annotated[float, Meta(ge=500.0, le=2e6, title="N/mm2")]
"""N/mm2: from soft plastics to diamond. Values in GPa (steel 210, tungsten 411) are below and refused."""
Poisson = Annotated[float, Meta(ge=0.0, le=0.5)]
Stress = Annotated[float, Meta(ge=1e-3, le=2e4, title="N/mm2")]


@dataclass(frozen=True)
class Material(Typed):
    """A material: name, density in kg/mm3, Young's modulus, Poisson's ratio, yield and ultimate stress in N/mm2, which
    may be unknown, None. InputError for numbers that no material has."""

    name: str = "steel"
    density_kg_per_mm3: Density = STEEL_KG_PER_MM3
    young_N_per_mm2: Young = 210e3
    poisson: Poisson = 0.3
    yield_N_per_mm2: Stress | None = 235.0
    ultimate_N_per_mm2: Stress | None = 360.0

    def check(self) -> None:
        low, high = self.yield_N_per_mm2, self.ultimate_N_per_mm2
        if low is not None and high is not None and high < low:
            self.refuse(f"ultimate_N_per_mm2 = {high:g}: is less than yield_N_per_mm2 = {low:g}")


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
        # ASTM B348, grade 5 (Ti-6Al-4V), annealed (least strength); ASM data sheet MTP644 (density, elastic constants).
        Material("titanium grade 5", 4.43e-6, 114e3, 0.33, 828.0, 895.0),
        # EN 10270-3, normal strength, wire of 1.75 to 2 mm (least tensile strength: 1900 at 1 mm, 1500 at 4 mm; Young's
        # modulus as drawn). The standard has no yield stress: 70 % of the tensile strength, usual for such wire.
        Material("spring wire 1.4310", 7.9e-6, 185e3, 0.3, 1190.0, 1700.0),
        # EN 754-2, annealed (AlMg5, EN AW-5019); data sheets of wire as drawn for welding (AlMg5Cr, EN AW-5356).
        Material("aluminium EN AW-5019", 2.64e-6, 70e3, 0.33, 110.0, 250.0),
        Material("aluminium EN AW-5356", 2.64e-6, 71e3, 0.33, 110.0, 240.0),
        # EN 12166, CuZn37 (CW508L), eighth hard, thick wire: R370. Thin half-hard wire has up to 510.
        Material("brass CuZn37", 8.44e-6, 110e3, 0.35, 250.0, 370.0),
        # Cu-ETP (CW004A), R240: Wieland K32 (proof and tensile strength, density, elastic constants); annealed copper
        # yields at some 70.
        Material("copper", 8.94e-6, 115e3, 0.34, 180.0, 240.0),
    )
}
"""Named materials. Strengths are least values of the standards named beside them. A plugin adds its own by name."""


def named_material(name: str, where: str = "material") -> Material:
    """The material of this name; InputError says which there are.

    >>> named_material("steel 1.4404").young_N_per_mm2
    200000.0
    """
    if str(name) not in MATERIALS:
        load_installed()
    if str(name) not in MATERIALS:
        known = f"{did_you_mean(name, MATERIALS)}known are {', '.join(MATERIALS)}"
        raise InputError(f"{where} = {shown(name)}: {known}; or give density and young")
    return MATERIALS[name]


_KEYS = {"density": "density_kg_per_mm3", "young": "young_N_per_mm2", "poisson": "poisson"}
_KEYS |= {"yield": "yield_N_per_mm2", "ultimate": "ultimate_N_per_mm2"}


def material_of(given: Mapping[str, Any], where: str = "", prefix: str = "", base: Material = STEEL) -> Material:
    """The material that a user describes: `material` names one; density (kg/m3), young, yield, ultimate (N/mm2) and
    poisson replace its values, or those of `base` if no name is given. Keys with the value None count as absent;
    `prefix` stands before keys in messages.

    A new density or elastic constant keeps the strength of the named material. InputError for other keys and values out
    of range. A yield stress above the named ultimate one makes that unknown, None.

    >>> material_of({"material": "steel 1.4404", "yield": 450.0}).yield_N_per_mm2
    450.0
    """
    refuse_unknown(given, ("material", *_KEYS), where)
    asked = {key: value for key, value in given.items() if value is not None}
    if "material" in asked:
        base = named_material(asked.pop("material"), f"{where} {prefix}material".strip())
    values: dict[str, Any] = {}
    for key in asked:
        kind = DensityPerM3 if key == "density" else types_of(Material)[_KEYS[key]]
        values[_KEYS[key]] = read_entry({prefix + key: asked[key]}, prefix + key, kind, where)
    if "density_kg_per_mm3" in values:
        values["density_kg_per_mm3"] /= 1e9
    low = values.get("yield_N_per_mm2", base.yield_N_per_mm2)
    high = values.get("ultimate_N_per_mm2", base.ultimate_N_per_mm2)
    if low is not None and high is not None and high < low:
        if "ultimate_N_per_mm2" in values:
            raise InputError(f"{where} {prefix}ultimate = {high:g}: is less than the yield stress, {low:g}".lstrip())
        values["ultimate_N_per_mm2"] = None
    changed = base.name if not values or base.name.endswith(", changed") else f"{base.name}, changed"
    return replace(base, name=changed, **values)


def described(table: Any, where: str) -> tuple[tuple[str, Any], ...]:
    """Keys and values of a table that describes a material for `material_of`; InputError for what it does not know."""
    material_of(table, where, base=replace(STEEL, yield_N_per_mm2=None, ultimate_N_per_mm2=None))
    return tuple(table.items())
