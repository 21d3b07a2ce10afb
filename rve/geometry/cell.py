"""The mesh: radii, weave, grain and density."""

from __future__ import annotations

from dataclasses import dataclass, replace

from rve.common.errors import InputError
from rve.common.materials import STEEL, Material, named_material
from rve.common.rings import STEEL_KG_PER_MM3, Density, Length, ring_volume
from rve.common.texts import as_html
from rve.common.typed import read_entry
from rve.geometry.weave import FOUR_IN_ONE, WEAVES, Weave


@dataclass(frozen=True)
class Cell:
    """The mesh: radii in mm, weave, grain ("y" or "x": the interlacing direction), density in kg/mm3, material.

    `material` and `weave` may be names.
    `density` follows the material, or the material follows a density other than that of steel. Raises InputError for
    radii that are not positive numbers, for wire too thick for the weave, and for two different densities.

    >>> Cell(material="steel 1.4404").density, Cell(density=8e-6).material.density_kg_per_mm3
    (8e-06, 8e-06)
    """

    r1: float = 5.0
    r2: float = 0.5
    weave: Weave = FOUR_IN_ONE  # or its name
    grain: str = "y"
    density: float = STEEL_KG_PER_MM3
    material: Material = STEEL  # or its name, which __post_init__ replaces

    def __post_init__(self) -> None:
        if isinstance(self.material, str):
            object.__setattr__(self, "material", named_material(self.material))
        if isinstance(self.weave, str):
            if self.weave not in WEAVES:
                raise InputError(f"weave = {self.weave!r}: is not one of {', '.join(WEAVES)}")
            object.__setattr__(self, "weave", WEAVES[self.weave])
        for name, kind in (("r1", Length), ("r2", Length), ("density", Density)):
            read_entry(vars(self), name, kind)
        self._agree_on_density()
        if self.grain not in ("x", "y"):
            raise InputError(f"grain = {self.grain!r}: must be x or y")
        limit = self.weave.jamming_ratio
        if not self.r1 / self.r2 > limit:
            raise InputError(
                f"r2 = {self.r2}: too thick for the {self.weave.name} weave, which jams at r1/r2 = {limit:.4f}; "
                f"here r1/r2 = {self.r1 / self.r2:.4f}"
            )

    def _agree_on_density(self) -> None:
        theirs = self.material.density_kg_per_mm3
        if self.density == theirs:
            return
        if self.density == STEEL_KG_PER_MM3:
            object.__setattr__(self, "density", theirs)
        elif theirs == STEEL_KG_PER_MM3:
            object.__setattr__(self, "material", replace(self.material, density_kg_per_mm3=self.density))
        else:
            raise InputError(
                f"density = {self.density:g}: {self.material.name} has {theirs:g} kg/mm3; give one of the two"
            )

    @property
    def wire(self) -> float:
        """r2/r1."""
        return self.r2 / self.r1

    def _repr_html_(self) -> str:
        """What a notebook shows: radii, weave, grain, material and the mass of a ring."""
        known = {"r1_mm": self.r1, "r2_mm": self.r2, "weave": self.weave.name, "grain": self.grain}
        more = {"material": self.material.name, "density_kg_per_mm3": self.density, "ring_mass_kg": self.ring_mass}
        return as_html("Cell", known | more)

    @property
    def ring_mass(self) -> float:
        """Mass of one ring in kg."""
        return self.density * ring_volume(self.r1, self.r2)
