"""The mesh: radii, weave, grain and density; with its reference state, which strains refer to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from msgspec import Meta

from rve.common import InputError, Typed, shown
from rve.common.cell_fields import ArealMass, Density, Length, areal_mass, check_rings, ring_volume
from rve.common.materials import STEEL, Material, named_material
from rve.common.ring_sizes import RING_SIZES, radii_of
from rve.common.typed import read_typed
from rve.geometry.pattern import Centres, supercell
from rve.geometry.weave import FOUR_IN_ONE, WEAVES, Drawing, Weave, drawing_of, named_weave, woven

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
    independently, and centres: "plane" or "space", where the centres of rings may be ("space" for a weave that has them
    in no plane); `rve.solve_table` and `rve.support` look for the largest work there. All else is of the primitive cell
    with centres in the plane, where they lie in one.
    `density` is the material's; one that is given is that of steel, of which no other material is named. InputError for
    values out of range, for wire too thick for the weave, and for a material with another density than the one given.

    >>> Cell(material="steel 1.4404").density, Cell(density=8e-6).material.density_kg_per_mm3
    (8e-06, 8e-06)
    """

    r1: Length = 5.0  # of the weave's first ring; its others are in proportion
    r2: Length = 0.5
    weave: Weave = FOUR_IN_ONE  # or its name
    grain: Literal["y", "x"] = "y"
    density: Density = OF_STEEL
    material: Material = STEEL  # or its name, which __post_init__ replaces
    cells: tuple[CellCount, CellCount] = (1, 1)
    centres: Centres = "plane"

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
        if not self.weave.is_flat:
            object.__setattr__(self, "centres", "space")
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

    @classmethod
    def of(cls, *, weave: Weave | str = FOUR_IN_ONE, **sizes: Any) -> Self:
        """The mesh of a ring as makers write it, by two of `inner`, `outer`, `wire` (diameters in mm), `ar` (inner over
        wire), `gauge` ("16 awg", "16 swg"), `r1` and `r2`; all else as in `Cell`.

        InputError for sizes that are too few, contradict each other, or make no mesh.

        >>> Cell.of(inner=8, wire=1.6, weave="4-in-1").r1, Cell.of(ar=9, wire=1).r1
        (4.8, 5.0)
        """
        known = {name: sizes.pop(name) for name in RING_SIZES if name in sizes}
        return cls(*radii_of(known), weave=weave, **sizes)  # type: ignore[arg-type]

    def check(self) -> None:
        """InputError where the wire is too thick."""
        limit = self.weave.jamming_ratio
        if not self.r1 / self.r2 > limit:
            hint = "; r1 is the radius of the ring, r2 that of the wire" if self.r1 < self.r2 else ""
            self.refuse(
                f"r2 = {self.r2:g}: too thick for the {self.weave.name} weave, which jams at r1/r2 = {limit:.4f} "
                f"(AR {limit - 1.0:.3f}); here r1/r2 = {self.r1 / self.r2:.4f}{hint}"
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
        """Whether more is asked for than the primitive cell with centres in the plane, where they lie in one."""
        return self.cells != (1, 1) or (self.centres == "space" and self.weave.is_flat)

    @property
    def bound_note(self) -> str:
        """Why the work found in this cell is no bound for the mesh, "" where it is, as far as is known."""
        limit = self.weave.planar_ratio
        if self.r1 / self.r2 <= limit or (self.centres == "space" and self.cells[0] > 1):
            return ""
        if not limit:
            return (
                f"whether {self.weave.name} does more work under some loads where its rings leave the plane or its "
                "cells differ was not tried: --cells 2x2 --centres space tells"
            )
        return (
            f"{self.weave.name} with r1/r2 above {limit:g} does more work under some loads where its rings leave the "
            "plane: these strains are no bound; --cells 2x2 --centres space finds those states"
        )

    @property
    def drawing(self) -> Drawing | None:
        """The rings of a weave that is not in the catalogue, in its slack pose."""
        weave = self.weave
        return None if WEAVES.get(weave.name) == weave else weave.drawing(self.r1, self.r2)

    @property
    def wire(self) -> float:
        """r2/r1."""
        return self.r2 / self.r1

    @property
    def ring_mass(self) -> float:
        """Mass of one ring of radius r1 and wire r2 in kg; those of the classes are `weave.masses` times that."""
        return self.density * ring_volume(self.r1, self.r2)


@dataclass(frozen=True)
class CellInfo(Typed):
    """The rings behind a table or a law, and the cell that their strains refer to; in mm and kg/m2.

    b_x_mm, b_y_mm: sides of the reference cell, one primitive cell, chosen by `reference` (`rve.DirectOptions`).
    weave, grain: see `Cell`; the weave is None where a file does not name one. material: None where it is not known.
    drawing: the rings of a weave that is not in the catalogue.

    >>> CellInfo.of(Cell(), (11.0, 12.646069623526)).cell() == Cell()
    True
    """

    r1_mm: Length
    r2_mm: Length
    b_x_mm: Length
    b_y_mm: Length
    areal_mass_kg_per_m2: ArealMass
    weave: str | None = FOUR_IN_ONE.name
    grain: Literal["y", "x"] = "y"
    reference: Literal["side-by-side", "locked"] = "side-by-side"
    material: Material | None = None
    drawing: Drawing | None = None

    @classmethod
    def of(
        cls, cell: Cell, sides_mm: tuple[float, float], reference: Literal["side-by-side", "locked"] = "side-by-side"
    ) -> CellInfo:
        """The rings of a cell whose reference state has these sides b_x, b_y."""
        weave, (b_x, b_y) = cell.weave, sides_mm
        area = b_x * b_y * weave.repeat[0] * weave.repeat[1] / float(weave.masses.sum())  # of a ring r1, r2
        mass = areal_mass(cell.r1, cell.r2, area, cell.density)
        named = weave.name, cell.grain, reference, cell.material, cell.drawing
        return cls(cell.r1, cell.r2, b_x, b_y, mass, *named)

    @property
    def sides_mm(self) -> tuple[float, float]:
        """b_x and b_y."""
        return self.b_x_mm, self.b_y_mm

    @property
    def pattern(self) -> Weave | None:
        """The weave; None where it is not known."""
        return WEAVES.get(str(self.weave)) if self.drawing is None else woven(self.drawing, is_slack=True)

    @property
    def is_mirrored(self) -> bool:
        """Whether the weave is its own mirror image; a weave that is not known counts as chiral."""
        return self.pattern is not None and self.pattern.is_mirrored

    def cell(self) -> Cell:
        """The mesh of these rings, of steel if their material is not known; InputError if their weave is not known."""
        weave = self.pattern
        if weave is None:
            raise InputError(
                f"a reference cell of {self.b_x_mm:g} x {self.b_y_mm:g} mm is of no known weave, r1 = {self.r1_mm:g}, "
                f"r2 = {self.r2_mm:g} mm; make table and law again with rve table and homogenize fit"
            )
        return Cell(self.r1_mm, self.r2_mm, weave, self.grain, material=self.material or STEEL)

    def check_same(self, other: CellInfo, where: str, name: str) -> None:
        """InputError if `other` are rings of another weave or shape, of any size; `where` names them, `name` these."""
        shapes = [np.array([one.r2_mm, *one.sides_mm]) / one.r1_mm for one in (other, self)]
        # Relative difference of radii and reference cells that count as the same.
        if np.abs(np.subtract(*shapes)).max() <= 1e-6:
            return
        if other.weave and self.weave and (other.weave, other.grain) != (self.weave, self.grain):
            weaves = [f"the weave {one.weave} with grain {one.grain}" for one in (other, self)]
            raise InputError(f"{where}: has {weaves[0]}, {name} {weaves[1]}; give both the same one")
        given, own = (", ".join(f"{x:.6g}" for x in shape) for shape in shapes)
        raise InputError(f"{where}: r2, b_x and b_y over r1 are {given}, those of {name} are {own}")


def read_cell_info(record: Mapping[str, Any], where: str) -> CellInfo:
    """The rings that a file tells: the fields of a `CellInfo`, in a record with others; `where` names file and table.

    By default of the 4-in-1 weave, with grain y, side by side; without an areal mass it is that of `density_kg_per_mm3`
    or of steel. InputError for sizes that are missing and values out of range.
    """
    sizes = check_rings(record, where)
    if missing := [key for key in ("r1_mm", "r2_mm", "b_x_mm", "b_y_mm") if key not in sizes]:
        raise InputError(f"{where} {missing[0]}: is missing")
    metal = record.get("material")
    material = None if metal is None else read_typed(Material, metal, f"{where} material")
    density = sizes.pop("density_kg_per_mm3", STEEL.density_kg_per_mm3)
    words = {key: record[key] for key in ("weave", "grain", "reference") if key in record}
    if record.get("drawing") is not None:
        words["drawing"] = drawing_of(record["drawing"], f"{where} drawing:")
    info = read_typed(CellInfo, {"areal_mass_kg_per_m2": 1.0} | sizes | words | {"material": material}, where)
    if "areal_mass_kg_per_m2" in sizes:
        return info
    pattern = info.pattern
    rings = 2.0 if pattern is None else float(pattern.masses.sum())  # of the mass of one
    mass = areal_mass(info.r1_mm, info.r2_mm, info.b_x_mm * info.b_y_mm / rings, density)
    return replace(info, areal_mass_kg_per_m2=mass)


def weave_sides(cell: Cell, sides_mm: tuple[float, float]) -> tuple[float, float]:
    """Sides in r1, along the weave's axes, of the whole cell of `cell.weave`, for reference sides b_x, b_y in mm."""
    (b_x, b_y), (nx, ny) = sides_mm, cell.weave.repeat
    first, second = (b_y, b_x) if cell.grain == "x" else (b_x, b_y)
    return first * nx / cell.r1, second * ny / cell.r1


def weave_axes(cell: Cell) -> slice:
    """Picks the components of a triple in the order of the weave's axes, and back."""
    return slice(None, None, -1 if cell.grain == "x" else 1)
