"""Stiffness and strength of the rings as columns of a solved table."""

from dataclasses import asdict, replace

import numpy as np

from rve.common import Array, InputError, checked
from rve.common.rings import Joint
from rve.common.tensor import trace
from rve.equilibrium.elastic_rings import ring_states
from rve.equilibrium.interior_point import DirectOptions, LockedStates
from rve.equilibrium.system import Equations
from rve.geometry.cell import Cell, weave_axes, weave_sides
from rve.geometry.kinematics import second_pk
from rve.geometry.pose import deformation
from rve.solve import locked_states, reference_sides
from rve.table import StrainTable


@checked
def with_rings(table: StrainTable, cell: Cell, joint: str = "welded") -> StrainTable:
    """The table with compliance and strength of its rings, of the cell's material.

    joint: "welded", "butted:ANGLE" (open at this angle in degrees around the ring from the grain) or "butted:worst" (at
    the worst angle for each load).

    compliance: dE/dS in mm/N for a line load of 1 N/mm, to first order: the bend of the locking surface and what the
    rings give; at s N/mm the bend is to be divided by s; where the strain is not unique, with its free part held.
    strength: see `StrainTable`. Where several states coexist the compliance is their mean by shares, the strength that
    of the one that yields, or collapses, first. Rows that have not converged have nan in both, and so have those of a
    table from a file whose state is not that from the slack pose. InputError for another cell. Docs: theory.md, 7.

    >>> from rve.solve import solve_table
    >>> found = with_rings(solve_table(Cell(), ([0.0], [90.0])), Cell())
    >>> found.strength.round(1)  # yield stress in N/mm2 per N/mm of line load along the grain
    array([[123.2,  59.4]])
    """
    known, material, closed = table.provenance, cell.material, Joint.of(joint)
    mine = {"weave": cell.weave.name, "grain": cell.grain, "r1_mm": cell.r1, "r2_mm": cell.r2}
    for key, value in (mine | {"density_kg_per_mm3": cell.density}).items():
        if known.get(key, value) != value:
            raise InputError(f"{key} = {value} of the cell: the table has {known[key]}; give the table's cell")
    states, is_known = table.states, table.converged
    if states is None:  # a table that was read: solved again, from the slack pose alone
        states = locked_states(table.alpha_deg, table.beta_deg, cell, DirectOptions())
        is_known = is_known if table.branch is None else is_known & (table.branch == "slack")
    found = replace(states.found, status=np.where(is_known, states.found.status, "stalled"))
    sides = (known["b_x_mm"], known["b_y_mm"]) if "b_x_mm" in known else reference_sides(cell, DirectOptions())

    def solved(some: LockedStates) -> tuple[Array, Array]:
        """Compliance (n, 2, 3, 3) in weave axes, of the bend at unit trace of S and of the rings; strength (n, 2)."""
        own = weave_sides(some.cell, sides)
        equations, S = Equations.of(some.cell.weave, cell.wire), second_pk(deformation(some.pose, own), some.s)
        rings = ring_states(equations, some.found, some.s, own, material.poisson, closed.angles_deg)
        size = trace(S)[:, None]
        parts = [rings.locking * size[..., None], rings.elastic / (material.young_N_per_mm2 * cell.r1)]
        return np.stack(parts, axis=1), np.stack([rings.first_yield, rings.collapse], axis=1) / (cell.r1 * size)

    own, strength = solved(replace(states, found=found))
    parts = own.copy()
    for at, share, others in states.beside:
        other, asked = solved(others)
        np.maximum.at(strength, at, asked)
        np.add.at(parts, at, share[:, None, None, None] * (other - own[at]))
    bend, give = np.moveaxis(parts[..., weave_axes(cell), weave_axes(cell)], 1, 0)
    D = bend / trace(table.S)[:, None, None] + give
    provenance = known | {"compliance": "rings", "joint": closed.name, "material": asdict(material)}
    return replace(table, compliance=D, strength=strength, provenance=provenance)
