"""Command line: `python -m rve table`, `case`, `support`, `study`, `localize`. `--help` of each says what it takes.

How commands end: `rve.common.command_line`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from rve.common.command_line import Group, answer, check_plot, idle_option, options, say, say_next
from rve.common.errors import SENTENCES, InputError, NotConverged
from rve.common.progress import tell
from rve.common.storage.files import check_out_file, check_out_folder, check_out_table, sidecar_path
from rve.common.storage.reading import read_json_object
from rve.common.sweeps import numbers_of, run_sweep, sweep_options

METHODS = ("direct", "stewart-trinkle")
FIT_FROM = 10
"""Rows from which a law is offered."""
WEAVE_NAMES = ("4-in-1", "6-in-1")
MATERIAL_NAMES = ("steel", "steel 1.4301", "steel 1.4404", "titanium grade 2")
"""The names in `rve.geometry.weave.WEAVES` and `rve.common.materials.MATERIALS`, not imported to print a help text."""
_IDLE_FORCE = (
    "has no effect any more and will be removed; python -m benchmarks.omissions measures what each omission saves"
)

_weave_options = options(
    click.option("--weave", type=click.Choice(WEAVE_NAMES), default="4-in-1", show_default=True, help="Weave."),
    click.option(
        "--grain",
        type=click.Choice(["y", "x"]),
        default="y",
        show_default=True,
        help="Axis along which rings interlace.",
    ),
)
_cell_options = options(
    click.option("--r1", type=float, default=5.0, show_default=True, help="Radius of a ring's centre circle in mm."),
    click.option("--r2", type=float, default=0.5, show_default=True, help="Radius of the wire in mm."),
    click.option("--material", help=f"Named material: {', '.join(MATERIAL_NAMES)}.  [default: steel]"),
    click.option("--density", type=float, help="Density of the rings in kg/m3; by default the material's."),
    click.option("--young", type=float, help="Young's modulus in N/mm2; by default the material's."),
    click.option("--poisson", type=float, help="Poisson's ratio, without unit; by default the material's."),
    click.option("--yield", type=float, help="Yield stress in N/mm2; by default the material's."),
    click.option("--ultimate", type=float, help="Ultimate stress in N/mm2; by default the material's."),
    _weave_options,
)
_branch_options = options(
    click.option(
        "--branches",
        type=click.Choice(["largest", "first"]),
        default="largest",
        show_default=True,
        help="Where several locked states coexist: that of largest work, or the first from the slack pose.",
    ),
    click.option(
        "--reference",
        type=click.Choice(["side-by-side", "locked"]),
        default="side-by-side",
        show_default=True,
        help="Cell that strains refer to under a pull along the grain: symmetric in the grain, or the longest one.",
    ),
)
_explain_options = options(
    click.option("--explain", is_flag=True, help="Say what was used and left out, and why."),
    idle_option("--force", _IDLE_FORCE),
)


def _explain(found: Any) -> None:
    """The run's decisions on standard error: `case` keeps standard output for its JSON."""
    from rve.explain import decisions

    say(*map(str, decisions(found.provenance)), err=True)


def _cell(r1: float, r2: float, grain: str, weave: str, **material: Any) -> Any:
    from rve.common.materials import material_of
    from rve.geometry.cell import Cell
    from rve.geometry.weave import WEAVES

    metal = material_of(material, prefix="--")
    return Cell(r1, r2, WEAVES[weave], grain, metal.density_kg_per_mm3, metal)


def _ring_options(rings: bool, given: dict[str, Any]) -> Any:
    """The options of `with_rings` from the command line, None without --rings."""
    from rve.common.values import checked
    from rve.more_columns import RingOptions

    given = {name: value for name, value in given.items() if value is not None}
    if given and not rings:
        raise InputError(f"--{next(iter(given)).split('_')[0]}: belongs to --rings, which is not given")
    if "hertz" in given and "load_N_per_mm" not in given:
        raise InputError("--hertz: how much crossing wires give depends on the load: give --load")
    for name in given:
        check = RingOptions.__dataclass_fields__[name].metadata["check"]
        checked({f"--{name.split('_')[0]}": given[name]}, f"--{name.split('_')[0]}", check, "")
    return RingOptions(**given) if rings else None


def _solved(
    method: str, directions: tuple[Any, Any], mesh: Any, direct: Any, checkpoint: Path | None, workers: int
) -> Any:
    """The table of these load directions by either method."""
    from rve.paper.checkpoints import SweepOptions
    from rve.paper.table import solve_table_stewart_trinkle
    from rve.solve import solve_table

    if method == "stewart-trinkle":
        if (direct.branches, direct.reference) != ("largest", "side-by-side"):
            raise InputError("--branches and --reference belong to --method direct: stewart-trinkle follows one motion")
        return solve_table_stewart_trinkle(mesh, directions, how=SweepOptions(folder=checkpoint, workers=workers))
    if checkpoint is not None or workers != 1:
        raise InputError(
            "--checkpoint and --workers belong to --method stewart-trinkle; the direct solver needs neither"
        )
    return solve_table(mesh, directions, direct)


def _directions(weave: Any, loads: Path | None, graded: bool, alpha: str | None, beta: str | None) -> tuple[Any, Any]:
    """The load directions asked for: a file, the graded set, or a grid; by default one all round the weave."""
    import numpy as np

    from rve.directions import graded_grid, grid, parse_angles, product, read_loads

    if (loads is not None) + graded + (alpha is not None or beta is not None) > 1:
        raise InputError("--loads, --graded and --alpha with --beta are three ways to say which loads: give one")
    if loads is not None:
        return read_loads(loads)
    if graded:
        return graded_grid(weave)
    beta = "0:90:5" if beta is None else beta
    if alpha is None:
        return product(np.unique(grid(5.0, weave).alpha_deg), parse_angles(beta, "--beta"))
    return product(parse_angles(alpha, "--alpha"), parse_angles(beta, "--beta"))


@click.group(cls=Group)
def main() -> None:
    """Where a periodic cell of rigid interlinked rings locks under each line load."""


@main.command(epilog="Example: rve table --out table.csv --r1 6 --r2 0.6 --material 'titanium grade 2' --rings")
@click.option("--out", required=True, type=click.Path(dir_okay=False, path_type=Path), help="CSV file to write.")
@click.option(
    "--alpha", help="Principal angles in degrees, FIRST:LAST:STEP or A,B,...  [default: 0:45:5; -40:45:5 if chiral]"
)
@click.option("--beta", help="Ratio angles in degrees, as --alpha.  [default: 0:90:5]")
@click.option("--loads", type=click.Path(path_type=Path), help="CSV with alpha_deg, beta_deg instead of a grid.")
@click.option("--graded", is_flag=True, help="403 directions, close where strains change fast, instead of a grid.")
@click.option(
    "--method", type=click.Choice(METHODS), default="direct", show_default=True, help="How locked states are found."
)
@click.option("--checkpoint", type=click.Path(path_type=Path), help="Folder to resume from (stewart-trinkle).")
@click.option(
    "--workers", type=click.IntRange(min=1), default=1, show_default=True, help="Processes (stewart-trinkle)."
)
@click.option("--span", is_flag=True, help="Also find how far free strains may move (into the JSON).")
@click.option("--rings", is_flag=True, help="Add stiffness (dE/dS) and strength columns of the rings' own wire.")
@click.option("--joint", help="With --rings: welded, butted:ANGLE (degrees from the grain) or butted:worst.")
@click.option("--load", "load_N_per_mm", type=float, help="With --rings: size S11 + S22 of the line load in N/mm.")
@click.option("--hertz", is_flag=True, help="With --rings and --load: wires also give where they cross (Hertz).")
@click.option("--compliance", type=float, help="Add dE/dS columns for contacts of this stiffness in N/mm instead.")
@_explain_options
@_branch_options
@_cell_options
def table(
    out: Path,
    method: str,
    checkpoint: Path | None,
    workers: int,
    rings: bool,
    joint: str | None,
    load_N_per_mm: float | None,
    hertz: bool,
    compliance: float | None,
    span: bool,
    explain: bool,
    branches: str,
    reference: str,
    **rest: Any,
) -> None:
    """Write the strain-load table of a grid or a list of load directions."""
    from rve.equilibrium.interior_point import DirectOptions
    from rve.more_columns import with_compliance, with_rings, with_span
    from rve.table import write_table

    if rings and compliance is not None:
        raise InputError("--rings and --compliance both give dE/dS: choose the rings' wire, or contacts of a stiffness")
    how = _ring_options(rings, {"joint": joint, "load_N_per_mm": load_N_per_mm, "hertz": hertz or None})
    asked = {name: rest.pop(name) for name in ("loads", "graded", "alpha", "beta")}
    mesh = _cell(**rest)
    direct = DirectOptions(branches=branches, reference=reference)
    directions = _directions(mesh.weave, **asked)
    check_out_table(out, inputs=[asked["loads"]])
    if checkpoint is not None:
        check_out_folder(checkpoint, "--checkpoint")
    found = _solved(method, directions, mesh, direct, checkpoint, workers)
    if how is not None:
        found = with_rings(found, mesh, how)
    elif compliance is not None:
        found = with_compliance(found, compliance, mesh)
    if span:
        found = with_span(found, mesh)
    write_table(found, out)
    if explain:
        _explain(found)
    _say_of_table(found, out, method)
    answer(read_json_object(sidecar_path(out)))
    if found.converged.sum() >= FIT_FROM:
        say_next("homogenize", "fit", out, "--out", out.with_name(f"{out.stem}_law.json"), why="a law from this table")


def _say_of_table(found: Any, out: Path, method: str) -> None:
    """Rows by status, and what is particular about some."""
    if "loaded" in found.provenance:
        say(found.provenance["loaded"]["note"])
    good = int(found.converged.sum())
    free = int((~found.unique & found.converged).sum())
    say(f"{out}: {good} of {len(found)} rows converged in {found.provenance['wall_s']:.1f} s")
    if free:
        where = "the limit from inside the tensile cone" if method == "direct" else "where the motion has ended"
        say(f"{free} rows leave the strain free (unique = 0); their E is {where}")
    several = 0 if found.branch is None else int((found.branch != "slack").sum())
    if several:
        say(f"{several} rows have several locked states; theirs is of largest work (column branch, JSON)")
    for status in sorted(set(found.status) - {"converged"}):
        say(f"{(found.status == status).sum()} rows {status}: {SENTENCES[str(status)]}")


@main.command(epilog="Example: rve case --alpha 45 --beta 0 --plot case.png")
@click.option("--alpha", type=float, required=True, help="Principal angle in degrees.")
@click.option("--beta", type=float, required=True, help="Ratio angle in degrees.")
@click.option("--plot", type=click.Path(dir_okay=False, path_type=Path), help="Picture to write, PNG, SVG or PDF.")
@click.option("--html", type=click.Path(dir_okay=False, path_type=Path), help="Page to write that turns in a browser.")
@click.option("--animation", type=click.Path(dir_okay=False, path_type=Path), help="GIF to write: the cell locking.")
@_explain_options
@_cell_options
def case(
    alpha: float, beta: float, plot: Path | None, html: Path | None, animation: Path | None, explain: bool, **cell: Any
) -> None:
    """Solve one load direction and print its locked state as JSON."""
    from rve.solve import solve_table
    from rve.table import COLUMNS

    if plot is not None:
        check_plot(plot)
    _check_views(html, animation)
    found = solve_table(_cell(**cell), ([alpha], [beta]))
    if explain:
        _explain(found)
    status = str(found.status[0])
    if status != "converged":
        raise NotConverged(f"alpha = {alpha}, beta = {beta}: {status}: {SENTENCES[status]}")
    values = [*found.E[0], *found.S[0], *found.x2_mm[0], *found.x3_mm[0], found.R[0], found.min_gap_mm[0]]
    out: dict[str, object] = {"alpha_deg": alpha, "beta_deg": beta}
    out |= dict(zip(COLUMNS[2:14], map(float, values), strict=True))
    out |= {"areal_mass_kg_per_m2": found.provenance["areal_mass_kg_per_m2"]}
    out |= {"contacts": int(found.contacts[0]), "unique": int(found.unique[0]), "status": status}
    answer(out | {"iterations": int(found.iterations[0])}, always=True)
    if plot is not None:
        from rve.plots import draw_case, save

        tell(f"drawing {plot}")
        save(draw_case(found), plot)
    if html is not None:
        from rve.cell_view import write_case_page

        write_case_page(found, html)
    if animation is not None:
        from rve.cell_view import write_locking

        write_locking(found, animation)


def _check_views(html: Path | None, animation: Path | None) -> None:
    """InputError, before anything is solved, for views of a cell that cannot be written."""
    from rve.cell_view import check_animation
    from rve.common.drawing.page import check_page

    if html is not None:
        check_page("--html", "leave it out")
        check_out_file(html, "--html")
    if animation is not None:
        check_animation(animation)
        check_out_file(animation, "--animation")


@main.command(name="support", epilog="Example: rve support --S 0.5,-0.1,0.5")
@click.option("--S", "load", required=True, help="S11,S12,S22: dead line load, positive semidefinite, any unit.")
@_branch_options
@_cell_options
def support_command(load: str, branches: str, reference: str, **cell: Any) -> None:
    """Print h = max S:E of a dead second Piola-Kirchhoff load and the locked state that reaches it, as JSON."""
    from rve.directions import parse_load
    from rve.equilibrium.interior_point import DirectOptions
    from rve.support_function import support

    found = support(_cell(**cell), parse_load(load), DirectOptions(branches=branches, reference=reference))
    status = str(found.status[0])
    if status != "converged":
        raise NotConverged(f"S = {load}: {status}: {SENTENCES[status]}")
    answer(found.row(0), always=True)


@main.command(
    context_settings={"ignore_unknown_options": True},
    epilog="Example: rve sweep --out tables --r1 5,6 --r2 0.5,0.6 --jobs 2 --rings",
)
@sweep_options
@click.option("--r1", required=True, help="Radii of rings' centre circles in mm, with commas.")
@click.option("--r2", required=True, help="Radii of wires in mm, with commas.")
@click.option("--weave", default="4-in-1", show_default=True, help=f"Weaves, with commas: {', '.join(WEAVE_NAMES)}.")
@click.option(
    "--grain", type=click.Choice(["y", "x"]), default="y", show_default=True, help="Axis along which rings interlace."
)
@click.argument("further", nargs=-1, type=click.UNPROCESSED)
def sweep(
    out: Path, r1: str, r2: str, weave: str, grain: str, further: tuple[str, ...], jobs: int, cluster: str | None
) -> None:
    """Write one table for each weave, r1 and r2, and sweep.csv beside them. FURTHER: options of `rve table`.

    The same command again runs only what is not finished. Exit code 1 if a table failed: sweep.csv says why.
    """
    from rve.sweep import table_columns, table_items

    items = table_items(out, numbers_of(r1, "--r1"), numbers_of(r2, "--r2"), weave.split(","), grain, further)
    finished = run_sweep(items, out, table_columns, jobs=jobs, cluster=cluster)
    if finished[0]["rows_converged"] < FIT_FROM:
        return
    first = out / f"{finished[0]['name']}.csv"
    say_next("homogenize", "fit", first, "--out", first.with_name(f"{first.stem}_law.json"), why="a law from a table")


@main.command(epilog="Example: rve study --out study")
@click.option("--out", required=True, type=click.Path(file_okay=False, path_type=Path), help="Folder to write into.")
def study(out: Path) -> None:
    """Reproduce the paper's Figs. 9-17 for this implementation, and set its published figures beside ours."""
    from rve.study.comparison import RECORD, comparison, markdown, run

    found = run(out)
    say(markdown(comparison(found)).rstrip())
    answer(read_json_object(out / RECORD))
    say_next("rve", "table", "--out", out / "table.csv", why="the same cases by the direct solver, as a table")


@main.command(name="localize", epilog="Example: rve localize curtain --out rings --window 0,0,100,100 --tubes")
@click.argument("curtain", type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(file_okay=False, path_type=Path), help="Folder to write into.")
@click.option("--r1", type=float, help="Radius of a ring's centre circle in mm; by default as in summary.json.")
@click.option("--r2", type=float, help="Radius of the wire in mm; by default as in summary.json.")
@click.option("--hang", "hang_deg", type=float, help="Angle of the weave in degrees; by default as in summary.json.")
@_weave_options
@click.option("--window", help="Only the rings in x0,y0,x1,y1 (mm, before deformation).")
@click.option("--tubes/--lines", default=False, show_default=True, help="Write tori, or centre lines.")
@click.option("--max-rings", type=click.IntRange(min=1), default=100_000, show_default=True, help="More are refused.")
@click.option("--picture/--no-picture", default=True, show_default=True, help="Draw rings.png (needs pyvista).")
@click.option("--html", is_flag=True, help="Write rings.html, which turns in a browser (needs plotly).")
def localize_command(curtain: Path, out: Path, window: str | None, **rest: Any) -> None:
    """Every ring of CURTAIN, the curtain.vtu of macro_fem or its folder: rings.vtu, rings.png, worst_cell.csv."""
    from rve.directions import parse_window
    from rve.localization.job import LocalizeOptions, run_localize

    files = {name: rest.pop(name) for name in ("picture", "tubes", "html")}
    found = run_localize(curtain, out, LocalizeOptions(window=parse_window(window), **rest), **files)
    by_status = ", ".join(f"{count} {name}" for name, count in found["cells_by_status"].items())
    say(f"{found['rings']} rings in {found['cells']} cells ({by_status}), {found['wall_s']:.1f} s; in {out}")
    say(f"{found['links_intact']} of {found['links']} links intact as drawn")
    if found["curtain_status"] not in ("converged", "unknown"):
        say(f"the curtain is not solved: its status is {found['curtain_status']} (summary.json)")
    worst = found["worst_cell"]
    say(f"worst cell {worst['cell']}: {worst['contacts']} contacts, at most {worst['largest_force_N']:.4g} N")
    for name in found["cells_by_status"]:
        if name != "met":
            say(f"{name}: {found['meanings'][name]}")
    answer(found)
    given = {f"--{name.split('_')[0]}": rest[name] for name in ("r1", "r2", "hang_deg", "weave", "grain")}
    words = [str(word) for pair in ({"--window": window} | given).items() if pair[1] is not None for word in pair]
    out = out.with_name(f"{out.name}_tubes")
    say_next("rve", "localize", curtain, "--out", out, *words, "--tubes", "--no-picture", why="wires for ParaView")
