"""The command line: fit, strain, support, strength, report, plot, export. How they end: `rve.common.command_line`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
import numpy as np

from rve.common.command_line import Group
from rve.common.errors import InputError, require
from rve.common.files import check_out_file


@click.group(cls=Group)
def main() -> None:
    """From a strain-load table to a convex, tension-only membrane law."""


@main.command()
@click.argument("table", type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(path_type=Path), help="the law file to write, JSON")
@click.option("--kind", default=None, help="outer, inner or net; default: refined")
@click.option("--noise", default=None, type=float, help="strain error to allow in the normality test (default 1e-8)")
@click.option("--resolution", default=None, type=float, help="facets of the refined law; 1e-5 suits a --graded table")
def fit(table: Path, out: Path, kind: str | None, noise: float | None, resolution: float | None) -> None:
    """Fits a law to TABLE, writes it and prints how wrong it can be."""
    from homogenize.fitting.fit import FitOptions, fit_table

    check_out_file(out, inputs=[table])
    asked: dict[str, Any] = {"kind": kind, "normality": noise, "resolution": resolution}
    result = fit_table(table, FitOptions(**{key: value for key, value in asked.items() if value is not None}))
    result.save(out)
    click.echo(result.report.text())
    if result.law.strength is not None:
        click.echo(result.law.strength.text())
    click.echo(f"law written to {out}")


@main.command()
@click.argument("law", type=click.Path(path_type=Path))
@click.option("--alpha", required=True, type=float, help="principal angle of the Cauchy load, degrees")
@click.option("--beta", required=True, type=float, help="ratio angle of the Cauchy load, degrees")
def strain(law: Path, alpha: float, beta: float) -> None:
    """Prints the locked strain under a Cauchy load direction, in the paper's rotation rule, as one JSON object."""
    from homogenize.query.answers import strain_answer

    click.echo(json.dumps(strain_answer(law, alpha, beta)))


@main.command()
@click.argument("law", type=click.Path(path_type=Path))
@click.option("--S", "load", required=True, help="S11,S12,S22: a tensile second Piola-Kirchhoff line load")
def support(law: Path, load: str) -> None:
    """Prints h = max S:E of the law as one JSON object."""
    from homogenize.query.answers import support_answer

    click.echo(json.dumps(support_answer(law, parse_load(load))))


@main.command()
@click.argument("law", type=click.Path(path_type=Path))
@click.option("--S", "load", help="S11,S12,S22: the direction of a tensile line load")
@click.option("--plot", type=click.Path(path_type=Path), help="picture of the strength over all loads to write, PNG")
@click.option("--yield", "yield_stress", type=float, help="yield stress of the wire, N/mm2; default: the material's")
def strength(law: Path, load: str | None, plot: Path | None, yield_stress: float | None) -> None:
    """Prints the line loads, S of unit trace times what is printed, at which rings first yield and collapse."""
    from homogenize.query.answers import strength_at

    if load is None and plot is None:
        raise InputError("give --S S11,S12,S22 for the strength along a load, --plot FILE for a picture, or both")
    if plot is not None:
        require("matplotlib", "plots", "--plot")
        check_out_file(plot, "--plot", inputs=[law])
    if load is not None:
        click.echo(json.dumps(strength_at(law, parse_load(load), yield_stress)))
    if plot is not None:
        from homogenize.io import load_law
        from homogenize.plots import save_picture

        save_picture(load_law(law).plot_strength(yield_stress)[0].figure, plot)
        click.echo(f"picture written to {plot}", err=True)


@main.command()
@click.argument("law", type=click.Path(path_type=Path))
@click.option("--table", required=True, type=click.Path(path_type=Path), help="the table to show beside the law, CSV")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="the folder for the pictures")
def plot(law: Path, table: Path, out: Path) -> None:
    """Draws the locking surface, the strains over the load angles, the errors and sections of LAW."""
    from homogenize.io import load_law
    from homogenize.plots import RECORD, write_pictures
    from rve import read_table
    from rve.common.jobs import check_out_job

    require("matplotlib", "plots", "homogenize plot")
    check_out_job(out, RECORD, inputs=[law, table])
    for path in write_pictures(load_law(law), read_table(table), out, [law, table]):
        click.echo(f"picture written to {path}")


@main.command()
@click.argument("law", type=click.Path(path_type=Path))
@click.option("--table", required=True, type=click.Path(path_type=Path), help="rows the law has not seen, CSV")
def report(law: Path, table: Path) -> None:
    """Prints the error of LAW at the rows of a table, for instance one made by `rve table --loads`."""
    from homogenize.query.answers import error_at_rows

    click.echo(error_at_rows(law, table))


@main.command()
@click.argument("law", type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(path_type=Path), help="the Fortran source (.f) to write")
def export(law: Path, out: Path) -> None:
    """Writes LAW as a user material (UMAT, Fortran 77) for membranes in plane stress."""
    from homogenize.export.umat import write_umat
    from homogenize.io import load_law, strength_of_law

    check_out_file(out, inputs=[law])
    found = load_law(law)
    write_umat(found, out, f"law file {law.name}")
    by_direction = "; beyond locking it has one stiffness, while curtains of kind 'elastic' use that of each direction"
    click.echo(f"user material written to {out}{'' if strength_of_law(found) is None else by_direction}")


@main.command()
@click.argument("table", type=click.Path(path_type=Path))
def ship(table: Path) -> None:
    """Makes the law inside the package anew from TABLE, the 190 rows of the paper's grid for r1/r2 = 10."""
    from homogenize.fitting.shipped import ship as write_shipped

    click.echo(f"law written to {write_shipped(table)}")


def parse_load(text: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Three numbers from `S11,S12,S22`; InputError says which text is none."""
    parts = text.split(",")
    try:
        S = np.array([float(part) for part in parts])
    except ValueError as error:
        raise InputError(f"--S {text}: expected three numbers S11,S12,S22") from error
    if len(parts) != 3 or not np.isfinite(S).all():
        raise InputError(f"--S {text}: expected three finite numbers S11,S12,S22")
    return S
