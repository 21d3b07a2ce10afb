"""Section `law`: error of the membrane law against rows of its table, numbers in its file, and time to evaluate it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from benchmarks.pages.measuring import least_seconds
from benchmarks.pages.model import Column, Curve, Diagram, Section, Table, Value
from homogenize import refine
from homogenize.bounds import bounds_of
from homogenize.fit import STATED_STIFFNESS, builder, cell_of
from homogenize.interpolated import angle_interpolant
from homogenize.projection import ProjectionError
from homogenize.protocol import Array, MembraneLaw
from homogenize.rows import rows_from_table
from homogenize.strain import locked_strain
from homogenize.tensor import double_dot, from_disc, trace
from rve.ranges import graded_grid, grid
from rve.sweep import solve_table
from rve.table import StrainTable

SEED = 2027
"""Of the held-out directions: others than those on which the refined law's constants were chosen."""
LIMIT = 5e-3
"""Strain error per component that issue 2 asks for."""
KINDS = ("net", "interpolated", "inner", "outer", "refined", "smooth")
GRADED_RESOLUTION = 1e-5
OFFSETS = (1e-4, 1e-3, 1e-2, 5e-2)
POINTS = 50_000


@dataclass(frozen=True)
class Errors:
    """Errors of a law at held-out directions: of h at unit trace of S, and of strain components.

    `above`: share of directions with a strain error above `LIMIT`; `none`: directions with a unique strain for which
    the law finds none or says that it is not unique.
    """

    h_max: float
    h_mean: float
    E_max: float
    E_mean: float
    above: float
    none: int


def unseen_directions(count: int, seed: int = SEED) -> StrainTable:
    """Random directions over the paper's range, each solved by `rve` directly, never part of a fit."""
    rng = np.random.default_rng(seed)
    return solve_table(rng.uniform(0.0, 45.0, count), rng.uniform(0.0, 90.0, count))


def uniform_table(step: float) -> StrainTable:
    """The paper's range with this spacing of both angles in degrees."""
    return solve_table(*grid(np.arange(0.0, 45.0 + 0.5 * step, step), np.arange(0.0, 90.0 + 0.5 * step, step)))


def errors_of(law: MembraneLaw, unseen: StrainTable) -> Errors:
    """Errors of the law at the directions, strains where `rve` finds them unique; nan where the law has none at all."""
    S = unseen.S / trace(unseen.S)[:, None]
    h = np.abs(law.support(S) - double_dot(S, unseen.E))
    try:
        found = locked_strain(law, unseen.alpha_deg, unseen.beta_deg)
    except ProjectionError:
        return Errors(float(h.max()), float(h.mean()), np.nan, np.nan, np.nan, int(unseen.unique.sum()))
    good = unseen.unique & found.unique & (found.status == "converged")
    if not good.any():
        return Errors(float(h.max()), float(h.mean()), np.nan, np.nan, np.nan, int(unseen.unique.sum()))
    E = np.abs(found.E - unseen.E).max(axis=1)[good]
    none = int((unseen.unique & ~good).sum())
    return Errors(float(h.max()), float(h.mean()), float(E.max()), float(E.mean()), float((E > LIMIT).mean()), none)


def near_surface(law: MembraneLaw, E: Array, offset: float, count: int = POINTS) -> Array:
    """Points (count, 3) up to 2 `offset` beyond the locking surface, below random strains E, along random loads."""
    rng = np.random.default_rng(1)
    pick = E[rng.integers(len(E), size=(count, 3))]
    inside = np.einsum("nk,nki->ni", rng.dirichlet(np.full(3, 0.5), size=count), pick)
    cut = law.cut(inside)
    on_surface = inside - cut.violation[:, None] * np.array([1.0, 0.0, 1.0])
    radius, angle = np.sqrt(rng.uniform(size=count)), rng.uniform(0.0, 2.0 * np.pi, count)
    S = from_disc(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1))
    return np.asarray(on_surface + 2.0 * offset * rng.uniform(0.0, 1.0, (count, 1)) * S)


def parameters(law: MembraneLaw) -> int:
    """Numbers in the law's file, the stiffness apart."""
    return sum(np.size(value) for key, value in law.to_dict().items() if not key.startswith("stiffness"))


def made(table: StrainTable, kind: str = "refined", resolution: float = refine.NEWS) -> tuple[MembraneLaw, float]:
    """A law of this kind from the table, and the seconds that it took."""
    build = builder(kind, cell_of(table), STATED_STIFFNESS * np.eye(3), table, resolution)
    return least_seconds(partial(build, rows_from_table(table)), repeats=2, long=2.0)


def seconds_per_point(law: MembraneLaw, E: Array, offset: float = 1e-3, count: int = POINTS) -> float:
    """Seconds for energy, stress and tangent of one of many points; nan where the law answers none of them."""
    try:
        X = near_surface(law, E, offset, count)
        return least_seconds(partial(law.response, X))[1] / count
    except ProjectionError:
        return float("nan")


ERROR_COLUMNS = (
    Column("h: largest error", ".1e"),
    Column("h: mean", ".1e"),
    Column("E: largest error", ".1e"),
    Column("E: mean", ".1e"),
    Column(f"E above {LIMIT:.0e}", ".1%"),
    Column("no unique E", "d"),
)


def error_cells(got: Errors) -> tuple[Value, ...]:
    """The cells under `ERROR_COLUMNS`."""
    return got.h_max, got.h_mean, got.E_max, got.E_mean, got.above, got.none


def spacing_rows(
    tables: Sequence[tuple[str, StrainTable, float, float]], unseen: StrainTable
) -> list[tuple[tuple[Value, ...], Errors]]:
    """A row and its errors for each named table, its seconds, and the resolution it is fitted with."""
    out: list[tuple[tuple[Value, ...], Errors]] = []
    S = unseen.S / trace(unseen.S)[:, None]
    for name, table, seconds, resolution in tables:
        law, fit = made(table, resolution=resolution)
        got = errors_of(law, unseen)
        bounds = bounds_of(rows_from_table(table))
        gap = float((bounds.upper(S) - bounds.lower(S)).max())
        setting = f"{resolution:.0e}", parameters(law)
        row: tuple[Value, ...] = (name, len(table), *setting, *error_cells(got), gap, seconds, fit)
        out.append((row, got))
    return out


def spacing_table(rows: Sequence[tuple[Value, ...]]) -> Table:
    """Error against the rows of the table."""
    columns = (
        Column("table"),
        Column("rows", "d"),
        Column("resolution"),
        Column("numbers in the law", "d"),
        *ERROR_COLUMNS,
        Column("outer less inner bound", ".1e"),
        Column("s for the table", ".3g", timed=True),
        Column("s for the fit", ".2g", timed=True),
    )
    note = (
        "The graded table (`rve table --graded`) has 0.5 to 2.5 degrees where strains change fast, at beta near 0 and "
        "90 and alpha beyond 30, and 5 degrees elsewhere; `resolution` (`homogenize fit --resolution`) is the "
        "difference of h that is worth another half-space. The bounds need no reference."
    )
    return Table("Refined law: error against the rows of its table", columns, tuple(rows), note)


def kind_rows(table: StrainTable, graded: StrainTable, unseen: StrainTable) -> list[tuple[tuple[Value, ...], Errors]]:
    """A row and its errors for each kind of law from the 5 degree table, and for the refined one from the graded."""
    out: list[tuple[tuple[Value, ...], Errors]] = []
    variants = [(kind, kind, table, refine.NEWS) for kind in KINDS]
    variants.append(("refined, graded", "refined", graded, GRADED_RESOLUTION))
    for name, kind, from_table, resolution in variants:
        law, fit = made(from_table, kind, resolution)
        got = errors_of(law, unseen)
        few = POINTS if kind != "smooth" else POINTS // 20
        us = 1e6 * seconds_per_point(law, rows_from_table(from_table).E, 1e-3, few)
        row: tuple[Value, ...] = (name, parameters(law), *error_cells(got), fit, us)
        out.append((row, got))
    return out


def kind_table(rows: Sequence[tuple[Value, ...]], table: StrainTable, unseen: StrainTable) -> Table:
    """Error against the numbers in the law and its time."""
    columns = (
        Column("law"),
        Column("numbers", "d"),
        *ERROR_COLUMNS,
        Column("s for the fit", ".2g", timed=True),
        Column("us per point", ".2g", timed=True),
    )
    plain = []
    for method in ("linear", "cubic"):
        E = angle_interpolant(table, method).strain(unseen.alpha_deg, unseen.beta_deg)
        error = np.abs(E - unseen.E).max(axis=1)[unseen.unique]
        plain.append(f"{method} mean {error.mean():.1e}, max {error.max():.1e}, {np.mean(error > LIMIT):.1%} above")
    note = (
        "Times are for energy, stress and tangent up to 2e-3 beyond locking. Without any law, E interpolated over the "
        f"two angles of the 5 degree table: {'; '.join(plain)} {LIMIT:.0e}."
    )
    return Table("Kinds of law from 190 rows: error against size and time", columns, tuple(rows), note)


def speed_table(laws: Sequence[tuple[str, MembraneLaw, Array]]) -> Table:
    """Million points per second of laws (name, law, strains of its table) at distances from the surface."""
    columns = (Column("offset beyond the surface", ".0e"), *(Column(name, ".2f", timed=True) for name, _, _ in laws))
    rows = tuple((offset, *(1e-6 / seconds_per_point(law, E, offset) for _, law, E in laws)) for offset in OFFSETS)
    return Table("Response, million points per second", columns, rows)


def measure(full: bool) -> Section:
    """The section: spacing of the table, kinds of law, speed."""
    unseen = unseen_directions(2000 if full else 600)
    steps = (15.0, 10.0, 5.0, 2.5) + (1.25,) * full
    uniform = {step: least_seconds(partial(uniform_table, step), long=0.0) for step in steps}
    graded, t_graded = least_seconds(lambda: solve_table(*graded_grid()), long=0.0)
    named = [(f"{step:g} degrees", table, t, refine.NEWS) for step, (table, t) in uniform.items()]
    named += [("5 degrees", *uniform[5.0], GRADED_RESOLUTION), ("2.5 degrees", *uniform[2.5], GRADED_RESOLUTION)]
    named += [("graded", graded, t_graded, resolution) for resolution in (refine.NEWS, GRADED_RESOLUTION, 3e-6)]
    spaced = spacing_rows(named, unseen)
    kinds = kind_rows(uniform[5.0][0], graded, unseen)
    laws = [
        (f"refined, {name}", made(table, resolution=resolution)[0], rows_from_table(table).E)
        for name, table, resolution in (
            ("5 degrees", uniform[5.0][0], refine.NEWS),
            ("graded", graded, GRADED_RESOLUTION),
        )
    ]
    tables = (
        spacing_table([row for row, _ in spaced]),
        kind_table([row for row, _ in kinds], uniform[5.0][0], unseen),
        speed_table(laws),
    )
    return Section(
        "law", "Membrane laws", text(len(unseen)), tables, diagrams(spaced, kinds), conclusion(spaced, kinds)
    )


def text(count: int) -> str:
    """What is measured."""
    return (
        f"Laws from strain tables of r1/r2 = 10 against {count} random directions that no fit has seen, each solved by "
        "`rve` directly. h is the support function max S:E at unit trace of S (the work of a load, which a curtain's "
        "energy is made of), E the strain under a Cauchy load direction; strains range over 0.75."
    )


def diagrams(
    spaced: Sequence[tuple[tuple[Value, ...], Errors]], kinds: Sequence[tuple[tuple[Value, ...], Errors]]
) -> tuple[Diagram, ...]:
    """Error against rows, numbers, and evaluation time."""

    def curve(name: str, rows: Sequence[tuple[tuple[Value, ...], Errors]], column: int, what: str) -> Curve:
        y = tuple(float(str(row[column])) for row, _ in rows)
        return Curve(name, tuple(getattr(got, what) for _, got in rows), y)

    plain = [pair for pair in spaced if pair[0][0] != "graded" and pair[0][2] == f"{refine.NEWS:.0e}"]
    fine = [pair for pair in spaced if pair[0][0] != "graded" and pair not in plain]
    graded = [pair for pair in spaced if pair[0][0] == "graded"]
    groups = (("uniform", plain), ("uniform, finer facets", fine), ("graded", graded))
    by_rows = tuple(
        curve(f"{name}: {label}", rows, 1, what)
        for label, what in (("mean of h", "h_mean"), ("largest of E", "E_max"))
        for name, rows in groups
    )
    by_time = tuple(curve(str(row[0]), [(row, got)], -1, "h_mean") for row, got in kinds)
    by_size = tuple(curve(str(row[0]), [(row, got)], 1, "h_mean") for row, got in kinds)
    return (
        Diagram("law_rows", "Refined law: error against rows of the table", "error", "rows of the table", by_rows),
        Diagram("law_size", "Kinds of law: error against numbers", "mean error of h", "numbers in the law", by_size),
        Diagram("law_time", "Kinds of law: error against time", "mean error of h", "us per point", by_time),
    )


def conclusion(
    spaced: Sequence[tuple[tuple[Value, ...], Errors]], kinds: Sequence[tuple[tuple[Value, ...], Errors]]
) -> str:
    """What follows, in numbers of this run."""
    by_name = {(row[0], row[2]): got for row, got in spaced}
    coarse, fine = f"{refine.NEWS:.0e}", f"{GRADED_RESOLUTION:.0e}"
    default, dense = by_name["5 degrees", coarse], by_name["2.5 degrees", coarse]
    graded, both = by_name["graded", coarse], by_name["graded", fine]
    rows = {row[0]: row[1] for row, _ in spaced}
    of_kind = {row[0]: got for row, got in kinds}
    refined = of_kind["refined"]
    better = [str(name) for name, got in of_kind.items() if got.h_mean < refined.h_mean and name != "refined, graded"]
    verdict = f"{', '.join(better)} would be better" if better else "no other kind has a smaller mean error of h"
    return (
        f"The refined law is the default: from the same 190 rows {verdict} (refined {refined.h_mean:.1e}, inner "
        f"{of_kind['inner'].h_mean:.1e}, smooth {of_kind['smooth'].h_mean:.1e}).\n\n"
        f"From {rows['5 degrees']} rows {default.above:.1%} of the strains miss {LIMIT:.0e} (largest error "
        f"{default.E_max:.1e}), where strains turn fast: beta near 0 and 90, alpha > 30 degrees. Twice the density "
        f"({rows['2.5 degrees']} rows) leaves {dense.above:.1%} (largest {dense.E_max:.1e}), the graded table "
        f"({rows['graded']} rows) {graded.above:.1%} (largest {graded.E_max:.1e}). With finer facets its mean error of "
        f"E falls from {graded.E_mean:.1e} to {both.E_mean:.1e} ({default.E_mean:.1e} from 190 rows), of h from "
        f"{graded.h_mean:.1e} to {both.h_mean:.1e}. With finer facets alone the 190 "
        f"rows miss {by_name['5 degrees', fine].above:.1%}."
    )
