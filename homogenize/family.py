"""Laws across radius ratios: one law per table, interpolated in r2/r1, with an error that was checked.

The support functions are interpolated, load by load, by the polynomial through the three nearest members; the loads are
the normals of the nearest one. Whatever the numbers are, the result is a set of half-spaces: a convex tensile law.
Ratios outside the members' are refused. The error is that of each inner member, left out and predicted by the others.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from homogenize.fitting.report import Misfit, misfit_of, random_loads
from homogenize.io import SCHEMA, UNITS, cell_from_dict, check_format
from homogenize.laws.polyhedral import PolyhedralLaw, polyhedral_from_dict, polyhedral_law
from homogenize.laws.protocol import CellInfo
from rve.common.errors import InputError
from rve.common.files import write_text
from rve.common.reading import read_json_object
from rve.common.rings import areal_mass, check_rings, ring_volume
from rve.common.types import Array
from rve.common.values import checked, list_of, mapping

NEIGHBOURS = 3
MOST_MEMBERS = 100


@dataclass(frozen=True, eq=False)
class LawFamily:
    """Members by growing `ratio` r2/r1 (k,); `checks`: (ratio, error of h) of inner members predicted by the others."""

    ratio: Array
    members: tuple[PolyhedralLaw, ...]
    checks: tuple[tuple[float, Misfit], ...]

    def at(self, r1_mm: float, r2_mm: float) -> PolyhedralLaw:
        """The law of rings of these radii; InputError outside the family's ratios."""
        if not (r1_mm > 0.0 and r2_mm > 0.0):
            raise InputError(f"r1 = {r1_mm}, r2 = {r2_mm}: radii are positive numbers of mm")
        check_rings({"r1_mm": r1_mm, "r2_mm": r2_mm}, "the asked rings:")
        x = r2_mm / r1_mm
        if not self.ratio[0] * (1.0 - 1e-12) <= x <= self.ratio[-1] * (1.0 + 1e-12):
            raise InputError(
                f"r1/r2 = {1.0 / x:g} is outside the family, which reaches from {1.0 / self.ratio[-1]:g} to "
                f"{1.0 / self.ratio[0]:g}: add a table"
            )
        S, h = predicted(self.ratio, self.members, x)
        nearest = self.members[int(np.argmin(np.abs(self.ratio - x)))]
        return polyhedral_law(S, h, nearest.stiffness, self.cell_at(r1_mm, r2_mm))

    def cell_at(self, r1_mm: float, r2_mm: float) -> CellInfo:
        """The reference cell of the members' material, its sides over r1 interpolated like the supports."""
        x = r2_mm / r1_mm
        near = nearest_members(self.ratio, x)
        cells = [cell_of_member(self.members[k]) for k in near]
        sides = np.array([[cell.b_x_mm / cell.r1_mm, cell.b_y_mm / cell.r1_mm] for cell in cells])
        b_x, b_y = (float(side) for side in lagrange(self.ratio[near], x) @ sides * r1_mm)
        mass = areal_mass(r1_mm, r2_mm, b_x * b_y, mass_per_volume(cells[0]))
        return CellInfo(r1_mm, r2_mm, b_x, b_y, mass)


def family_of(laws: list[PolyhedralLaw]) -> LawFamily:
    """The family of laws of distinct radius ratios; InputError for fewer than three, equal ratios or two materials."""
    ratio = np.array([cell_of_member(law).r2_mm / cell_of_member(law).r1_mm for law in laws])
    order = np.argsort(ratio)
    ratio, members = ratio[order], tuple(laws[k] for k in order)
    if len(ratio) < NEIGHBOURS:
        raise InputError(f"a family needs tables of at least {NEIGHBOURS} radius ratios, got {len(ratio)}")
    if np.diff(ratio).min() < 1e-9:
        raise InputError(f"two tables of a family have the same r1/r2 = {1.0 / ratio[int(np.diff(ratio).argmin())]:g}")
    mass = np.array([mass_per_volume(cell_of_member(law)) for law in members])
    if np.ptp(mass) > 1e-6 * mass.max():
        raise InputError(
            f"the members of a family are of one material and weave: the mass of a cell over the volume of a ring is "
            f"{mass.min():.6g} kg/mm3 for one and {mass.max():.6g} for another; make their tables with one --density"
        )
    checks = []
    for k in range(1, len(ratio) - 1):
        rest = [j for j in range(len(ratio)) if j != k]
        S = random_loads(300)
        guess = polyhedral_law(*predicted(ratio[rest], tuple(members[j] for j in rest), ratio[k]))
        checks.append((float(ratio[k]), misfit_of(S, guess.support(S) - members[k].support(S))))
    return LawFamily(ratio, members, tuple(checks))


def predicted(ratio: Array, members: tuple[PolyhedralLaw, ...], x: float) -> tuple[Array, Array]:
    """Half-spaces S (m, 3), h (m,) at the ratio x: normals of the nearest member, supports from the nearest three."""
    near = nearest_members(ratio, x)
    S = members[int(np.argmin(np.abs(ratio - x)))].S
    return S, lagrange(ratio[near], x) @ np.stack([members[k].support(S) for k in near])


def nearest_members(ratio: Array, x: float) -> list[int]:
    """Numbers of the (up to) three ratios nearest to x, growing."""
    return sorted(np.argsort(np.abs(ratio - x), kind="stable")[:NEIGHBOURS].tolist())


def lagrange(nodes: Array, x: float) -> Array:
    """Weights (k,) of the values at `nodes` (k,) in the polynomial through them at x."""
    return np.array([np.prod([(x - b) / (a - b) for b in nodes if b != a]) for a in nodes])


def cell_of_member(law: PolyhedralLaw) -> CellInfo:
    """The rings of a member; InputError if its file does not say."""
    if law.cell is None:
        raise InputError("a law of the family does not say its radii")
    return law.cell


def mass_per_volume(cell: CellInfo) -> float:
    """Mass of a reference cell over the volume of one ring in kg/mm3: density times rings per cell."""
    return 1e-6 * cell.areal_mass_kg_per_m2 * cell.b_x_mm * cell.b_y_mm / ring_volume(cell.r1_mm, cell.r2_mm)


def save_family(family: LawFamily, path: str | Path) -> None:
    """Writes the family as JSON, whole or not at all."""
    members = [{"cell": asdict(cell_of_member(law)), "parameters": law.to_dict()} for law in family.members]
    checks = [{"r2_over_r1": ratio, "error_of_h": asdict(misfit)} for ratio, misfit in family.checks]
    record = {"schema": SCHEMA, "kind": "family", "units": UNITS, "members": members, "checks": checks}
    write_text(Path(path), json.dumps(record) + "\n")


def load_family(path: str | Path) -> LawFamily:
    """The family in the file `path`; InputError if it is none that this version reads."""
    record = read_json_object(path)
    check_format(record, str(path), ("family",))
    members = checked(record, "members", list_of(mapping, "members", least=NEIGHBOURS, most=MOST_MEMBERS), f"{path}:")
    laws = []
    for number, member in enumerate(members):
        where = f"{path}: member {number}:"
        cell = cell_from_dict(checked(member, "cell", mapping, where), f"{where} cell")
        parameters = checked(member, "parameters", mapping, where)
        laws.append(polyhedral_from_dict(parameters, cell, f"{where} parameters"))
    try:
        return family_of(laws)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
