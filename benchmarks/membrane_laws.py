"""Which membrane law? Error against rows, parameters and evaluation time, on directions that no fit has seen.

    python benchmarks/membrane_laws.py TABLE.csv DIRECTIONS.csv

TABLE is the paper's grid (`python -m rve table --out TABLE.csv`), DIRECTIONS are random loads solved on their own
(`python -m rve table --loads loads.csv --out DIRECTIONS.csv`); both ship in tests/test_homogenize/data. Times are CPU
times of one core (set OMP_NUM_THREADS=1), the least of three.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from pathlib import Path

import click
import numpy as np

import homogenize.refine as refine
from homogenize.fit import STATED_STIFFNESS, builder, cell_of
from homogenize.interpolated import angle_interpolant
from homogenize.polyhedral import polyhedral_law
from homogenize.projection import ProjectionError
from homogenize.protocol import Array, InputError, MembraneLaw
from homogenize.rows import Rows, rows_from_table, subset
from homogenize.strain import locked_strain
from homogenize.tensor import double_dot, from_disc, trace
from rve.table import StrainTable, read_table

DATA = Path(__file__).parents[1] / "tests" / "test_homogenize" / "data"
KINDS = ("net", "interpolated", "inner", "outer", "refined", "smooth")
POINTS = 100_000
OFFSETS = (1e-4, 1e-3, 1e-2, 5e-2)


def least_time(call: Callable[[], object], repeats: int = 3) -> float:
    """CPU seconds of the quickest of a few calls."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return min(times)


def support_error(law: MembraneLaw, S: Array, E: Array) -> Array:
    """|h(S) - S:E| at unit trace of S, (n,)."""
    S = S / trace(S)[:, None]
    return np.asarray(np.abs(law.support(S) - double_dot(S, E)))


def strain_error(law: MembraneLaw, table: StrainTable) -> Array:
    """Largest component error of E per direction with a unique strain, (n,); nan where the law has no answer."""
    found = locked_strain(law, table.alpha_deg, table.beta_deg)
    error = np.abs(found.E - table.E).max(axis=1)
    return np.where(found.status == "converged", error, np.nan)[table.unique & found.unique]


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


def compare_kinds(table: StrainTable, directions: StrainTable) -> None:
    """One line per kind of law."""
    rows, cell = rows_from_table(table), cell_of(table)
    print("kind          numbers  fit s   h max    h mean   E mean   E>5e-3  no E   us/point")
    for kind in KINDS:
        build = builder(kind, cell, STATED_STIFFNESS * np.eye(3), table)
        start = time.process_time()
        law = build(rows)
        fit_s = time.process_time() - start
        h = support_error(law, directions.S, directions.E)
        try:
            E = strain_error(law, directions)
            X = near_surface(law, rows.E, 1e-3, POINTS if kind != "smooth" else POINTS // 20)
            law.response(X[:1000])
            per_point = f"{least_time(lambda law=law, X=X: law.response(X)) / len(X) * 1e6:8.2f}"
            strain = "no load has a unique strain"
            if len(E):
                strain = f"{np.nanmean(E):.1e}  {np.mean(E > 5e-3):6.1%}  {np.isnan(E).sum():4d}"
        except ProjectionError as error:
            strain, per_point = f"failed: {error}", ""
        print(f"{kind:13s} {parameters(law):7d}  {fit_s:5.2f}  {h.max():.1e}  {h.mean():.1e}  {strain}  {per_point}")


def plain_interpolation(table: StrainTable, directions: StrainTable) -> None:
    """The strain alone, interpolated over the two angles: no law, no energy, but what one would try first."""
    for method in ("linear", "cubic"):
        E = angle_interpolant(table, method).strain(directions.alpha_deg, directions.beta_deg)
        error = np.abs(E - directions.E).max(axis=1)[directions.unique]
        above = np.mean(error > 5e-3)
        print(f"E(alpha, beta) {method}: E mean {error.mean():.1e}, max {error.max():.1e}, {above:.1%} > 5e-3")


def compare_rows(table: StrainTable, directions: StrainTable) -> None:
    """Error of the default law against the number of rows: every second, third angle of the grid."""
    rows = rows_from_table(table)
    alpha, beta = table.alpha_deg[rows.source], table.beta_deg[rows.source]
    print("\nstep deg  rows   h max    h mean   outer-inner max")
    for step in (5.0, 15.0, 45.0):
        few: Rows = subset(rows, (alpha % step == 0.0) & (beta % step == 0.0))
        try:
            law = polyhedral_law(*refine.refined_half_spaces(few))
        except InputError as error:
            print(f"{step:8.0f}  {len(few):4d}   refused: {error}")
            continue
        h = support_error(law, directions.S, directions.E)
        bounds = refine.bounds_of(few)
        S = directions.S / trace(directions.S)[:, None]
        gap = bounds.upper(S) - bounds.lower(S)
        print(f"{step:8.0f}  {len(few):4d}   {h.max():.1e}  {h.mean():.1e}  {gap.max():.1e}")


def time_response(table: StrainTable) -> None:
    """Points per second of the default law against the distance from the surface, and what the machine allows."""
    rows = rows_from_table(table)
    law = polyhedral_law(*refine.refined_half_spaces(rows))
    start = time.process_time()
    law.response(np.tile(rows.E, (2, 1)))
    print(f"\nmap of {len(law.h)} half-spaces made in {time.process_time() - start:.2f} s")
    for offset in OFFSETS:
        X = near_surface(law, rows.E, offset)
        print(
            f"{offset:.0e} beyond the surface: {POINTS / least_time(lambda X=X: law.response(X)) / 1e6:.2f} M points/s"
        )
    x = np.linspace(0.0, 1.0, 2048)
    out = np.empty((POINTS, 16))
    fill = least_time(lambda: out.fill(1.0)) / POINTS
    exponential, product = (
        least_time(lambda: [np.exp(x) for _ in range(1000)]),
        least_time(lambda: [x * x for _ in range(1000)]),
    )
    print(
        f"floor: writing 16 numbers {fill * 1e9:.1f} ns per point, one exp {exponential / 2048e3 * 1e9:.2f} ns, "
        f"one product {product / 2048e3 * 1e9:.2f} ns"
    )


@click.command()
@click.argument("table", default=str(DATA / "table190.csv"))
@click.argument("directions", default=str(DATA / "directions.csv"))
def main(table: str, directions: str) -> None:
    """Prints the comparison."""
    grid, unseen = read_table(table), read_table(directions)
    compare_kinds(grid, unseen)
    plain_interpolation(grid, unseen)
    compare_rows(grid, unseen)
    time_response(grid)
    print(f"\n{platform.processor() or platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}")


if __name__ == "__main__":
    main()
