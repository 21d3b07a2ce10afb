"""The strength surface of a mesh in the space of line loads, beside the locking surface in the space of strains.

For each load direction it holds the yield stress that the load asks of the wire, over the size S11 + S22 of the line
load: at first yield of the rings and at their plastic collapse. Both are positively homogeneous in S, do not depend on
the yield stress, and are the same for S and its mirror image if the weave is its own mirror image. Beside
them stands the compliance S:D S along each load.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from homogenize.directions import Directions, folds_of, tensile_part
from homogenize.laws.rows import UnitTrace
from rve import StrainTable
from rve.common import Array, Flags, InputError, Rows, Typed, checked, read_entry, read_typed
from rve.common.cell_fields import Joint
from rve.common.materials import Material, Stress
from rve.common.tensor import IDENTITY, WEIGHT, eigenvalues, trace
from rve.geometry import cauchy_line_load

MAKE_AGAIN = "make the table again with rve table --rings, and fit the law again"

Share = Annotated[float, Meta(ge=0.0, le=1e300)]
Loads = Annotated[tuple[tuple[UnitTrace, UnitTrace, UnitTrace], ...], Meta(min_length=1, max_length=1_000_000)]
Strengths = tuple[Annotated[float, Meta(ge=1e-12, le=1e12)], ...]


@dataclass(frozen=True)
class OffGrid(Typed):
    """Relative errors at `rows` rows left out in turn: largest and mean of first yield, collapse and compliance; those
    of the compliance are None where some row has none."""

    rows: Annotated[int, Meta(ge=1, le=1_000_000)]
    first_yield_max: Share
    first_yield_mean: Share
    collapse_max: Share
    collapse_mean: Share
    compliance_max: Share | None = None
    compliance_mean: Share | None = None


@dataclass(frozen=True)
class StrengthEntries(Typed):
    """What a law file holds of the strength, see `Strength`; a compliance that is not known is None."""

    joint: str
    material: dict[str, Any]
    S: Loads
    cauchy: Loads
    first_yield_1_per_mm: Strengths
    collapse_1_per_mm: Strengths
    compliance_mm_per_N: tuple[Share | None, ...]
    error: OffGrid | None = None
    is_mirrored: bool = True

    def check(self) -> None:
        lists = ("S", "cauchy", "first_yield_1_per_mm", "collapse_1_per_mm", "compliance_mm_per_N")
        if len({len(getattr(self, key)) for key in lists}) > 1:
            self.refuse(f"{', '.join(lists)}: differ in length")
        for key, loads in (("S", np.array(self.S)), ("cauchy", np.array(self.cauchy))):
            bad = np.flatnonzero((np.abs(trace(loads) - 1.0) > 1e-9) | (eigenvalues(loads)[0] < -1e-9))
            if len(bad):
                self.refuse(f"{key}: row {bad[0]}, {loads[bad[0]].tolist()}, is no tensile load of unit trace")


@dataclass(frozen=True, eq=False)
class Strength(Rows):
    """Strength of n load directions, linear between them on the triangles of their disc, as is the root of S:D S.

    S (n, 3) of unit trace; cauchy (n, 3): the Cauchy loads of these rows, of unit trace; first_yield, collapse (n,):
    yield stress over S11 + S22, 1/mm; compliance (n,): S:D S in mm/N, nan where it is not known; the
    material of the table; the error between the loads; the joint of the rings; whether the weave is its own mirror
    image, so that every load stands for two.
    """

    S: Array
    cauchy: Array
    first_yield: Array
    collapse: Array
    compliance: Array
    material: Material
    error: OffGrid | None = None
    joint: str = "welded"
    is_mirrored: bool = True

    def utilisation(self, S: Array, yield_N_per_mm2: float | None = None) -> Array:
        """Largest von Mises stress of the rings over the yield stress, (n,), under line loads S (n, 3) in N/mm.

        1 is first yield. Compressive principal values of S count as zero. InputError without a yield stress.
        """
        return self._needed_yield(S, self.first_yield) / self.yield_stress(yield_N_per_mm2)

    def collapse_utilisation(self, S: Array, yield_N_per_mm2: float | None = None) -> Array:
        """Line loads S (n, 3) in N/mm over those at which rings collapse plastically, (n,); see `utilisation`."""
        return self.collapse_at(S) / self.yield_stress(yield_N_per_mm2)

    def collapse_at(self, S: Array) -> Array:
        """The yield stress (n,) in N/mm2 with which line loads S (n, 3) in N/mm are those of collapse."""
        return self._needed_yield(S, self.collapse)

    def compliance_along(self, S: Array) -> Array:
        """S:D S in mm/N at unit trace, (n,), of the directions of S (n, 3): strain beyond locking along S per N/mm.

        Its root is of degree one in S, as strengths are, and linear between the loads.
        """
        rows, weights = self.stretched._loads.at(S / trace(S)[:, None])
        return np.asarray((weights * np.sqrt(self.stretched.compliance[rows])).sum(axis=1) ** 2)

    def extrapolates(self, S: Array) -> Flags:
        """Whether the table has no loads around line loads S (n, 3), (n,): their strength is that of the nearest."""
        return self._loads.extrapolates(_size_and_direction(S)[1])

    def yield_stress(self, asked: float | None = None) -> float:
        """The yield stress in N/mm2: what is asked for, or the material's; InputError if there is none."""
        value = self.material.yield_N_per_mm2 if asked is None else asked
        if value is None:
            raise InputError(f"{self.material.name} has no yield stress: give one in N/mm2")
        return float(read_entry({"yield": value}, "yield", Stress))

    def _needed_yield(self, S: Array, values: Array) -> Array:
        """The yield stress (n,) in N/mm2 that loads S (n, 3) ask for."""
        size, unit = _size_and_direction(S)
        rows, weights = self._loads.at(unit)
        return np.asarray(size * (weights * values[rows]).sum(axis=1))

    @cached_property
    def _loads(self) -> Directions:
        return Directions.of(self.S, self.cauchy, self.is_mirrored)

    @cached_property
    def stretched(self) -> Strength:
        """The same of the loads whose compliance is known."""
        known = np.isfinite(self.compliance) & (self.compliance > 0.0)
        return self.take(known)

    def text(self) -> str:
        """What is known of the error, in one line."""
        head = f"strength of {self.joint} rings of {self.material.name}, {len(self.S)} loads"
        e = self.error
        if e is None:
            return f"{head}; too few to tell its error between them"
        known = {name.replace("_", " "): value for name, value in vars(e).items() if name != "rows"}
        errors = ", ".join(f"{name} {value:.2g}" for name, value in known.items() if value is not None)
        return f"{head}; relative error at {e.rows} rows left out: {errors}"

    def to_dict(self) -> dict[str, Any]:
        return {
            "joint": self.joint,
            "material": asdict(self.material),
            "is_mirrored": self.is_mirrored,
            "S": self.S.tolist(),
            "cauchy": self.cauchy.tolist(),
            "first_yield_1_per_mm": self.first_yield.tolist(),
            "collapse_1_per_mm": self.collapse.tolist(),
            "compliance_mm_per_N": [None if np.isnan(x) else float(x) for x in self.compliance],
            "error": None if self.error is None else asdict(self.error),
        }


def _size_and_direction(S: Array) -> tuple[Array, Array]:
    """The trace (n,) of the tensile parts of loads S (n, 3), and these at unit trace (n, 3), equibiaxial if zero."""
    S = tensile_part(S)
    size = trace(S)
    some = size > 0.0
    return size, np.where(some[:, None], S / np.where(some, size, 1.0)[:, None], 0.5 * IDENTITY)


@checked
def strength_of_table(table: StrainTable) -> Strength | None:
    """The strength of a table with columns of its rings, with its error between rows; None for a table without them.

    InputError if the table does not name its material.
    """
    if table.strength is None or table.compliance is None:
        return None
    if table.cell is None or table.cell.material is None:
        raise InputError("the sidecar file of the table: material: is missing")
    size = trace(table.S)
    good = np.flatnonzero(table.converged & np.isfinite(table.strength).all(axis=1) & (size > 0.0))
    key = np.column_stack([table.alpha_deg, table.beta_deg, table.S])[good]
    good = good[np.unique(key, axis=0, return_index=True)[1]]  # in the order of the grid, each once
    S = table.S[good] / size[good, None]
    along = np.einsum("ni,nij,nj->n", S * WEIGHT, table.compliance[good], S)
    s = cauchy_line_load(table.alpha_deg[good], table.beta_deg[good])
    s = s / trace(s)[:, None]
    (first, last), joint = table.strength[good].T, table.origin.joint or "welded"
    found = Strength(S, s, first, last, along, table.cell.material, joint=joint, is_mirrored=table.is_mirrored)
    return replace(found, error=off_grid(found))


def off_grid(strength: Strength) -> OffGrid | None:
    """Relative errors at loads inside the hull, each left out once with its neighbours kept; None with too few."""
    degree = np.array([[1.0], [1.0], [2.0]])
    values = np.stack([strength.first_yield, strength.collapse, np.sqrt(strength.compliance)])
    errors = []
    with suppress(InputError):  # loads on one side of the equibiaxial one
        for out, keep in folds_of(strength.S, strength.is_mirrored):
            others = Directions.of(strength.S[keep], strength.cauchy[keep], strength.is_mirrored)
            rows, weights = others.at(strength.S[out])
            guess = (weights * values[:, keep][:, rows]).sum(axis=2)
            errors.append(np.abs((guess / values[:, out]) ** degree - 1.0))
    if not errors:
        return None
    most = np.concatenate(errors, axis=1)
    (first, first_mean), (last, last_mean), (along, along_mean) = ((float(x.max()), float(x.mean())) for x in most)
    found = OffGrid(most.shape[1], first, first_mean, last, last_mean)
    return found if np.isnan(along) else replace(found, compliance_max=along, compliance_mean=along_mean)


def read_strength(table: Any, where: str) -> Strength:
    """The strength that `Strength.to_dict` wrote; InputError names file, key and value."""
    found = read_typed(StrengthEntries, table, where)
    strengths = found.first_yield_1_per_mm, found.collapse_1_per_mm, found.compliance_mm_per_N  # None becomes nan
    S, cauchy, first, last, along = (np.array(values, float) for values in (found.S, found.cauchy, *strengths))
    material = read_typed(Material, found.material, f"{where} material")
    joint = Joint.of(table.get("joint", "welded"), f"{where} joint".lstrip()).name
    return Strength(S, cauchy, first, last, along, material, found.error, joint, found.is_mirrored)
