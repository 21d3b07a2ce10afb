"""From load directions to a strain-load table."""

from __future__ import annotations

import platform
import time
from dataclasses import asdict, dataclass, replace
from importlib import metadata
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rve.cell import Pose
from rve.equilibrium import DirectOptions, Equilibrium, solve_equilibrium
from rve.errors import SENTENCES, InputError, NotConverged
from rve.load import cauchy_line_load, green_lagrange, second_pk
from rve.system import Equations
from rve.table import StrainTable
from rve.uniqueness import with_limits
from rve.weave import FOUR_IN_ONE, Weave

Array = NDArray[np.float64]

STEEL_KG_PER_MM3 = 7.85e-6


@dataclass(frozen=True)
class Cell:
    """The mesh: radii in mm, weave, grain ("y" or "x": the interlacing direction), density in kg/mm3.

    Raises InputError for radii that are not positive numbers and for wire too thick for the weave.
    """

    r1: float = 5.0
    r2: float = 0.5
    weave: Weave = FOUR_IN_ONE
    grain: str = "y"
    density: float = STEEL_KG_PER_MM3

    def __post_init__(self) -> None:
        for name, value in (("r1", self.r1), ("r2", self.r2), ("density", self.density)):
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"{name} = {value}: must be a positive number")
        if self.grain not in ("x", "y"):
            raise InputError(f"grain = {self.grain!r}: must be x or y")
        limit = self.weave.jamming_ratio
        if not self.r1 / self.r2 > limit:
            raise InputError(
                f"r2 = {self.r2}: too thick for the {self.weave.name} weave, which jams at r1/r2 = {limit:.4f}; "
                f"here r1/r2 = {self.r1 / self.r2:.4f}"
            )

    @property
    def wire(self) -> float:
        """r2/r1."""
        return self.r2 / self.r1

    @property
    def ring_mass(self) -> float:
        """Mass of one ring in kg."""
        return float(self.density * 2.0 * np.pi**2 * self.r1 * self.r2**2)


@dataclass(frozen=True)
class Sweep:
    """A table with the poses behind it; the last row of `equilibrium` is the reference (0, 90 degrees)."""

    cell: Cell
    table: StrainTable
    equilibrium: Equilibrium
    s: Array


def _swapped(triple: Array) -> Array:
    """Tensor components after x and y are exchanged."""
    return triple[:, ::-1]


def locked(alpha_deg: ArrayLike, beta_deg: ArrayLike, cell: Cell, options: DirectOptions) -> tuple[Equilibrium, Array, Array]:
    """Equilibria of the loads and, last, of the reference; loads s (n + 1, 3) in weave axes; flags unique (n + 1,).

    Rows with a negative principal load get the status "compressive" and are not solved.
    """
    alpha = np.append(np.asarray(alpha_deg, dtype=float).ravel(), 90.0 if cell.grain == "x" else 0.0)
    beta = np.append(np.asarray(beta_deg, dtype=float).ravel(), 90.0)
    s = cauchy_line_load(alpha, beta)
    if cell.grain == "x":
        s = _swapped(s)
    principal = cauchy_line_load(np.zeros_like(beta), beta)
    tensile = (principal[:, 0] >= 0.0) & (principal[:, 2] >= 0.0)
    equations = Equations.of(cell.weave, cell.wire)
    solved = np.where(tensile[:, None], s, s[-1])
    found = solve_equilibrium(solved, equations, options)
    found, unique = with_limits(solved, equations, found, options)
    return replace(found, status=np.where(tensile, found.status, "compressive")), s, unique


def lattice_mm(pose: Pose, cell: Cell) -> tuple[Array, Array]:
    """x2 and x3 in mm, (n, 2) each, for one primitive cell and in the axes of the user."""
    nx, ny = cell.weave.repeat
    a1, a2 = cell.r1 * pose.a1 / nx, cell.r1 * pose.a2 / ny
    return (a2[:, ::-1], a1[:, ::-1]) if cell.grain == "x" else (a1, a2)


def solve_table(
    alpha_deg: ArrayLike, beta_deg: ArrayLike, cell: Cell | None = None, options: DirectOptions | None = None
) -> Sweep:
    """The strain-load table of the load directions (alpha, beta) in degrees, each (n,), by the direct solver.

    The reference cell is the locked state under a pull along the grain; it is always solved and raises NotConverged if
    it fails. Other rows that fail keep their status and have nan elsewhere.

    >>> solve_table([0.0], [45.0]).table.x2_mm.round(4)
    array([[13.1163,  0.    ]])
    """
    cell, options = cell or Cell(), options or DirectOptions()
    began = time.perf_counter()
    alpha = np.asarray(alpha_deg, dtype=float).ravel()
    beta = np.asarray(beta_deg, dtype=float).ravel()
    if alpha.shape != beta.shape or not len(alpha):
        raise InputError(f"alpha has {len(alpha)} and beta {len(beta)} values; give as many of both, and at least one")
    if not (np.isfinite(alpha).all() and np.isfinite(beta).all()):
        raise InputError("alpha and beta must be finite numbers of degrees")
    found, s, unique = locked(alpha, beta, cell, options)
    if found.status[-1] != "converged":
        raise NotConverged(f"the reference cell (a pull along the grain): {SENTENCES[str(found.status[-1])]}")
    x2, x3 = lattice_mm(found.pose, cell)
    b_x, b_y = float(x2[-1, 0]), float(x3[-1, 1])
    F = np.stack([x2 / b_x, x3 / b_y], axis=2)
    bad = found.status != "converged"
    E = green_lagrange(F)
    S = second_pk(F, cauchy_line_load(np.append(alpha, 0.0), np.append(beta, 90.0)))
    for array in (E, S, x2, x3):
        array[bad] = np.nan
    gap = np.where(bad, np.nan, found.contacts.min_gap * cell.r1)
    contacts = ((found.lam > 1e-7) & found.contacts.present).sum(axis=(1, 2))
    provenance = _provenance(cell, options, b_x, b_y, found, time.perf_counter() - began)
    columns = (alpha, beta, E, S, x2, x3, found.R, gap, contacts, unique, found.status, found.iterations)
    n = len(alpha)
    return Sweep(cell, StrainTable(*(np.asarray(c)[:n] for c in columns), None, provenance), found, s)


def _provenance(
    cell: Cell, options: DirectOptions, b_x: float, b_y: float, found: Equilibrium, wall: float
) -> dict[str, Any]:
    statuses, counts = np.unique(found.status[:-1], return_counts=True)
    rings = 2 if cell.weave.classes == 2 else cell.weave.classes
    return {
        "format": "ring-mesh strain-load table",
        "format_version": 1,
        "weave": cell.weave.name,
        "grain": cell.grain,
        "r1_mm": cell.r1,
        "r2_mm": cell.r2,
        "b_x_mm": b_x,
        "b_y_mm": b_y,
        "density_kg_per_mm3": cell.density,
        "areal_mass_kg_per_m2": 1e6 * rings * cell.ring_mass / (b_x * b_y * np.prod(cell.weave.repeat)),
        "method": "direct",
        "options": asdict(options),
        "rows": {str(k): int(v) for k, v in zip(statuses, counts, strict=True)},
        "sentences": {str(k): SENTENCES[str(k)] for k in statuses if k != "converged"},
        "wall_s": round(wall, 3),
        "versions": versions(),
    }


def versions() -> dict[str, str]:
    """Versions of what has computed a result."""
    out = {"python": platform.python_version()}
    for name in ("ring-mesh", "numpy", "scipy"):
        try:
            out[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            out[name] = "not installed"
    return out
