"""The mesh: radii, weave, grain and density."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal

from msgspec import Meta

from rve.common import Typed, shown
from rve.common.cell_fields import Density, Length, ring_volume
from rve.common.materials import STEEL, Material, named_material
from rve.geometry.weave import FOUR_IN_ONE, Weave, named_weave, supercell

CellCount = Annotated[int, Meta(ge=1, le=4)]
"""Primitive cells on a side of a larger one: 4 x 4 of them have 160 coordinates."""


class OfMaterial(float):
    """A density, kg/mm3, that is its material's: where `dataclasses.replace` names another material, it gives way."""


OF_STEEL = OfMaterial(STEEL.density_kg_per_mm3)


@dataclass(frozen=True)
class Cell(Typed):
    """The mesh: radii in mm, weave, grain ("y" or "x": the interlacing direction; x exchanges the axes, which makes a
    chiral weave its mirror image), density in kg/mm3, material.

    `material` and `weave` may be names. cells: primitive cells along the weave's a1 and a2 whose rings move
    independently, and centres: "plane" or "space", where the centres of rings may be; `rve.solve_table` and
    `rve.support` look for the largest work there. All else is of the primitive cell with centres in the plane.
    `density` is the material's; one that is given is that of steel, of which no other material is named. InputError for
    values out of range, for wire too thick for the weave, and for a material with another density than the one given.

    >>> Cell(material="steel 1.4404").density, Cell(density=8e-6).material.density_kg_per_mm3
    (8e-06, 8e-06)
    """

    r1: Length = 5.0
    r2: Length = 0.5
    weave: Weave = FOUR_IN_ONE  # or its name
    grain: Literal["y", "x"] = "y"
    density: Density = OF_STEEL
    material: Material = STEEL  # or its name, which __post_init__ replaces
    cells: tuple[CellCount, CellCount] = (1, 1)
    centres: Literal["plane", "space"] = "plane"

    def __post_init__(self) -> None:
        given = OF_STEEL if self.density is None else self.density
        metal = STEEL if self.material is None else self.material
        is_named = isinstance(metal, str)
        if not isinstance(metal, str | Material):
            self.refuse(f"material = {shown(metal)}: is no Material, nor the name of one")
        object.__setattr__(self, "density", given)
        object.__setattr__(self, "material", named_material(metal) if isinstance(metal, str) else metal)
        if isinstance(self.weave, str):
            object.__setattr__(self, "weave", named_weave(self.weave))
        super().__post_init__()
        if not isinstance(given, OfMaterial):
            object.__setattr__(self, "material", self._as_dense(is_named))
        object.__setattr__(self, "density", OfMaterial(self.material.density_kg_per_mm3))

    def _as_dense(self, is_named: bool) -> Material:
        """The material with the density that is given; InputError unless it has that one, or is steel by default."""
        metal, theirs = self.material, self.material.density_kg_per_mm3
        is_other = is_named or replace(metal, density_kg_per_mm3=OF_STEEL) != STEEL
        if is_other and self.density != theirs:
            self.refuse(f"density = {self.density:g}: {metal.name} has {theirs:g} kg/mm3; give one of the two")
        return replace(metal, density_kg_per_mm3=self.density)

    def check(self) -> None:
        """InputError where the wire is too thick."""
        limit = self.weave.jamming_ratio
        if not self.r1 / self.r2 > limit:
            self.refuse(
                f"r2 = {self.r2}: too thick for the {self.weave.name} weave, which jams at r1/r2 = {limit:.4f}; "
                f"here r1/r2 = {self.r1 / self.r2:.4f}"
            )

    @property
    def stages(self) -> list[Cell]:
        """One row of the larger cell, then all of it; [] for the primitive cell. What one row does is a start for
        several."""
        nx, ny = self.cells
        sizes = [(nx, 1), (nx, ny)] if nx > 1 and ny > 1 else [self.cells] if self.is_larger else []
        plain = replace(self, cells=(1, 1), centres="plane")
        return [replace(plain, weave=supercell(self.weave, *size, self.centres)) for size in sizes]

    @property
    def is_larger(self) -> bool:
        """Whether more than the planar primitive cell is asked for."""
        return self.cells != (1, 1) or self.centres == "space"

    @property
    def bound_note(self) -> str:
        """Why the work found in this cell is no bound for the mesh, "" where it is, as far as is known."""
        limit = self.weave.planar_ratio
        if self.r1 / self.r2 <= limit or (self.centres == "space" and self.cells[0] > 1):
            return ""
        return (
            f"{self.weave.name} with r1/r2 above {limit:g} does more work under some loads where its rings leave the "
            "plane: these strains are no bound; --cells 2x2 --centres space finds those states"
        )

    @property
    def wire(self) -> float:
        """r2/r1."""
        return self.r2 / self.r1

    @property
    def ring_mass(self) -> float:
        """Mass of one ring in kg."""
        return self.density * ring_volume(self.r1, self.r2)


def weave_sides(cell: Cell, sides_mm: tuple[float, float]) -> tuple[float, float]:
    """Sides in r1, along the weave's axes, of the whole cell of `cell.weave`, for reference sides b_x, b_y in mm."""
    (b_x, b_y), (nx, ny) = sides_mm, cell.weave.repeat
    first, second = (b_y, b_x) if cell.grain == "x" else (b_x, b_y)
    return first * nx / cell.r1, second * ny / cell.r1


def weave_axes(cell: Cell) -> slice:
    """Picks the components of a triple in the order of the weave's axes, and back."""
    return slice(None, None, -1 if cell.grain == "x" else 1)
