"""`simulate`: the rings of a cell move under their loads until they rest; and what friction holds back on the way."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rve.common import (
    AnyPath,
    Array,
    ByValue,
    Index,
    InputError,
    JsonObject,
    NotConverged,
    checked,
    checksum,
    csv_text,
    json_text,
    read_columns,
    sidecar_path,
    tell,
    versions,
    write_text,
)
from rve.common.tensor import double_dot
from rve.geometry.cell import Cell, weave_axes, weave_sides
from rve.geometry.contacts import unlisted_gap
from rve.geometry.kinematics import cauchy_line_load, lattice_strain, second_pk
from rve.geometry.pose import Pose, deformation
from rve.locking.interior_point import DirectOptions
from rve.simulation.dynamics import Dynamics, SimulationOptions
from rve.simulation.stewart_trinkle import CellMotion, advance, begin
from rve.solve import reference_sides, solve_table
from rve.table import StrainTable

ENDS = {
    "converged": "the rings rest",
    "step-limit": "the rings were still moving after the last step that was allowed; raise max_steps or h_max",
    "time-step": "no step was short enough for the energy to fall; lower stiffness, or leave curvature on",
    "unlisted": "rings that the weave does not list as a pair overlap; list more pairs in the weave",
}
"""What each status of a case means, and what to try."""


@dataclass(frozen=True)
class History:
    """Accepted steps, one row each: case, stage (which of its loads), time (s) at the end of the step, h (s).

    s (m, 3): line load in s_hat and lattice (m, 3) = x2, y3, t in r1, in weave axes; R; kinetic energy in N mm; rise:
    change of the total energy over the step in s_hat r1^2, never above ROUND_OFF; lost: to friction so far in
    s_hat r1^2; side: contacts that press between rings that do not interlink.
    """

    case: Index
    stage: Index
    time: Array
    h: Array
    s: Array
    lattice: Array
    R: Array
    kinetic: Array
    rise: Array
    lost: Array
    side: Index


@dataclass(frozen=True, eq=False, repr=False)
class LoadHistory(ByValue):
    """A line load that changes in time, linearly between m rows: time_s, from 0 on and rising; principal angle and
    ratio angle in degrees; size, a share of the option `load`. The last load stays until the rings rest.

    >>> LoadHistory([0.0, 60.0], [0.0, 0.0], [90.0, 45.0], [1.0, 2.0]).s[1].round(9)
    array([1.41421356, 0.        , 1.41421356])
    """

    time_s: Array
    alpha_deg: Array
    beta_deg: Array
    size: Array

    def __post_init__(self) -> None:
        for item in fields(self):
            object.__setattr__(self, item.name, np.atleast_1d(np.asarray(vars(self)[item.name], dtype=float)))
        if len({one.shape for one in vars(self).values()}) > 1 or self.time_s.ndim != 1:
            raise InputError("a load history has as many times as angles alpha, angles beta and sizes")
        if self.time_s[0] != 0.0 or not (np.diff(self.time_s) > 0.0).all():
            raise InputError("time_s: must begin at 0 and rise from row to row")
        if not (self.size >= 0.0).all() or not self.size[-1]:
            raise InputError(
                "size: must not be negative, and the last one not 0, as rings without a load rest anywhere"
            )
        tensile(self.alpha_deg, self.beta_deg)

    @property
    def s(self) -> Array:
        """Line loads (m, 3) in s_hat."""
        return self.size[:, None] * cauchy_line_load(self.alpha_deg, self.beta_deg)

    def __str__(self) -> str:
        return f"LoadHistory: {len(self.time_s)} loads in {self.time_s[-1]:g} s"

    __repr__ = __str__


def read_history(path: AnyPath) -> LoadHistory:
    """The columns time_s, alpha_deg, beta_deg, size of a CSV file; InputError for others."""
    names = tuple(item.name for item in fields(LoadHistory))
    columns = read_columns(path, names, names)
    known, most = [True] * len(columns.places), {"time_s": 1e12, "size": 1e6}
    try:
        return LoadHistory(*(columns.numbers(name, most.get(name, 360.0), known) for name in names))
    except InputError as error:
        raise error if str(path) in str(error) else InputError(f"{path}: {error}") from None


def tensile(alpha_deg: ArrayLike, beta_deg: ArrayLike) -> tuple[Array, Array]:
    """Directions of n cases as (n, stages) each; InputError for what is no number, and for loads that push."""
    try:
        alpha, beta = (np.asarray(one, dtype=float) for one in np.broadcast_arrays(alpha_deg, beta_deg))
    except (TypeError, ValueError) as error:
        raise InputError("alpha and beta must be numbers in degrees, as many of both") from error
    if alpha.ndim > 2 or not alpha.size or not np.isfinite(alpha + beta).all():
        raise InputError("alpha and beta must be finite numbers of degrees: one a case, or a row of them for each")
    alpha, beta = (one.reshape(len(np.atleast_1d(one)), -1) for one in (alpha, beta))
    bad = beta[(beta < 0.0) | (beta > 90.0)]
    if len(bad):
        raise InputError(f"beta = {bad[0]:g}: a principal line load is negative and rings cannot push; keep 0 to 90")
    return alpha, beta


@dataclass(frozen=True, eq=False, repr=False)
class Simulation(ByValue):
    """How the rings of n cases came to rest.

    alpha_deg, beta_deg (n, stages): the loads of each case, in turn; rest: the last state; lattice (n, stages, 3) and
    lost (n, stages): of the states of rest under them, nan where none was reached; history: every accepted step.
    Strains refer to the reference cell of `solve_table`, with sides_mm.
    """

    cell: Cell
    options: SimulationOptions
    alpha_deg: Array
    beta_deg: Array
    sides_mm: tuple[float, float]
    rest: CellMotion
    lattice: Array
    lost: Array
    history: History

    @property
    def status(self) -> NDArray[np.str_]:
        """Of each case, (n,): "converged", "step-limit", "time-step" or "unlisted" (`ENDS`)."""
        return self.rest.status

    @property
    def E(self) -> Array:
        """Strains (n, 3) at the end."""
        return self.strain(self.rest.pose.lattice)

    @property
    def area(self) -> float:
        """Reference area of the moving cell in r1^2."""
        b1, b2 = self._sides
        return b1 * b2

    @property
    def _sides(self) -> tuple[float, float]:
        return weave_sides(moving_cell(self.cell), self.sides_mm)

    def strain(self, lattice: Array) -> Array:
        """Strains (..., 3) of lattices (..., 3) in r1 and weave axes."""
        E = lattice_strain(lattice.reshape(-1, 3), self._sides)[0][:, weave_axes(self.cell)]
        return E.reshape(lattice.shape)

    def path(self, case: int) -> tuple[Index, Array]:
        """Rows of the history that belong to a case, (m,), and its strains there, (m, 3)."""
        rows = np.flatnonzero(self.history.case == case)
        return rows, self.strain(self.history.lattice[rows])

    def direct(self) -> StrainTable:
        """The locked states that the direct solver finds for the last loads, without friction."""
        return solve_table(self.cell, (self.alpha_deg[:, -1], self.beta_deg[:, -1]))

    def steps(self, case: int) -> list[list[float]]:
        """The accepted steps of a case as rows of `STEPS`."""
        h, (rows, E) = self.history, self.path(case)
        s = h.s[rows][:, weave_axes(self.cell)]
        columns = h.time[rows], h.h[rows], *E.T, h.R[rows], h.kinetic[rows], *self.in_N_per_mm(s).T
        lost = self.in_N_per_mm(h.lost[rows] / self.area)
        return np.column_stack([*columns, lost, h.side[rows]]).tolist()

    def in_N_per_mm(self, values: Array) -> Array:
        """Line loads, or energies per reference area, of the unit s_hat."""
        return 1e-3 * self.options.load * values

    def ends(self, direct: StrainTable) -> list[JsonObject]:
        """How each case ended, beside the locked state of the direct solver under its last load."""
        rest, lost = self.rest, self.in_N_per_mm(self.rest.lost / self.area)
        columns: dict[str, NDArray[Any]] = {
            "alpha_deg": self.alpha_deg[:, -1],
            "beta_deg": self.beta_deg[:, -1],
            "steps": rest.steps,
        }
        columns |= {"rejected": rest.rejected, "t_s": rest.time, "R": rest.R, "status": rest.status}
        columns |= dict(zip(NAMES, self.E.T, strict=True)) | {"friction_N_per_mm": lost}
        columns |= dict(zip((f"{name}_direct" for name in NAMES), direct.E.T, strict=True))
        columns |= {"unique": direct.unique.astype(int)}
        rows = zip(*(column.tolist() for column in columns.values()), strict=True)
        return [dict(zip(columns, row, strict=True)) for row in rows]

    def record(self, direct: StrainTable) -> JsonObject:
        """What was asked for and how it ended, as plain values."""
        rings = {"weave": self.cell.weave.name, "grain": self.cell.grain, "r1_mm": self.cell.r1, "r2_mm": self.cell.r2}
        rings |= dict(zip(("b_x_mm", "b_y_mm"), self.sides_mm, strict=True)) | {"cells": list(self.cell.cells)}
        messages = {status: ENDS[status] for status in sorted(set(self.status.tolist()))}
        found = {"cell": rings, "options": asdict(self.options), "messages": messages, "ends": self.ends(direct)}
        return found | {"versions": versions()}

    def __str__(self) -> str:
        return f"Simulation: {int((self.status == 'converged').sum())} of {len(self.status)} cases at rest"

    __repr__ = __str__


NAMES = ("E11", "E12", "E22")
LINE_LOADS = ("s11_N_per_mm", "s12_N_per_mm", "s22_N_per_mm")
STEPS = ("t_s", "h_s", *NAMES, "R", "kinetic_N_mm", *LINE_LOADS, "friction_N_per_mm", "side_contacts")
"""Columns of a run: time and step, strain, R of eq. (9), kinetic energy of the rings of the weave's cell, Cauchy line
load, energy per reference area that friction has taken so far, contacts that press between rings that do not link."""


def write_run(run: Simulation, record: JsonObject, out: AnyPath) -> None:
    """The accepted steps of every case as CSV, and the record, with the checksum of the CSV, as JSON beside it."""
    text = csv_text(("case", *STEPS), ([case + 1, *row] for case in range(len(run.E)) for row in run.steps(case)))
    write_text(out, text)
    write_text(sidecar_path(out), json_text(record | {"files": {Path(out).name: checksum(out)}}))


def moving_cell(cell: Cell) -> Cell:
    """The cell whose rings move independently: itself, or all of a larger one."""
    return (cell.stages or [cell])[-1]


@checked
def simulate(
    cell: Cell, loads: tuple[ArrayLike, ArrayLike] | LoadHistory, options: SimulationOptions | None = None
) -> Simulation:
    """The motion of rigid rings from the slack pose of the cell to rest, by the damped scheme of the paper.

    loads: directions (alpha, beta) in degrees of constant Cauchy line loads, (n,) each, of n cases; with (n, m) each
    the m loads of a case follow each other, whenever its rings rest; or a `LoadHistory`. Nothing is raised for a case
    that does not come to rest: `status` and `ENDS` say why. InputError for loads that push; NotConverged if there is no
    reference cell.

    >>> rest = simulate(Cell(), ([0.0], [45.0]))
    >>> print(rest.status[0], rest.E[0, [0, 2]].round(4))
    converged [ 0.2109 -0.1057]
    """
    options = options or SimulationOptions()
    if isinstance(loads, LoadHistory):
        alpha, beta, s, times = loads.alpha_deg[None, -1:], loads.beta_deg[None, -1:], loads.s[None], loads.time_s
    else:
        alpha, beta = tensile(*loads)
        s, times = cauchy_line_load(alpha, beta), np.zeros(1)
    sides, mesh = reference_sides(cell, DirectOptions()), moving_cell(cell)
    rest, lattice, lost, history = follow(s[..., weave_axes(cell)], times, Dynamics.of(mesh, options))
    overlaps = (unlisted_gap(rest.pose, mesh.weave, mesh.wire) < 0.0) & (rest.status == "converged")
    rest = replace(rest, status=np.where(overlaps, "unlisted", rest.status).astype("<U16"))
    kinetic = 1e-3 * options.load * cell.r1**2 * history.kinetic
    return Simulation(cell, options, alpha, beta, sides, rest, lattice, lost, replace(history, kinetic=kinetic))


def follow(s: Array, times: Array, dynamics: Dynamics) -> tuple[CellMotion, Array, Array, History]:
    """Motion under line loads s (n, stages, 3) in s_hat and weave axes: one after the other, each until the rings rest;
    or, with as many `times`, at these times in s and linear in between. The last state, and lattice (n, stages, 3) and
    energy lost to friction (n, stages) at rest.
    """
    options, is_timed = dynamics.options, len(times) > 1
    motion, last = begin(s[:, 0], dynamics), 0 if is_timed else s.shape[1] - 1
    lattice, lost, first = np.full((len(s), last + 1, 3), np.nan), np.full((len(s), last + 1), np.nan), np.zeros(len(s))
    ended: list[CellMotion] = []
    log: list[list[Any]] = []
    while len(motion.row):
        tell(f"motion of {len(s)} cells, {len(motion.row)} under way, step {motion.steps.max() + 1}")
        motion = timed(motion, s, times, options) if is_timed else replace(motion, s=s[motion.row, motion.stage])
        h = motion.h
        motion, good, rise = advance(motion, dynamics)
        side = (motion.lam[:, ~dynamics.equations.weave.linked] > 0.0).sum(axis=(1, 2))
        kinetic, lat = dynamics.kinetic_energy(motion.v), motion.pose.lattice
        columns = (motion.row, motion.stage, motion.time, h, motion.s, lat, motion.R, kinetic, rise, motion.lost, side)
        log.append([column[good] for column in columns])
        is_at_rest = (options.tolerance > motion.R) & (motion.time >= times[-1])
        row, stage = motion.row[is_at_rest], motion.stage[is_at_rest]
        lattice[row, stage], lost[row, stage] = lat[is_at_rest], motion.lost[is_at_rest]
        first[row] = motion.steps[is_at_rest]
        goes_on = is_at_rest & (motion.stage < last)
        out = (motion.steps - first[motion.row] >= options.max_steps) | (motion.h < options.h_min)
        out = (is_at_rest | out) & ~goes_on
        stages, R = motion.stage + goes_on, np.where(goes_on, np.inf, motion.R)
        motion = replace(motion, stage=stages, R=R)
        if out.any():
            ended.append(motion.take(out))
            motion = motion.take(~out)
    end = ended[0].join(ended[1:])
    end = end.take(np.argsort(end.row))
    failed = np.where(end.h < options.h_min, "time-step", "step-limit")
    status = np.where(np.isfinite(lost[:, -1]), "converged", failed)
    history = History(*map(np.concatenate, zip(*log, strict=True)))
    return replace(end, status=status.astype("<U16")), lattice, lost, history


def timed(motion: CellMotion, s: Array, times: Array, options: SimulationOptions) -> CellMotion:
    """The motion with the load at the end of its step, which ends at the next of the `times` at the latest."""
    behind = np.searchsorted(times, motion.time + 10.0 * options.h_min, "right")
    left = np.where(behind < len(times), times[np.minimum(behind, len(times) - 1)] - motion.time, np.inf)
    h = np.minimum(motion.h, left)
    load = np.stack([np.interp(motion.time + h, times, part) for part in s[0].T], axis=1)
    return replace(motion, h=h, s=load)


@dataclass(frozen=True, eq=False, repr=False)
class FrictionLoop(ByValue):
    """One cycle of a line load of constant size from a direction to another and back, slowly, after it was gone through
    once: m states of rest.

    S (m, 3) in s_hat and E (m, 3): from the second direction to the first and back. run: how the rings got there.
    """

    S: Array
    E: Array
    run: Simulation

    @property
    def area(self) -> float:
        """Work in the cycle per reference area over s_hat: its closed integral of S:dE."""
        S = 0.5 * (self.S[1:] + self.S[:-1])
        return float(double_dot(S, np.diff(self.E, axis=0)).sum())

    @property
    def lost(self) -> float:
        """Energy that friction takes in the cycle per reference area over s_hat: forces times slips, never negative."""
        lost = self.run.lost[0]
        return float(lost[-1] - lost[-len(self.E)]) / self.run.area

    @property
    def band(self) -> Array:
        """Largest difference (3,) of E under one load, on the way there and back: the mesh may rest in between."""
        return np.asarray(np.abs(self.E - self.E[::-1]).max(axis=0))

    @property
    def damping_ratio(self) -> float:
        """Viscous damping over critical damping that loses as much in a cycle of this amplitude: lost/(4 pi W), W being
        half of load times strain amplitude, 1/8 dS:dE; nan where the rings do not move."""
        ends = self.S[[0, len(self.S) // 2]], self.E[[0, len(self.E) // 2]]
        W = float(double_dot(*(np.diff(one, axis=0) for one in ends))[0]) / 8.0
        return self.lost / (4.0 * np.pi * W) if self.lost > STUCK else float("nan")

    def record(self) -> JsonObject:
        """Its numbers as plain values; energies in N/mm, that is N mm per mm2 of reference area."""
        size, band = 1e-3 * self.run.options.load, dict(zip(NAMES, self.band.tolist(), strict=True))
        found = {"area_N_per_mm": size * self.area, "friction_N_per_mm": size * self.lost, "band": band}
        return found | {"damping_ratio": self.damping_ratio}

    def __str__(self) -> str:
        told = f"lost {self.lost:.4g} s_hat, damping ratio {self.damping_ratio:.3g}"
        return f"FrictionLoop: {told if self.lost > STUCK else 'the rings do not move'}"

    __repr__ = __str__


STUCK = 1e-5
"""Energy over s_hat below which friction holds all rings: what creeps in before R falls below the tolerance is less."""


@checked
def friction_loop(
    cell: Cell,
    first: tuple[float, float],
    second: tuple[float, float],
    options: SimulationOptions,
    *,
    increments: int = 12,
) -> FrictionLoop:
    """The loop of a load that turns from the direction `first` (alpha, beta) in degrees to `second` and back, in as
    many steps each way, after which the rings rest. NotConverged where they do not.

    >>> options = SimulationOptions(friction=0.1, directions=8, tolerance=1e-4)
    >>> print(friction_loop(Cell(), (0.0, 30.0), (0.0, 60.0), options, increments=3))
    FrictionLoop: lost 0.04204 s_hat, damping ratio 0.539
    """
    there = np.linspace(first, second, increments + 1)
    angles = np.concatenate([there, there[-2::-1], there[1:]])
    run = simulate(cell, (angles[None, :, 0], angles[None, :, 1]), options)
    if run.status[0] != "converged":
        raise NotConverged(f"the loop: {run.status[0]}: {ENDS[str(run.status[0])]}")
    rows, sides = slice(increments, None), weave_sides(moving_cell(cell), run.sides_mm)
    lattice = run.lattice[0, rows]
    s = cauchy_line_load(*angles[rows].T)[:, weave_axes(cell)]
    S = second_pk(deformation(Pose(lattice, lattice, lattice), sides), s)[:, weave_axes(cell)]
    return FrictionLoop(S, run.strain(lattice), run)
