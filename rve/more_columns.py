"""Additions to a solved table: compliances and strengths as columns, spans of free strains in the provenance."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rve.common.errors import InputError
from rve.common.rings import Joint, joint_name
from rve.common.types import Array
from rve.common.values import Options, entry, finite, flag, optional
from rve.equilibrium.compliance import soften
from rve.equilibrium.elastic_rings import RingStates, ring_states
from rve.equilibrium.interior_point import DirectOptions, solve_equilibrium
from rve.equilibrium.loaded_rings import LARGEST_OVERLAP, loaded_states
from rve.equilibrium.locked_states import LockedStates
from rve.equilibrium.system import Equations
from rve.geometry.cell import Cell
from rve.geometry.kinematics import cauchy_line_load, green_lagrange, second_pk
from rve.geometry.pose import deformation
from rve.ring.section import Ring
from rve.solve import lattice_mm, locked_states, reference_sides, weave_sides
from rve.table import StrainTable

_SIDES = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0], [0, 0, 1.0], [0, 0, -1.0]])


@dataclass(frozen=True)
class RingOptions(Options):
    """Options of `with_rings`; InputError for senseless values.

    joint: "welded", "butted:ANGLE" (open at this angle in degrees around the ring from the grain) or "butted:worst"
    (at the worst angle for each load). load_N_per_mm: the size S11 + S22 of a line load under which the strains
    are found in full equilibrium. hertz: wires also give where they cross, as much as this load presses them.
    """

    joint: str = entry(joint_name, "welded")
    load_N_per_mm: float | None = entry(optional(finite(least=1e-9, most=1e9)), None)
    hertz: bool = flag(False)

    def __post_init__(self) -> None:
        """InputError for values that do not go together, or out of range."""
        super().__post_init__()
        if self.hertz and self.load_N_per_mm is None:
            raise InputError("hertz: how much crossing wires give depends on the load: give load_N_per_mm")


def states_of(table: StrainTable, cell: Cell) -> LockedStates:
    """The locked states of a table: those it carries, or solved for `cell` if it was read from a file."""
    if table.states is not None:
        return table.states
    return locked_states(table.alpha_deg, table.beta_deg, cell, DirectOptions())[0]


def _sides(table: StrainTable, cell: Cell) -> tuple[float, float]:
    """Sides b_x, b_y of the reference cell in mm."""
    known = table.provenance
    return (known["b_x_mm"], known["b_y_mm"]) if "b_x_mm" in known else reference_sides(cell, DirectOptions())


def _solved(table: StrainTable) -> NDArray[np.bool_]:
    """The rows (n,) whose locked states are known: those that have converged, and of a table that was read those from
    the slack pose, since that is where its states are solved again.
    """
    if table.states is None and table.branch is not None:
        return np.asarray(table.converged & (table.branch == "slack"))
    return table.converged


def _check_cell(table: StrainTable, cell: Cell) -> None:
    """InputError unless the table is one of this cell, as far as its provenance says."""
    given = {"weave": cell.weave.name, "grain": cell.grain, "r1_mm": cell.r1, "r2_mm": cell.r2}
    for key, value in given.items():
        theirs = table.provenance.get(key, value)
        if theirs != value:
            raise InputError(f"{key} = {value} of the cell: the table has {key} = {theirs}; give the table's cell")


def with_rings(table: StrainTable, cell: Cell, options: RingOptions = RingOptions()) -> StrainTable:
    """The table with compliance and strength of its rings, by default welded ones, of the cell's material.

    compliance: dE/dS in mm/N for a line load of 1 N/mm, to first order: the bend of the locking surface and what the
    rings give; at s N/mm the bend is to be divided by s. nan where the strain is not unique. strength: see
    `StrainTable`. Rows that have not converged have nan in both, and so have those of a table that was read from a file
    whose state is not that from the slack pose. InputError for a cell other than the table's. Docs: theory.md, 7.

    >>> from rve.solve import solve_table
    >>> found = with_rings(solve_table(Cell(), ([0.0], [90.0])), Cell())
    >>> found.strength.round(1)  # yield stress in N/mm2 per N/mm of line load along the grain
    array([[123.2,  59.4]])
    """
    _check_cell(table, cell)
    states, material = states_of(table, cell), cell.material
    found = replace(states.found, status=np.where(_solved(table), states.found.status, "stalled"))
    equations = Equations.of(states.cell.weave, cell.wire)
    sides, joint = weave_sides(cell, _sides(table, cell)), Joint.of(options.joint)
    size = _sizes(table, cell, options.load_N_per_mm) if options.hertz else None
    rings = ring_states(equations, found, states.s, sides, material.poisson, joint, size)
    D = rings.locking + rings.elastic / (material.young_N_per_mm2 * cell.r1)
    D = np.where(states.unique[:, None, None], D, np.nan)
    if cell.grain == "x":
        D = D[:, ::-1, ::-1]
    asked = np.stack([rings.first_yield, rings.collapse], axis=1) / cell.r1
    strength = asked / (table.S[:, 0] + table.S[:, 2])[:, None]
    provenance = table.provenance | {"compliance": "rings", "joint": joint.name, "material": asdict(material)}
    if options.hertz:
        provenance |= {"hertz_load_N_per_mm": options.load_N_per_mm}
    full = replace(table, compliance=D, strength=strength, provenance=provenance)
    return full if options.load_N_per_mm is None else _with_load(full, cell, states, rings, options)


def _with_load(
    table: StrainTable, cell: Cell, states: LockedStates, rings: RingStates, options: RingOptions
) -> StrainTable:
    """The table with its strains under the line load of the options, in full equilibrium, and a note in words."""
    load, material = options.load_N_per_mm or 0.0, cell.material
    solved = np.isfinite(rings.first_yield) & states.unique
    rows, sides = np.flatnonzero(solved), weave_sides(cell, _sides(table, cell))
    part = states.found.take(rows)
    S = second_pk(deformation(part.pose, sides), states.s[rows])
    ring, size = Ring(1.0, cell.wire, 1.0, material.poisson), _sizes(table, cell, load)[rows]
    equations = Equations.of(states.cell.weave, cell.wire)
    done = loaded_states(equations, part, rings.take(rows), S, sides, ring, size, hertz=options.hertz)
    E = np.full((len(table), 3), np.nan)
    E[rows] = done.E[:, ::-1] if cell.grain == "x" else done.E
    record: dict[str, Any] = {"S11_plus_S22_N_per_mm": load, "hertz": options.hertz}
    record |= {"rows": {str(name): int((done.status == name).sum()) for name in np.unique(done.status)}}
    deepest = float(np.nanmax(done.overlap, initial=0.0))
    record |= {"largest_overlap_over_r1": deepest, "rows_above_first_yield": None}
    if material.yield_N_per_mm2 is not None and table.strength is not None:
        record["rows_above_first_yield"] = int((table.strength[:, 0] * load > material.yield_N_per_mm2).sum())
    return replace(table, loaded=E, provenance=table.provenance | {"loaded": record | {"note": load_note(record)}})


def load_note(record: dict[str, Any]) -> str:
    """What the strains under a load are good for, in words.

    >>> load_note({"S11_plus_S22_N_per_mm": 2.0, "rows": {"converged": 3}, "rows_above_first_yield": 1})
    'strains at 2 N/mm are those of 3 rows; rings of 1 rows would have yielded before: choose a smaller load'
    """
    rows, beyond = record["rows"], record["rows_above_first_yield"]
    text = f"strains at {record['S11_plus_S22_N_per_mm']:g} N/mm are those of {rows.get('converged', 0)} rows"
    for name, why in (
        ("large", f"overlap by more than {LARGEST_OVERLAP:g} r1, where their change of shape, left out, matters"),
        ("stalled", "found no equilibrium at this load and have no strain"),
    ):
        text += f"; {rows[name]} rows {why}: choose a smaller load" if name in rows else ""
    return text + (f"; rings of {beyond} rows would have yielded before: choose a smaller load" if beyond else "")


def _sizes(table: StrainTable, cell: Cell, load_N_per_mm: float | None) -> Array:
    """Sizes (n,) in E r1 of the unit Cauchy loads of the rows where S11 + S22 is `load_N_per_mm`."""
    stiffness = cell.material.young_N_per_mm2 * cell.r1
    return np.asarray((load_N_per_mm or 0.0) / stiffness / (table.S[:, 0] + table.S[:, 2]))


def with_compliance(
    table: StrainTable, stiffness_N_per_mm: float | None = None, cell: Cell | None = None
) -> StrainTable:
    """The table with its compliance, dE/dS in mm/N for a line load of 1 N/mm: that of its rings (`with_rings`), or of
    rigid rings with contacts of this stiffness.

    A line load of s N/mm at stiffness k has the compliance of stiffness k/s, over s. Rows that have not converged or
    whose strain is not unique have nan. `cell` is needed for a table that was read from a file, whose rows from a
    restart have nan as well. Raises InputError for a stiffness that is not positive.
    """
    if cell is None:
        cell = Cell() if table.states is None else table.states.cell
    if stiffness_N_per_mm is None:
        return with_rings(table, cell)
    if not (np.isfinite(stiffness_N_per_mm) and stiffness_N_per_mm > 0.0):
        raise InputError(f"stiffness = {stiffness_N_per_mm}: must be a positive number of N/mm")
    states = states_of(table, cell)
    cell = states.cell
    status = np.where(states.unique & _solved(table), states.found.status, "stalled")
    equations = Equations.of(cell.weave, cell.wire)
    # One contact per primitive cell: forces in s_hat r1 and penetrations in r1 leave only the ratio k / s_hat.
    found = replace(states.found, status=status)
    D = soften(found, states.s, equations, stiffness_N_per_mm, weave_sides(cell, _sides(table, cell))).compliance
    if cell.grain == "x":
        D = D[:, ::-1, ::-1]
    springs = {"compliance": "contact springs", "compliance_stiffness_N_per_mm": stiffness_N_per_mm}
    return replace(table, compliance=D, provenance=table.provenance | springs)


def strain_span(table: StrainTable, cell: Cell, size: float = 2e-3) -> Array:
    """Least and largest E11, E12, E22 of the rows that leave the strain free, (m, 3, 2), m = number of such rows.

    The admissible strains under such a load are a face of the locking surface. Its extent in one component of E is what
    the locked state reaches under an additional load of `size` times the row's load in that component, in both senses;
    compression is possible as long as rings support it. The error is about `size`. The span holds the row's own E;
    solves that fail are ignored, so that it may be too small.
    """
    rows = np.flatnonzero(~table.unique & table.converged)
    s = cauchy_line_load(table.alpha_deg[rows], table.beta_deg[rows])
    loads = (s[:, None] + size * _SIDES).reshape(-1, 3)
    if cell.grain == "x":
        loads = loads[:, ::-1]
    found = solve_equilibrium(loads, Equations.of(cell.weave, cell.wire))
    x2, x3 = lattice_mm(found.pose, cell)
    b_x, b_y = _sides(table, cell)
    F = np.stack([x2 / b_x, x3 / b_y], axis=2)
    E = np.where((found.status == "converged")[:, None], green_lagrange(F), np.nan).reshape(len(rows), 6, 3)
    E = np.concatenate([E, table.E[rows, None]], axis=1)
    return np.stack([np.nanmin(E, axis=1), np.nanmax(E, axis=1)], axis=2)


def with_span(table: StrainTable, cell: Cell) -> StrainTable:
    """The table with the spans of its free rows in the provenance, under "free_strains"; see `strain_span`."""
    rows = np.flatnonzero(~table.unique & table.converged)
    span = strain_span(table, cell) if len(rows) else np.zeros((0, 3, 2))
    records: list[dict[str, Any]] = [
        {"alpha_deg": float(table.alpha_deg[row]), "beta_deg": float(table.beta_deg[row])}
        | {name: ends.tolist() for name, ends in zip(("E11", "E12", "E22"), one, strict=True)}
        for row, one in zip(rows, span, strict=True)
    ]
    return replace(table, provenance=table.provenance | {"free_strains": records})
