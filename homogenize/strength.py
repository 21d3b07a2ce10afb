"""The strength surface of a mesh in the space of line loads, beside the locking surface in the space of strains.

For each load direction it holds the yield stress that the load asks of the wire, over the size S11 + S22 of the line
load: at first yield of the rings and at their plastic collapse. Both are positively homogeneous in S, do not depend on
the yield stress, and are the same for S and its mirror image if the weave is its own mirror image. Beside
them stands the compliance S:D S along each load.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, Delaunay, QhullError

from rve import cauchy_line_load
from rve.common.errors import InputError
from rve.common.materials import STRESS, Material, read_material
from rve.common.notebook import as_html
from rve.common.rings import joint_name
from rve.common.tensor import IDENTITY, WEIGHT, disc, eigenvalues, mirror, trace
from rve.common.types import Array
from rve.common.values import boolean, checked, mapping, number, numbers, read_record, whole

if TYPE_CHECKING:
    from rve import StrainTable

FOLDS = 5
MAKE_AGAIN = "make the table again with rve table --rings, and fit the law again"
_SAME = 1e-9
"""Loads in the disc closer than this are one load."""
_FLAT = 1e-12
"""Twice the area in the disc below which a triangle holds no load."""
_CHUNK = 500
"""Loads looked up together: 15 MB for the triangles of 190 rows."""


@dataclass(frozen=True)
class OffGrid:
    """Relative errors at `rows` rows left out in turn: largest and mean of the first yield and of the collapse."""

    rows: int = whole(least=1, most=1_000_000)
    first_yield_max: float = number(least=0.0)
    first_yield_mean: float = number(least=0.0)
    collapse_max: float = number(least=0.0)
    collapse_mean: float = number(least=0.0)


@dataclass(frozen=True, eq=False)
class Directions:
    """Load directions as points of the disc, and the triangles between them; with their mirror images if `is_mirrored`.

    slope (2, 3, t), level (3, t): the weights of each triangle's corners at a point x are x slope + level; rows (t, 3):
    the loads at its corners; hull (k, 3): the half-planes around all. Neighbours are neighbours as Cauchy loads, which
    lie on a grid, while S crowds where the cell locks far from its reference.
    """

    slope: Array
    level: Array
    rows: NDArray[np.intp]
    hull: Array
    is_mirrored: bool

    @staticmethod
    def of(S: Array, cauchy: Array, is_mirrored: bool) -> Directions:
        """Those of loads S (n, 3) of unit trace and their Cauchy loads (n, 3); InputError unless they surround the
        equibiaxial load."""
        x, s = disc(S), cauchy
        if is_mirrored:
            x, s = disc(np.vstack([S, mirror(S)])), np.vstack([cauchy, mirror(cauchy)])
        first = np.sort(np.unique(np.round(x / _SAME), axis=0, return_index=True)[1])
        x, s = x[first], s[first]
        try:
            triangles, hull = Delaunay(disc(s / trace(s)[:, None])).simplices, ConvexHull(x).equations
        except (QhullError, ValueError) as error:
            raise InputError("strengths need loads that differ in angle and ratio; these lie on one line") from error
        if hull[:, 2].max() >= 0.0:
            raise InputError("strengths need loads on all sides of the equibiaxial one")
        sides = np.swapaxes(x[triangles[:, :2]] - x[triangles[:, 2:]], 1, 2)
        good = np.abs(np.linalg.det(sides)) > _FLAT
        triangles = triangles[good]
        two = np.linalg.inv(sides[good])
        slope = np.concatenate([two, -two.sum(axis=1, keepdims=True)], axis=1)
        level = np.array([0.0, 0.0, 1.0]) - np.einsum("tij,tj->ti", slope, x[triangles[:, 2]])
        rows = first[triangles] % len(S)
        return Directions(slope.transpose(2, 1, 0).copy(), level.T.copy(), rows, hull, is_mirrored)

    def at(self, S: Array) -> tuple[NDArray[np.intp], Array]:
        """Rows (m, 3) around each load S (m, 3) of unit trace, and their weights (m, 3), which sum to 1.

        A load outside of the hull is drawn towards the equibiaxial one until it lies on it. In a weave that is its own
        mirror image a load and its image have the same weights, though triangles between points on a square may not be
        mirror images.
        """
        x = disc(S)
        if self.is_mirrored:
            x[:, 1] = np.abs(x[:, 1])
        beyond = np.maximum((x @ self.hull[:, :2].T / -self.hull[:, 2]).max(axis=1), 1.0)
        x = x / beyond[:, None]
        rows, weights = np.empty((len(x), 3), dtype=np.intp), np.empty((len(x), 3))
        for start in range(0, len(x), _CHUNK):
            part = slice(start, start + _CHUNK)
            three = x[part, :1, None] * self.slope[0] + x[part, 1:, None] * self.slope[1] + self.level
            best = three.min(axis=1).argmax(axis=1)
            inside = np.maximum(np.take_along_axis(three, best[:, None, None], axis=2)[..., 0], 0.0)
            rows[part], weights[part] = self.rows[best], inside / inside.sum(axis=1, keepdims=True)
        return rows, weights


@dataclass(frozen=True, eq=False)
class Strength:
    """Strength of n load directions, linear between them on the triangles of their disc.

    S (n, 3) of unit trace; cauchy (n, 3): the Cauchy loads of these rows, of unit trace; first_yield, collapse (n,):
    yield stress over S11 + S22, 1/mm; compliance (n,): S:D S in mm/N, nan where a load has no unique strain; the
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
        return self._asked(S, self.first_yield) / self.yield_stress(yield_N_per_mm2)

    def collapse_utilisation(self, S: Array, yield_N_per_mm2: float | None = None) -> Array:
        """Line loads S (n, 3) in N/mm over those at which rings collapse plastically, (n,); see `utilisation`."""
        return self._asked(S, self.collapse) / self.yield_stress(yield_N_per_mm2)

    def compliance_along(self, S: Array) -> Array:
        """S:D S in mm/N at unit trace, (n,), of the directions of S (n, 3): strain beyond locking along S per N/mm."""
        rows, weights = self.stretched._loads.at(S / trace(S)[:, None])
        return np.asarray((weights * self.stretched.compliance[rows]).sum(axis=1))

    def yield_stress(self, asked: float | None = None) -> float:
        """The yield stress in N/mm2: what is asked for, or the material's; InputError if there is none."""
        value = self.material.yield_N_per_mm2 if asked is None else asked
        if value is None:
            raise InputError(f"{self.material.name} has no yield stress: give one in N/mm2")
        return float(checked({"yield": value}, "yield", STRESS, ""))

    def _asked(self, S: Array, values: Array) -> Array:
        """The yield stress (n,) in N/mm2 that loads S (n, 3) ask for."""
        S = tensile_part(S)
        size = trace(S)
        some = size > 0.0
        unit = np.where(some[:, None], S / np.where(some, size, 1.0)[:, None], 0.5 * IDENTITY)
        rows, weights = self._loads.at(unit)
        return np.asarray(size * (weights * values[rows]).sum(axis=1))

    @cached_property
    def _loads(self) -> Directions:
        return Directions.of(self.S, self.cauchy, self.is_mirrored)

    @cached_property
    def stretched(self) -> Strength:
        """The same of the loads whose compliance is known."""
        known = np.isfinite(self.compliance) & (self.compliance > 0.0)
        names = ("S", "cauchy", "first_yield", "collapse", "compliance")
        return replace(self, **{name: getattr(self, name)[known] for name in names})

    def text(self) -> str:
        """What is known of the error, in one line."""
        head = f"strength of {self.joint} rings of {self.material.name}, {len(self.S)} loads"
        e = self.error
        if e is None:
            return f"{head}; too few to tell its error between them"
        return (
            f"{head}; relative error at {e.rows} rows left out: first yield max {e.first_yield_max:.2g}, mean "
            f"{e.first_yield_mean:.2g}; collapse max {e.collapse_max:.2g}, mean {e.collapse_mean:.2g}"
        )

    def _repr_html_(self) -> str:
        """What a notebook shows: rings, error between the loads, and the numbers of the material."""
        return as_html(self.text(), asdict(self.material))

    def to_dict(self) -> dict[str, Any]:
        """The strength as a law file holds it."""
        return {
            "joint": self.joint,
            "material": asdict(self.material),
            "is_mirrored": self.is_mirrored,
            "S": self.S.tolist(),
            "cauchy": self.cauchy.tolist(),
            "first_yield_1_per_mm": self.first_yield.tolist(),
            "collapse_1_per_mm": self.collapse.tolist(),
            "compliance_mm_per_N": [float(x) if np.isfinite(x) else None for x in self.compliance],
            "error": None if self.error is None else asdict(self.error),
        }


def tensile_part(S: Array) -> Array:
    """Line loads S (n, 3) with compressive principal values set to zero.

    >>> tensile_part(np.array([[3.0, 0.0, -1.0], [0.0, 1.0, 0.0]]))
    array([[3. , 0. , 0. ],
           [0.5, 0.5, 0.5]])
    """
    low, high = eigenvalues(S)
    mean, half = 0.5 * (low + high), 0.5 * (high - low)
    top, bottom = np.maximum(high, 0.0), np.maximum(low, 0.0)
    share = 0.5 * (top - bottom) / np.where(half > 0.0, half, 1.0)
    middle = 0.5 * (top + bottom)
    return np.stack([middle + share * (S[:, 0] - mean), share * S[:, 1], middle + share * (S[:, 2] - mean)], axis=1)


def strength_of_table(table: StrainTable) -> Strength | None:
    """The strength of a table with columns of its rings, with its error between rows; None for a table without them.

    InputError if the table does not name its material.
    """
    if table.strength is None or table.compliance is None:
        return None
    where = "the sidecar file of the table:"
    material = read_material(checked(table.provenance, "material", mapping, where), f"{where} material")
    size = trace(table.S)
    good = table.converged & np.isfinite(table.strength).all(axis=1) & (size > 0.0)
    S = table.S[good] / size[good, None]
    along = np.einsum("ni,nij,nj->n", S * WEIGHT, table.compliance[good], S)
    s = cauchy_line_load(table.alpha_deg[good], table.beta_deg[good])
    s = s / trace(s)[:, None]
    joint = checked({"joint": "welded"} | table.provenance, "joint", joint_name, where)
    first, last = table.strength[good].T
    found = Strength(S, s, first, last, along, material, joint=joint, is_mirrored=table.is_mirrored)
    return replace(found, error=off_grid(found))


def off_grid(strength: Strength) -> OffGrid | None:
    """Relative errors at rows inside the hull, each left out once with its neighbours kept; None with too few rows."""
    if len(strength.S) < 2 * FOLDS:
        return None
    x = disc(np.vstack([strength.S, mirror(strength.S)]) if strength.is_mirrored else strength.S)
    rim = x[ConvexHull(x).vertices]
    inner = np.flatnonzero([np.abs(rim - point).max(axis=1).min() > 1e-7 for point in disc(strength.S)])
    if len(inner) < 2 * FOLDS:
        return None
    values = np.stack([strength.first_yield, strength.collapse])
    error = np.zeros((2, 0))
    for fold in range(FOLDS):
        out = inner[fold::FOLDS]
        keep = np.setdiff1d(np.arange(len(strength.S)), out)
        others = Directions.of(strength.S[keep], strength.cauchy[keep], strength.is_mirrored)
        rows, weights = others.at(strength.S[out])
        guess = (weights * values[:, keep][:, rows]).sum(axis=2)
        error = np.concatenate([error, np.abs(guess / values[:, out] - 1.0)], axis=1)
    first, last = error
    return OffGrid(len(inner), float(first.max()), float(first.mean()), float(last.max()), float(last.mean()))


def read_strength(table: Mapping[str, Any], where: str) -> Strength:
    """The strength that `Strength.to_dict` wrote; InputError names file, key and value."""
    S, cauchy = (checked(table, key, numbers(None, 3, least=-1.0, most=1.0), where) for key in ("S", "cauchy"))
    first, last = (
        checked(table, key, numbers(None, least=1e-12, most=1e12), where)
        for key in ("first_yield_1_per_mm", "collapse_1_per_mm")
    )
    along = checked(table, "compliance_mm_per_N", _numbers_or_none, where)
    if not len(S) == len(cauchy) == len(along) == len(first) == len(last):
        raise InputError(
            f"{where} S, cauchy, first_yield_1_per_mm, collapse_1_per_mm, compliance_mm_per_N: differ in length"
        )
    for key, loads in (("S", S), ("cauchy", cauchy)):
        bad = np.flatnonzero((np.abs(trace(loads) - 1.0) > 1e-9) | (eigenvalues(loads)[0] < -1e-9))
        if len(bad):
            raise InputError(f"{where} {key}: row {bad[0]}, {loads[bad[0]].tolist()}, is no tensile load of unit trace")
    joint = checked(table, "joint", joint_name, where)
    material = read_material(checked(table, "material", mapping, where), f"{where} material")
    error = table.get("error")
    return Strength(
        S,
        cauchy,
        first,
        last,
        along,
        material,
        None if error is None else read_record(OffGrid, error, f"{where} error"),
        joint=joint,
        is_mirrored=checked({"is_mirrored": True, **table}, "is_mirrored", boolean, where),
    )


def _numbers_or_none(value: Any) -> Array:
    if not isinstance(value, list) or not value:
        raise ValueError("is not a list of numbers")
    known = numbers(None, least=0.0)([0.0 if x is None else x for x in value])
    return np.where([x is None for x in value], np.nan, known)


def strength_answer(strength: Strength | None, S: Array, yield_N_per_mm2: float | None, where: str) -> dict[str, Any]:
    """The line loads S (3,) of unit trace times which the rings first yield and collapse, for the command line.

    InputError if the law has no strength (None), S is not tensile, or no yield stress is known.
    """
    if strength is None:
        raise InputError(f"{where}: holds no strength; {MAKE_AGAIN}")
    size = float(trace(S))
    if not size > 0.0 or float(eigenvalues(S)[0]) < -1e-12 * size:
        raise InputError(f"--S {S[0]},{S[1]},{S[2]}: not tensile; a principal line load is negative or all are zero")
    stress = strength.yield_stress(yield_N_per_mm2)
    unit = (S / size)[None]
    return {
        **{f"S{name}": float(x) for name, x in zip(("11", "12", "22"), unit[0], strict=True)},
        "yield_N_per_mm2": stress,
        "first_yield_N_per_mm": float(1.0 / strength.utilisation(unit, stress)[0]),
        "collapse_N_per_mm": float(1.0 / strength.collapse_utilisation(unit, stress)[0]),
        "compliance_mm_per_N": float(strength.compliance_along(unit)[0]),
        "error_between_rows": None if strength.error is None else asdict(strength.error),
        "material": strength.material.name,
        "joint": strength.joint,
    }
