"""The command line: fit, strain, support, strength, plot, export."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from rve.common import InputError, check_out_file, check_out_job, radii_in, read_entry, require, types_of
from rve.common.cell_fields import check_ring_size
from rve.common.commands.command_line import Group, answer, check_plot, parse_load, say, say_next
from rve.common.materials import Stress

KINDS, CONTRADICTIONS = ("refined", "outer", "inner", "net"), ("list", "drop", "mend")
"""Those of `homogenize.fitting.fit_law`, which is not imported to print a help text."""


@click.group(cls=Group)
def main() -> None:
    """From a strain-load table to a convex, tension-only membrane law."""


@main.command(epilog="Example: homogenize fit table.csv --out law.json")
@click.argument("table", type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Law file to write, JSON.")
@click.option("--kind", type=click.Choice(KINDS), help="Kind of law.  [default: refined]")
@click.option(
    "--noise", type=float, help="Strain error, without unit, to allow in the normality test.  [default: 1e-8]"
)
@click.option(
    "--resolution",
    type=float,
    help="Strain that is worth a facet of the refined law; 1e-5 suits a --graded table.  [default: 3e-5]",
)
@click.option(
    "--contradictions",
    type=click.Choice(CONTRADICTIONS),
    help="Rows that contradict each other: refuse them by a list, leave them out, or mend them.  [default: list]",
)
@click.option(
    "--cell", metavar="R1,R2[,WEAVE]", help="Rings of a TABLE that tells none: radii, or inner=8,wire=1.6; mm."
)
@click.option("--areal-mass", type=float, help="Mass of the mesh in kg/m2; by default that of the rings.")
@click.option("--mirrored/--not-mirrored", default=True, help="Whether every row of TABLE stands for its mirror image.")
def fit(table: Path, out: Path, noise: float | None, cell: str | None, **more: Any) -> None:
    """Fit a law to TABLE, write it and print how wrong it can be.

    TABLE needs the columns E11, E12, E22 and either S11, S12, S22 in any unit or alpha_deg, beta_deg.
    """
    from homogenize.fitting.fit_law import FitOptions, fit_table
    from rve import Cell

    check_out_file(out, inputs=[table])
    asked = {key: value for key, value in {"normality": noise, **more}.items() if value is not None}
    for option, name in (("--noise", "normality"), ("--resolution", "resolution"), ("--areal-mass", "areal_mass")):
        if name in asked:
            read_entry({option: asked[name]}, option, types_of(FitOptions)[name])
    if cell is not None:
        sizes, weave = cell.split(",")[:2], cell.split(",")[2:]
        r1, r2 = radii_in(",".join(sizes), "--cell")
        check_ring_size(r1, "--cell: r1")
        asked["cell"] = Cell(r1, r2, *weave[:1])  # type: ignore[arg-type]
    result = fit_table(table, FitOptions(**asked))
    result.save(out)
    say(result.report.text())
    if result.law.strength is not None:
        say(result.law.strength.text())
    say(f"law written to {out}", f"a curtain of it: python -m macro_fem run SCENE --law {out} --out FOLDER")
    answer({"law": str(out), "report": asdict(result.report)})
    say_next(
        "homogenize", "plot", out, "--table", table, "--out", out.with_name(f"{out.stem}_pictures"), why="pictures"
    )


@main.command(epilog="Example: homogenize strain law.json --alpha 20 --beta 30")
@click.argument("law", type=click.Path(path_type=Path))
@click.option("--alpha", required=True, type=float, help="Principal angle of the Cauchy load in degrees.")
@click.option("--beta", required=True, type=float, help="Ratio angle of the Cauchy load in degrees.")
def strain(law: Path, alpha: float, beta: float) -> None:
    """Print the locked strain under a Cauchy load direction, in the paper's rotation rule, as one JSON object."""
    from homogenize.query.answers import strain_answer

    answer(strain_answer(law, alpha, beta), always=True)


@main.command(epilog="Example: homogenize support law.json --S 0.5,-0.1,0.5")
@click.argument("law", type=click.Path(path_type=Path))
@click.option("--S", "load", required=True, help="S11,S12,S22: tensile second Piola-Kirchhoff line load, any unit.")
@click.option("--strings", is_flag=True, help="Add h_strings: rings drawn to loops that stretch no more.")
def support(law: Path, load: str, strings: bool) -> None:
    """Print h = max S:E of the law as one JSON object."""
    from homogenize.query.answers import support_answer

    answer(support_answer(law, parse_load(load), strings), always=True)


@main.command(epilog="Example: homogenize strength law.json --S 0,0,1 --yield 275")
@click.argument("law", type=click.Path(path_type=Path))
@click.option("--S", "load", help="S11,S12,S22: direction of a tensile line load, any unit.")
@click.option("--plot", type=click.Path(path_type=Path), help="Picture to write, PNG: the strength over all loads.")
@click.option("--yield", "yield_stress", type=float, help="Yield stress in N/mm2; by default the material's.")
def strength(law: Path, load: str | None, plot: Path | None, yield_stress: float | None) -> None:
    """Print the line loads in N/mm, S of unit trace times what is printed, at which rings first yield and collapse."""
    from homogenize.query.answers import strength_answer

    if load is None and plot is None:
        raise InputError("give --S S11,S12,S22 for the strength along a load, --plot FILE for a picture, or both")
    if yield_stress is not None:
        read_entry({"--yield": yield_stress}, "--yield", Stress)
    if plot is not None:
        check_plot(plot, inputs=[law])
    found = strength_answer(law, parse_load("1,0,1" if load is None else load), yield_stress)  # pictures need it too
    if load is not None:
        answer(found, always=True)
    if plot is not None:
        from homogenize.io import load_law
        from rve.common.drawing.plane import save_figure

        save_figure(plot, load_law(law).plot_strength(yield_stress)[0].figure)
        say(f"picture written to {plot}", err=True)
        if load is None:
            answer({"picture": str(plot)})


@main.command(epilog="Example: homogenize plot law.json --table table.csv --out pictures")
@click.argument("law", type=click.Path(path_type=Path))
@click.option("--table", required=True, type=click.Path(path_type=Path), help="Table to show beside the law, CSV.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder to write into.")
def plot(law: Path, table: Path, out: Path) -> None:
    """Draw the locking surface, the strains over the load angles, the errors and sections of LAW."""
    from homogenize.io import load_law
    from homogenize.plots import RECORD, write_pictures
    from rve import read_table

    require("matplotlib", "plots", "homogenize plot")
    check_out_job(out, RECORD, inputs=[law, table])
    pictures = write_pictures(load_law(law), read_table(table), out, [law, table])
    say(*(f"picture written to {path}" for path in pictures))
    answer({"pictures": [str(path) for path in pictures]})
    say_next("homogenize", "strain", law, "--alpha", 20, "--beta", 30, why="what the law says of one load")


@main.command(epilog="Example: homogenize export law.json --out law.f")
@click.argument("law", type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Fortran source to write, .f.")
def export(law: Path, out: Path) -> None:
    """Write LAW as a user material (UMAT, Fortran 77) for membranes in plane stress."""
    from homogenize.export.umat import write_umat
    from homogenize.io import load_law
    from homogenize.laws.stored import strength_of_law

    check_out_file(out, inputs=[law])
    found = load_law(law)
    write_umat(found, out, f"law file {law.name}")
    by_direction = "; beyond locking it has one stiffness, while curtains of kind 'elastic' use that of each direction"
    say(f"user material written to {out}{'' if strength_of_law(found) is None else by_direction}")
    answer({"umat": str(out)})
    say_next("homogenize", "strain", law, "--alpha", 45, "--beta", 45, why="a strain to check it with")
