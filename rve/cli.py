"""Command line: `python -m rve table`, `case`, `support`, `ring`, `weaves`, `export`, `simulate`, `sweep`, `study`.

How commands end: `rve.common.commands.command_line`.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from rve.common import (
    SENTENCES,
    InputError,
    NotConverged,
    check_out_file,
    digits,
    numbers_of,
    read_json_object,
    sidecar_path,
    tell,
)
from rve.common.cell_fields import Joint, check_ring_size
from rve.common.commands.command_line import Group, answer, check_plot, options, parse_load, say, say_next
from rve.common.commands.sweeps import Row, SweepItem, further_options, run_sweep, sweep_options
from rve.common.materials import MATERIALS, material_of
from rve.common.ring_sizes import RING_SIZES, radii_of, ring_sizes, ring_words
from rve.common.typed import BadField

MOST_TABLES = 10_000
FIT_FROM = 10
"""Rows from which a law is offered."""

WEAVE_NAMES = ("4-in-1", "6-in-1", "8-in-1", "japanese-4-in-1", "japanese-6-in-1", "kings-4-in-1")
"""The names in `rve.geometry.weave.WEAVES`, which NumPy need not be imported for."""

FILE = click.Path(dir_okay=False, path_type=Path)


def _choice(name: str, *words: str, text: str) -> Any:
    """An option for one of some words, by default the first."""
    return click.option(name, type=click.Choice(words), default=words[0], show_default=True, help=text)


grain_option = _choice(
    "--grain", "y", "x", text="Axis along which rings interlace; x exchanges the axes: 6-in-1 is then its mirror image."
)


def ring_options(kind: Any, several: str = "") -> Any:
    """The options for the size of a ring, or of `several`; two of them make it."""
    default = ("", "") if several else ("  [default: 5]", "  [default: 0.5]")
    trade = "Diameter of the wire as a trade size"
    return options(
        click.option("--r1", type=kind, help=f"Radius of a ring's centre circle in mm{several}.{default[0]}"),
        click.option("--r2", type=kind, help=f"Radius of the wire in mm{several}.{default[1]}"),
        click.option("--inner", type=kind, help=f"Inner diameter of a ring in mm{several}; with another size."),
        click.option("--outer", type=kind, help=f"Outer diameter of a ring in mm{several}; with another size."),
        click.option("--wire", type=kind, help=f"Diameter of the wire in mm{several}; with another size."),
        click.option("--gauge", help=f"{trade}, '16 awg' or '16 swg'{several}; with another size."),
        click.option("--ar", type=kind, help=f"Inner diameter over that of the wire{several}; with another size."),
    )


cell_options = options(
    ring_options(float),
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
    click.option(
        "--centres",
        type=click.Choice(["plane", "space"]),
        help="Where centres may be.  [default: plane, where it holds them]",
    ),
)
coexisting = "Where several locked states coexist: that of largest work, or the first from the slack pose."
referred = "Cell that strains refer to under a pull along the grain: symmetric in the grain, or the longest one."
branch_options = options(
    _choice("--branches", "largest", "first", text=coexisting),
    _choice("--reference", "side-by-side", "locked", text=referred),
)


def asked_radii(weave: str, sizes: Mapping[str, Any]) -> tuple[float, float]:
    """r1 and r2 in mm of the sizes asked for, by default those of the weave; InputError for sizes that make no ring."""
    from rve.geometry.weave import sizes_of

    r1, r2 = radii_of(sizes, "--", sizes_of(weave))
    asked = any(size is not None for size in sizes.values())
    check_ring_size(r1, "--r1" if sizes["r1"] is not None else "r1" if asked else f"{weave}: r1")
    return r1, r2


def asked_cell(grain: Any, weave: str, cells: str = "1x1", centres: Any = None, **ring: Any) -> Any:
    """The cell asked for; InputError for rings that no mesh has."""
    from rve.geometry.cell import Cell
    from rve.geometry.weave import named_weave

    asked = named_weave(weave)
    sizes = {name: ring.pop(name) for name in RING_SIZES}
    r1, r2 = asked_radii(weave, sizes)
    metal = material_of(ring, prefix="--")
    try:
        nx, ny = (int(part) for part in cells.split("x"))
    except ValueError:
        raise InputError(f"--cells = {cells}: write two numbers, such as 2x2") from None
    if centres == "plane" and not asked.is_flat:
        raise InputError(f"--centres = plane: the centres of {asked.name} lie in no plane; leave the option out")
    try:
        return Cell(r1, r2, asked, grain, metal.density_kg_per_mm3, metal, (nx, ny), centres or "plane")
    except BadField as error:
        raise InputError(f"{'' if sizes['r2'] is None else '--'}{error.what}") from None


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
@click.option("--strings", is_flag=True, help="Add h_strings: rings drawn to loops that stretch no more.")
@click.option("--joint", help="With --rings: welded, butted:ANGLE (degrees from the grain) or butted:worst.")
@branch_options
@larger_options
@cell_options
def table(out: Path, rings: bool, strings: bool, joint: str | None, branches: Any, reference: Any, **rest: Any) -> None:
    """Write the strain-load table of a grid or a list of load directions."""
    from rve.locking.interior_point import DirectOptions
    from rve.solve import solve_table, with_strings
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
    if strings:
        found = with_strings(found, mesh)
    write_table(found, out)
    say(f"rings of {ring_words(mesh.r1, mesh.r2)}")
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
    mesh = asked_cell(**cell)
    found = solve_table(mesh, ([alpha], [beta]))
    status = str(found.status[0])
    if status != "converged":
        raise NotConverged(f"{status}: {SENTENCES[status]}")
    assert found.cell is not None
    row = {name: column[0] for name, column in found.columns().items() if name in COLUMNS}
    row |= ring_sizes(mesh.r1, mesh.r2) | {"areal_mass_kg_per_m2": found.cell.areal_mass_kg_per_m2}
    answer(row, always=True)
    if plot is not None:
        tell(f"drawing {plot}")
        save_figure(plot, draw_case(found).figure)


def _setting(text: str) -> tuple[str, float]:
    """Name and number of "NAME=VALUE"."""
    name, _, value = text.partition("=")
    number = numbers_of(value, f"--set {name}", "VALUE")[0]
    return name.strip(), int(number) if number.is_integer() else number


@main.command(name="support", epilog="Example: rve support --S 0.5,-0.1,0.5")
@click.option("--S", "load", required=True, help="S11,S12,S22: dead line load, positive semidefinite, any unit.")
@click.option("--strings", is_flag=True, help="Add h_strings: rings drawn to loops that stretch no more.")
@click.option("--plot", type=FILE, help="With --strings: picture of the loops to write, PNG, SVG or PDF.")
@branch_options
@larger_options
@cell_options
def support_command(load: str, strings: bool, plot: Path | None, branches: Any, reference: Any, **cell: Any) -> None:
    """Print h = max S:E of a dead second Piola-Kirchhoff load and the locked state that reaches it, as JSON."""
    from rve.locking.interior_point import DirectOptions
    from rve.support_function import support

    if plot is not None:
        if not strings:
            raise InputError("--plot: draws strings; give --strings with it")
        check_plot(plot)
    mesh = asked_cell(**cell)
    found = support(mesh, parse_load(load), DirectOptions(branches=branches, reference=reference))
    status = str(found.status[0])
    if status != "converged":
        raise NotConverged(f"S = {load}: {status}: {SENTENCES[status]}")
    if mesh.bound_note:
        say(mesh.bound_note, err=True)
    told = found.row(0) | ring_sizes(mesh.r1, mesh.r2)
    if strings:
        from rve.common.drawing.plane import save_figure
        from rve.locking.strings import string_states
        from rve.plots import draw_strings

        drawn = string_states(mesh, found.S, found.sides_mm)
        told |= drawn.row(0)
        if plot is not None:
            save_figure(plot, draw_strings(drawn, 0).figure)
    answer(told, always=True)


@main.command(name="ring", epilog="Example: rve ring --inner 8 --gauge '16 swg' --weave 6-in-1")
@cell_options
def ring_command(**cell: Any) -> None:
    """Print a ring in both spellings, its mass, where its weave jams, and how many go into a metre of mesh."""
    from rve.piece import ring_facts

    mesh = asked_cell(**cell)
    facts = ring_facts(mesh)
    lines = [
        f"ring of {ring_words(mesh.r1, mesh.r2)}",
        f"{1e3 * facts['ring_mass_kg']:.4g} g of {mesh.material.name}, {facts['wire_length_mm']:.4g} mm of wire",
        f"{mesh.weave.name}: clearance {digits(facts['slack_clearance_mm'])} mm where the mesh is slack; jams at AR "
        f"{facts['least_aspect_ratio']:.3f}, which is wire of {facts['thickest_wire_at_this_inner_mm']:.4g} mm",
    ]
    for name, state in facts["mesh"].items():
        along, across, rings, mass = (digits(number, 4) for number in state.values())
        lines.append(
            f"{name.replace('_', ' ')}: a metre has {across} cells across and {along} along the grain; {rings} rings, "
            f"{mass} kg a square metre"
        )
    answer(facts, "\n".join(lines))


@main.command(epilog="Example: rve export --inner 8 --wire 1.6 --size 120x80 --clearance 0.5 --out part.3mf")
@click.option("--out", required=True, type=FILE, help="File to write: .3mf, .glb or .stl.")
@click.option("--size", required=True, help="Room for the piece, WIDTHxHEIGHT in mm; its rings are whole.")
@click.option("--clearance", type=float, help="Least gap of rings in mm; wire is made thinner where need be.")
@click.option("--load", metavar="ALPHA,BETA", help="Locked under this load, degrees, instead of slack.")
@cell_options
def export(out: Path, size: str, clearance: float | None, load: str | None, **cell: Any) -> None:
    """Write a piece of mesh for printers, CAD or browsers: as many whole rings as there is room for."""
    from rve.piece import Piece
    from rve.placed.solids import SOLID_ENDINGS

    check_out_file(out, endings=SOLID_ENDINGS)
    width, height = numbers_of(size.replace("x", ","), "--size", "WIDTH,HEIGHT")
    angles: Any = None if load is None else tuple(numbers_of(load, "--load", "ALPHA,BETA"))
    mesh = asked_cell(**cell)
    try:
        piece = Piece.cut(mesh, (width, height), clearance, angles)
    except InputError as error:
        raise InputError(f"--{error}") from None
    thinner = 2.0 * (mesh.r2 - piece.cell.r2)
    say(*[f"wire is {digits(thinner)} mm thinner than asked for, for the clearance"] * (thinner > 0.0))
    piece.save(out)
    say(f"{out}: {piece}")
    answer({"out": str(out), **piece.record, "wire_thinner_by_mm": thinner})
    sizes = ("--r1", digits(piece.cell.r1, 6), "--r2", digits(piece.cell.r2, 6), "--weave", piece.cell.weave.name)
    say_next("rve", "table", *sizes, "--out", out.with_suffix(".csv"), why="where these rings lock")


@main.command(
    epilog="Example: rve simulate --alpha 0 --beta 30 --to 0,60 --friction 0.1 --out loop.csv --plot loop.png"
)
@click.option("--alpha", help="Principal angles in degrees, FIRST:LAST:STEP or A,B,...")
@click.option("--beta", help="Ratio angles in degrees, as --alpha; every pair of both is a case.")
@click.option("--history", type=click.Path(path_type=Path), help="CSV with time_s, alpha_deg, beta_deg, size instead.")
@click.option("--to", help="ALPHA,BETA: the load turns there and back, slowly; its loop is what friction takes.")
@click.option("--friction", type=float, default=0.0, show_default=True, help="Coulomb's coefficient between rings.")
@click.option(
    "--set", "settings", multiple=True, help="NAME=VALUE: another option of rve.SimulationOptions, repeatable."
)
@click.option("--out", required=True, type=FILE, help="CSV file to write, with a JSON beside it.")
@click.option("--plot", type=FILE, help="Picture to write, PNG, SVG or PDF: the loop, or the first three cases.")
@larger_options
@cell_options
def simulate(
    alpha: str | None,
    beta: str | None,
    history: Path | None,
    to: str | None,
    friction: float,
    settings: tuple[str, ...],
    out: Path,
    plot: Path | None,
    **cell: Any,
) -> None:
    """Move the rings by the paper's damped scheme until they rest, beside the locked state of the direct solver."""
    from rve.common.drawing.plane import save_figure
    from rve.common.typed import read_typed
    from rve.directions import parse_angles, product
    from rve.simulation.dynamics import SimulationOptions
    from rve.simulation.run import ENDS, friction_loop, read_history, simulate, write_run

    directions = None not in (alpha, beta) if history is None else {alpha, beta, to} == {None}
    if not directions:
        raise InputError("give --alpha and --beta, with --to for a loop, or --history alone")
    options = read_typed(SimulationOptions, {"friction": friction} | dict(map(_setting, settings)), "--set")
    check_out_file(out, inputs=[history], endings=(".csv",))
    if plot is not None:
        check_plot(plot, [history])
    mesh, loop = asked_cell(**cell), None
    loads = product(parse_angles(alpha or "0", "--alpha"), parse_angles(beta or "0", "--beta"))
    if to is None:
        run = simulate(mesh, loads if history is None else read_history(history), options)
    elif len(loads.alpha_deg) > 1 or not friction:
        raise InputError("--to: turns one load, with --friction above 0; give one --alpha and one --beta")
    else:
        a, b = numbers_of(to, "--to", "ALPHA,BETA")
        loop = friction_loop(mesh, (loads.alpha_deg[0], loads.beta_deg[0]), (a, b), options)
        run = loop.run
    record = run.record(run.direct()) | ({} if loop is None else {"loop": loop.record()})
    write_run(run, record, out)
    if plot is not None:
        from rve.simulation.pictures import draw_loop, draw_run

        save_figure(plot, draw_run(run, range(min(3, len(run.E)))) if loop is None else draw_loop(loop))
    for end in record["ends"]:
        E, direct = ([end[f"{name}{of}"] for name in ("E11", "E12", "E22")] for of in ("", "_direct"))
        told = f"alpha {end['alpha_deg']:g}, beta {end['beta_deg']:g}: {end['status']} after {end['steps']} steps"
        strains = f"{', '.join(f'{x:.6f}' for x in E)}; direct solver {', '.join(f'{x:.6f}' for x in direct)}"
        say(f"{told}, t = {end['t_s']:.1f} s; E = {strains}")
    if loop is not None:
        say(f"{loop}")
    answer(record)
    failed = sorted(set(run.status.tolist()) - {"converged"})
    if failed:
        count = int((run.status != "converged").sum())
        told = "; ".join(f"{status}: {ENDS[status]}" for status in failed)
        raise NotConverged(f"{out} is in place, but {count} of {len(run.E)} cases do not rest: {told}")
    last = record["ends"][0]
    say_next("rve", "case", "--alpha", last["alpha_deg"], "--beta", last["beta_deg"], why="the forces of that load")


@main.command(
    context_settings={"ignore_unknown_options": True},
    epilog="Example: rve sweep --out tables --r1 5,6 --r2 0.5,0.6 --jobs 2 --rings",
)
@sweep_options
@ring_options(str, ", several with commas")
@click.option("--weave", default="4-in-1", show_default=True, help=f"Weaves, with commas: {', '.join(WEAVE_NAMES)}.")
@grain_option
@click.argument("further", nargs=-1, type=click.UNPROCESSED)
def sweep(out: Path, weave: str, grain: str, further: tuple[str, ...], **more: Any) -> None:
    """Write one table for each weave and ring, and sweep.csv beside them. FURTHER: options of `rve table`.

    The same command again runs only what is not finished. Exit code 1 if a table failed: sweep.csv says why.
    """
    sizes = {name: text for name in RING_SIZES if (text := more.pop(name)) is not None}
    items = table_items(out, sizes, weave.split(","), grain, further)
    finished = run_sweep(items, out, table_columns, **more)
    if finished[0]["rows_converged"] < FIT_FROM:
        return
    first = out / f"{finished[0]['name']}.csv"
    say_next("homogenize", "fit", first, "--out", first.with_name(f"{first.stem}_law.json"), why="a law from a table")


def table_items(
    out: Path, sizes: Mapping[str, str], weave: Sequence[str], grain: str, further: Sequence[str]
) -> list[SweepItem]:
    """One table for each weave and each ring of `sizes`, lists with commas by the keys of `RING_SIZES`, with `further`
    options of `rve table`; InputError for too many."""
    lists = [text.split(",") if key == "gauge" else numbers_of(text, f"--{key}") for key, text in sizes.items()]
    count = len(weave) * math.prod(map(len, lists))
    if count > MOST_TABLES:
        raise InputError(f"the sizes and --weave: make {count} tables, at most {MOST_TABLES} are allowed")
    rings = [radii_of(dict(zip(sizes, ring, strict=True)), "--") for ring in itertools.product(*lists)]
    further = further_options(further, ("--out", *(f"--{key}" for key in (*RING_SIZES, "weave", "grain"))))
    items = []
    for name, (big, small) in itertools.product(weave, rings):
        r1_text, r2_text = (repr(float(one)).removesuffix(".0") for one in (big, small))  # another name for each number
        table = out.resolve() / f"{Path(name).name.removesuffix('.toml')}_{grain}_r1-{r1_text}_r2-{r2_text}.csv"
        asked = ("--weave", name, "--grain", grain, "--r1", repr(big), "--r2", repr(small))
        arguments = ("table", "--out", str(table), *asked, *further)
        items.append(SweepItem(table.stem, "rve", arguments, sidecar_path(table)))
    return items


def table_columns(record: Mapping[str, Any]) -> Row:
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
        r1, r2 = asked_radii(name, {key: rest[key] for key in RING_SIZES})
        if not r1 <= r2 * one.jamming_ratio:  # what is no number goes on, and is refused
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
