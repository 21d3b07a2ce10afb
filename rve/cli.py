"""Command line: `python -m rve table`, `case`, `support`, `sweep`, `study`, `weaves`; `--help` says what each takes.

How commands end: `rve.common.commands.command_line`.
"""

import itertools
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

from rve.common import SENTENCES, InputError, NotConverged, numbers_of, read_json_object, sidecar_path, tell
from rve.common.cell_fields import Joint, check_ring_size
from rve.common.commands.command_line import Group, answer, check_plot, options, parse_load, say, say_next
from rve.common.commands.sweeps import SweepItem, further_options, run_sweep, sweep_options
from rve.common.materials import MATERIALS, material_of
from rve.common.typed import BadField

MOST_TABLES = 10_000
FIT_FROM = 10
"""Rows from which a law is offered."""

WEAVE_NAMES = ("4-in-1", "6-in-1", "8-in-1", "japanese-4-in-1", "japanese-6-in-1")
"""The names in `rve.geometry.weave.WEAVES`, which NumPy need not be imported for."""

FILE = click.Path(dir_okay=False, path_type=Path)


def _choice(name: str, *words: str, text: str) -> Any:
    """An option for one of some words, by default the first."""
    return click.option(name, type=click.Choice(words), default=words[0], show_default=True, help=text)


grain_option = _choice(
    "--grain", "y", "x", text="Axis along which rings interlace; x exchanges the axes: 6-in-1 is then its mirror image."
)
cell_options = options(
    click.option("--r1", type=float, help="Radius of a ring's centre circle in mm.  [default: 5, or that in the file]"),
    click.option("--r2", type=float, help="Radius of the wire in mm.  [default: 0.5, or that in the file]"),
    click.option("--material", help=f"Named material: {', '.join(MATERIALS)}.  [default: steel]"),
    click.option("--density", type=float, help="Density of the rings in kg/m3; by default the material's."),
    click.option("--young", type=float, help="Young's modulus in N/mm2; by default the material's."),
    click.option("--poisson", type=float, help="Poisson's ratio, without unit; by default the material's."),
    click.option("--yield", type=float, help="Yield stress in N/mm2; by default the material's."),
    click.option("--ultimate", type=float, help="Ultimate stress in N/mm2; by default the material's."),
    click.option(
        "--weave", default=WEAVE_NAMES[0], show_default=True, help=f"{', '.join(WEAVE_NAMES)}, or a TOML file."
    ),
    grain_option,
)
larger_options = options(
    click.option("--cells", default="1x1", show_default=True, help="Primitive cells that move independently, as 2x2."),
    _choice("--centres", "plane", "space", text="Where the centres of rings may be."),
)
coexisting = "Where several locked states coexist: that of largest work, or the first from the slack pose."
referred = "Cell that strains refer to under a pull along the grain: symmetric in the grain, or the longest one."
branch_options = options(
    _choice("--branches", "largest", "first", text=coexisting),
    _choice("--reference", "side-by-side", "locked", text=referred),
)


def asked_cell(
    r1: float | None,
    r2: float | None,
    grain: Any,
    weave: str,
    cells: str = "1x1",
    centres: Any = "plane",
    **material: Any,
) -> Any:
    """The cell asked for; InputError for rings that no mesh has."""
    from rve.geometry.cell import Cell
    from rve.geometry.weave import named_weave, sizes_of

    try:
        asked, sizes = named_weave(weave), sizes_of(weave)
    except InputError as error:
        raise InputError(f"--weave = {weave}: {error}") from None
    r1, r2 = sizes[0] if r1 is None else r1, sizes[1] if r2 is None else r2
    check_ring_size(r1, "--r1")
    metal = material_of(material, prefix="--")
    try:
        nx, ny = (int(part) for part in cells.split("x"))
    except ValueError:
        raise InputError(f"--cells = {cells}: write two numbers, such as 2x2") from None
    try:
        return Cell(r1, r2, asked, grain, metal.density_kg_per_mm3, metal, (nx, ny), centres)
    except BadField as error:
        raise InputError(f"--{error.what}") from None


def asked_directions(
    weave: Any, loads: Path | None, graded: bool, alpha: str | None, beta: str | None
) -> tuple[Any, Any]:
    """The load directions asked for: a file, the graded set, or a grid; by default one all round the weave."""
    import numpy as np

    from rve.directions import graded_grid, grid, parse_angles, product, read_loads

    if (loads is not None) + graded + (alpha is not None or beta is not None) > 1:
        raise InputError("--loads, --graded and --alpha with --beta are three ways to say which loads: give one")
    if loads is not None:
        return read_loads(loads)
    if graded:
        return graded_grid(weave)
    first = np.unique(grid(5.0, weave).alpha_deg) if alpha is None else parse_angles(alpha, "--alpha")
    return product(first, parse_angles("0:90:5" if beta is None else beta, "--beta"))


@click.group(cls=Group)
def main() -> None:
    """Where a periodic cell of rigid interlinked rings locks under each line load."""


@main.command(epilog="Example: rve table --out table.csv --r1 6 --r2 0.6 --material 'titanium grade 2' --rings")
@click.option("--out", required=True, type=FILE, help="CSV file to write.")
@click.option(
    "--alpha", help="Principal angles in degrees, FIRST:LAST:STEP or A,B,...  [default: 0:45:5; -40:45:5 if chiral]"
)
@click.option("--beta", help="Ratio angles in degrees, as --alpha.  [default: 0:90:5]")
@click.option("--loads", type=click.Path(path_type=Path), help="CSV with alpha_deg, beta_deg instead of a grid.")
@click.option("--graded", is_flag=True, help="403 directions, close where strains change fast, instead of a grid.")
@click.option("--rings", is_flag=True, help="Add stiffness (dE/dS) and strength columns of the rings' own wire.")
@click.option("--joint", help="With --rings: welded, butted:ANGLE (degrees from the grain) or butted:worst.")
@branch_options
@larger_options
@cell_options
def table(out: Path, rings: bool, joint: str | None, branches: Any, reference: Any, **rest: Any) -> None:
    """Write the strain-load table of a grid or a list of load directions."""
    from rve.locking.interior_point import DirectOptions
    from rve.solve import solve_table
    from rve.table import check_out_table, write_table
    from rve.wire.cell_stiffness import with_rings

    if joint is not None and not rings:
        raise InputError("--joint: belongs to --rings, which is not given")
    closed = Joint.of("welded" if joint is None else joint, "--joint").name
    asked = {name: rest.pop(name) for name in ("loads", "graded", "alpha", "beta")}
    mesh = asked_cell(**rest)
    directions = asked_directions(mesh.weave, **asked)
    check_out_table(out, inputs=[asked["loads"]])
    found = solve_table(mesh, directions, DirectOptions(branches=branches, reference=reference))
    if rings:
        found = with_rings(found, mesh, closed)
    write_table(found, out)
    _say_of_table(found, out)
    answer(read_json_object(sidecar_path(out)))
    if found.converged.sum() >= FIT_FROM:
        say_next("homogenize", "fit", out, "--out", out.with_name(f"{out.stem}_law.json"), why="a law from this table")


def _say_of_table(found: Any, out: Path) -> None:
    """Rows by status, and what is particular about some."""
    free = int((~found.unique & found.converged).sum())
    several = 0 if found.branch is None else int((found.branch != "slack").sum())
    say(f"{out}: {found.converged.sum()} of {len(found)} rows converged in {found.origin.notes['wall_s']:.1f} s")
    if free:
        say(f"{free} rows leave the strain free (unique = 0); their E is the limit from inside the tensile cone")
    if several:
        say(f"{several} rows have several locked states; theirs is of largest work (column branch, JSON)")
    if found.origin.notes["bound_note"]:
        say(found.origin.notes["bound_note"])
    for status in sorted(set(found.status) - {"converged"}):
        say(f"{(found.status == status).sum()} rows {status}: {SENTENCES[str(status)]}")


@main.command(epilog="Example: rve case --alpha 45 --beta 0 --plot case.png")
@click.option("--alpha", type=float, required=True, help="Principal angle in degrees.")
@click.option("--beta", type=float, required=True, help="Ratio angle in degrees.")
@click.option("--plot", type=FILE, help="Picture to write, PNG, SVG or PDF.")
@cell_options
def case(alpha: float, beta: float, plot: Path | None, **cell: Any) -> None:
    """Solve one load direction and print its locked state as JSON."""
    from rve.common.drawing.plane import save_figure
    from rve.plots import draw_case
    from rve.solve import solve_table
    from rve.table import COLUMNS

    if plot is not None:
        check_plot(plot)
    found = solve_table(asked_cell(**cell), ([alpha], [beta]))
    status = str(found.status[0])
    if status != "converged":
        raise NotConverged(f"{status}: {SENTENCES[status]}")
    assert found.cell is not None
    row = {name: column[0] for name, column in found.columns().items() if name in COLUMNS}
    answer(row | {"areal_mass_kg_per_m2": found.cell.areal_mass_kg_per_m2}, always=True)
    if plot is not None:
        tell(f"drawing {plot}")
        save_figure(plot, draw_case(found).figure)


@main.command(name="support", epilog="Example: rve support --S 0.5,-0.1,0.5")
@click.option("--S", "load", required=True, help="S11,S12,S22: dead line load, positive semidefinite, any unit.")
@branch_options
@larger_options
@cell_options
def support_command(load: str, branches: Any, reference: Any, **cell: Any) -> None:
    """Print h = max S:E of a dead second Piola-Kirchhoff load and the locked state that reaches it, as JSON."""
    from rve.locking.interior_point import DirectOptions
    from rve.support_function import support

    mesh = asked_cell(**cell)
    found = support(mesh, parse_load(load), DirectOptions(branches=branches, reference=reference))
    status = str(found.status[0])
    if status != "converged":
        raise NotConverged(f"S = {load}: {status}: {SENTENCES[status]}")
    if mesh.bound_note:
        say(mesh.bound_note, err=True)
    answer(found.row(0), always=True)


@main.command(
    context_settings={"ignore_unknown_options": True},
    epilog="Example: rve sweep --out tables --r1 5,6 --r2 0.5,0.6 --jobs 2 --rings",
)
@sweep_options
@click.option("--r1", required=True, help="Radii of rings' centre circles in mm, with commas.")
@click.option("--r2", required=True, help="Radii of wires in mm, with commas.")
@click.option("--weave", default="4-in-1", show_default=True, help=f"Weaves, with commas: {', '.join(WEAVE_NAMES)}.")
@grain_option
@click.argument("further", nargs=-1, type=click.UNPROCESSED)
def sweep(out: Path, r1: str, r2: str, weave: str, grain: str, further: tuple[str, ...], **workers: Any) -> None:
    """Write one table for each weave, r1 and r2, and sweep.csv beside them. FURTHER: options of `rve table`.

    The same command again runs only what is not finished. Exit code 1 if a table failed: sweep.csv says why.
    """
    items = table_items(out, numbers_of(r1, "--r1"), numbers_of(r2, "--r2"), weave.split(","), grain, further)
    finished = run_sweep(items, out, table_columns, **workers)
    if finished[0]["rows_converged"] < FIT_FROM:
        return
    first = out / f"{finished[0]['name']}.csv"
    say_next("homogenize", "fit", first, "--out", first.with_name(f"{first.stem}_law.json"), why="a law from a table")


def table_items(
    out: Path, r1: Sequence[float], r2: Sequence[float], weave: Sequence[str], grain: str, further: Sequence[str]
) -> list[SweepItem]:
    """One table for each weave, r1 and r2 in mm, with `further` options of `rve table`; InputError for too many."""
    cells = list(itertools.product(weave, r1, r2))
    if not 0 < len(cells) <= MOST_TABLES:
        raise InputError(f"--r1, --r2 and --weave: make {len(cells)} tables, at most {MOST_TABLES} are allowed")
    further = further_options(further, ("--out", "--r1", "--r2", "--weave", "--grain"))
    items = []
    for name, big, small in cells:
        r1_text, r2_text = (repr(float(one)).removesuffix(".0") for one in (big, small))  # another name for each number
        table = out.resolve() / f"{Path(name).name.removesuffix('.toml')}_{grain}_r1-{r1_text}_r2-{r2_text}.csv"
        asked = ("--weave", name, "--grain", grain, "--r1", repr(big), "--r2", repr(small))
        arguments = ("table", "--out", str(table), *asked, *further)
        items.append(SweepItem(table.stem, "rve", arguments, sidecar_path(table)))
    return items


def table_columns(record: Mapping[str, Any]) -> dict[str, Any]:
    """What sweep.csv says of a table, from its sidecar: cell, reference cell, areal mass, rows by status."""
    names = ("weave", "grain", "r1_mm", "r2_mm", "b_x_mm", "b_y_mm", "areal_mass_kg_per_m2")
    rows = record.get("rows", {})
    converged = rows.get("converged", 0)
    counts = {"rows_converged": converged, "rows_other": sum(rows.values()) - converged}
    return {name: record.get(name, "") for name in names} | counts


@main.command(epilog="Example: rve weaves --r1 6 --r2 0.6")
@cell_options
def weaves(weave: str, **rest: Any) -> None:
    """Print the weaves of the catalogue, with the one of --weave where that is a file: rings of a cell, least r1/r2 and
    aspect ratio (inner diameter over wire), and mass and rings per area where such rings make a mesh."""
    from rve.geometry.weave import WEAVES, named_weave
    from rve.solve import reference_cell

    rows = []
    for name in dict.fromkeys((*WEAVES, weave)):
        one = named_weave(name)
        row = {"weave": one.name, "rings_a_cell": one.classes, "sizes": len({*zip(one.radii, one.wires, strict=True)})}
        row |= {"least_r1_over_r2": one.jamming_ratio, "least_aspect_ratio": one.jamming_ratio - 1.0}
        with suppress(InputError):  # wire that is too thick for this weave
            info = reference_cell(asked_cell(weave=name, **rest))
            row |= {"areal_mass_kg_per_m2": info.areal_mass_kg_per_m2, "b_x_mm": info.b_x_mm, "b_y_mm": info.b_y_mm}
            row |= {"rings_per_m2": 1e6 * one.classes / (info.b_x_mm * info.b_y_mm)}
        rows.append(row)
    names = max(len(str(row["weave"])) for row in rows)
    lines = [f"{'weave':{names}}  rings  least r1/r2    AR  kg/m2  rings/m2"]
    for row in rows:
        mass, count = row.get("areal_mass_kg_per_m2"), row.get("rings_per_m2")
        there = "  too thick" if mass is None else f"  {mass:5.2f}  {count:8.0f}"
        sizes = f"{row['rings_a_cell']:5d}  {row['least_r1_over_r2']:11.3f}  {row['least_aspect_ratio']:4.2f}"
        lines.append(f"{row['weave']:{names}}  {sizes}{there}")
    answer({"weaves": rows}, "\n".join(lines))


@main.command(epilog="Example: rve study --out study")
@click.option("--out", required=True, type=click.Path(file_okay=False, path_type=Path), help="Folder to write into.")
def study(out: Path) -> None:
    """Reproduce the paper's figures 9-17 for this implementation, and set its published figures beside ours."""
    from rve.simulation.study import RECORD, comparison, markdown, run_study

    found = run_study(out)
    say(markdown(comparison(found)).rstrip())
    answer(read_json_object(out / RECORD))
    say_next("rve", "table", "--out", out / "table.csv", why="the same cases by the direct solver, as a table")
