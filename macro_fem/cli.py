"""The command line: python -m macro_fem run scene.toml [--law law.json] --out DIR."""

from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from importlib.util import find_spec
from itertools import product, takewhile
from pathlib import Path
from typing import Any

import click

from rve.common import (
    InputError,
    NotDrawn,
    check_out_file,
    check_out_job,
    json_text,
    numbers_of,
    read_json_object,
    write_text,
)
from rve.common.commands.command_line import Group, answer, end_as, made, options, renamed, say, say_next
from rve.common.commands.sweeps import Row, SweepItem, cluster_option, further_options, run_sweep, sweep_options

MOST_RINGS = 90_000
"""From this many on `localize` is told that they are wanted: its own limit is a little above."""
NUMBERS = ("mean_height_mm", "lowest_point_mm", "max_principal_line_load_N_per_mm", "mass_kg")
GOVERNING = tuple(f"governing_{what}" for what in ("factor", "combination", "link", "place", "force_N", "note"))
COLUMNS = ("status", *NUMBERS, "holds", *GOVERNING, "cells")
"""What sweep.csv takes from summary.json; no times, so that the same sweep gives the same file."""
PATH = click.Path(path_type=Path)

_scene_and_law = options(
    click.argument("scene", type=PATH),
    click.option("--law", "law_path", type=PATH, help="Law file; without it r1/r2 = 10."),
)
_out = click.option("--out", type=PATH, required=True, help="Folder for summary, VTU and picture.")


@click.group(cls=Group)
def main() -> None:
    """Curtains of ring mesh: shape, line loads, bounds, pictures."""


AT_REST = "--continue: is for a scene with [motion]"
NO_MOMENTS = "--animation: every ring is solved in one step; it is for a scene with [motion]"
_goes_on = click.option(
    "--continue", "goes_on", is_flag=True, help="With [motion]: go on from the end of the run in --out."
)


@main.command(epilog="Example: macro_fem run scene.toml --law law.json --out curtain")
@_scene_and_law
@_out
@click.option("--picture/--no-picture", default=True, help="Draw curtain.png (needs matplotlib; in space pyvista).")
@click.option("--animation", is_flag=True, help="Draw the load steps as curtain.gif (needs pyvista).")
@click.option("--html", is_flag=True, help="Write curtain.html, which turns in a browser (needs plotly).")
@click.option("--table", type=PATH, help="Table, CSV, to begin with instead of a law; with --cell.")
@click.option(
    "--cell", metavar="R1,R2", help="Ask these rings for the law, radii in mm or inner=8,wire=1.6, where it is needed."
)
@renamed("--rings", "--cell R1,R2")
@click.option("--weave", help="With --cell: weave, by name or as a TOML file.  [default: 4-in-1]")
@click.option(
    "--grain", type=click.Choice(["y", "x"]), help="With --cell: axis along which rings interlace.  [default: y]"
)
@click.option("--accuracy", type=float, help="With --cell: width of the interval over the height.  [default: 5e-3]")
@click.option("--cache", type=PATH, help="Folder where tables of the rings are kept.")
@click.option("--no-cache", is_flag=True, help="Keep no tables of the rings, and read none.")
@click.option("--report", type=PATH, help="Write a report, PDF (needs typst; in space pyvista).")
@click.option("--dxf", type=PATH, help="Write the outline of the flat sheet (needs ezdxf).")
@click.option("--limit", is_flag=True, help="Let rings flow, and judge by the limit of the curtain: kind = 'plastic'.")
@click.option("--explain", is_flag=True, help="Say what was used and left out, and why.")
@_goes_on
def run(scene: Path, law_path: Path | None, out: Path, explain: bool, goes_on: bool, **more: Any) -> None:
    """Solve SCENE and write summary.json, curtain.vtu and curtain.png; motion.csv, motion.pvd, motion.png if it moves.

    Exit code 0: converged; 1: files are written, and status and message say what is wrong (not converged, or taut:
    supports at the largest stretch of the mesh); 2: bad input; 3: only pictures or the report failed.
    """
    from macro_fem.demand import demand_options
    from macro_fem.job import run_scene
    from macro_fem.output.sentences import curtain_lines, default_law_lines, motion_lines
    from macro_fem.scene.reading import load_scene

    files = {name: more.pop(name) for name in ("picture", "animation", "html", "report", "dxf")}
    limit = more.pop("limit")
    asked = demand_options(law=law_path, **more)
    if load_scene(scene).motion is None:
        if goes_on:
            raise InputError(AT_REST)
        law = law_path if asked is None else None
        summary: Mapping[str, Any]
        summary, failed = rest, _ = made(run_scene, scene, law, out, on_demand=asked, limit=limit, **files)
        say(*([] if asked else default_law_lines(law_path)), *curtain_lines(rest, out, explain=explain))
    else:
        from macro_fem.motion.files import run_motion

        if asked is not None:
            raise InputError("--table and --cell: a curtain in motion takes a law, by --law")
        if any([explain, limit, files.pop("dxf")]):
            raise InputError("--explain, --limit and --dxf: are for a curtain at rest, not for a scene with [motion]")
        say(*default_law_lines(law_path))
        summary, failed = moved, _ = made(run_motion, scene, law_path, out, goes_on=goes_on, **files)
        say(*motion_lines(moved, out))
    _answer_or_go_on(summary, failed, "run", scene, *(("--law", law_path) if law_path else ()), "--out", out)
    _say_next_of_curtain(out, summary)


def _answer_or_go_on(summary: Mapping[str, Any], failed: NotDrawn | None, command: str, *words: Any) -> None:
    """Print the summary; exit unless it has converged, of a run that was stopped with the command that goes on, and if
    pictures failed."""
    answer(summary)
    if summary["status"] == "stopped":
        say_next("macro_fem", command, *words, "--continue", why="go on from there")
        raise click.exceptions.Exit(130)
    if summary["status"] != "converged":
        raise click.exceptions.Exit(1)
    end_as(failed)


@main.command(
    period_s=10.0,
    epilog="Example: macro_fem size scene.toml --law law.json --vary pitch --from 50 --to 400 --factor 3 --out pitch",
)
@_scene_and_law
@click.option(
    "--cell", metavar="R1,R2", help="Ask these rings for the law, radii in mm or inner=8,wire=1.6; --vary r2 needs it."
)
@renamed("--rings", "--cell R1,R2")
@click.option("--vary", metavar="KEY", required=True, help="pitch, mass, speed, r2, or a number in a plugin's table.")
@click.option("--from", "low", type=float, required=True, help="Smallest value: mm, kg or m/s.")
@click.option("--to", "high", type=float, required=True, help="Largest value.")
@click.option("--factor", type=float, required=True, help="Factor with which the curtain is to hold.")
@click.option("--limit", is_flag=True, help="The factor is that of the limit of the curtain, not of first yield.")
@click.option("--out", type=PATH, help="Folder for size.json, size.csv and size.png; each answer is kept there.")
@click.option("--picture/--no-picture", default=True, help="Draw size.png (needs matplotlib).")
@click.option(
    "--jobs", type=click.IntRange(1, 1000), help="Processes side by side.  [default: large meshes one a core]"
)
@cluster_option
def size(scene: Path, law_path: Path | None, cell: str | None, out: Path | None, picture: bool, **asked: Any) -> None:
    """The largest pitch, bar or wind of SCENE, or the thinnest wire, with which it holds.

    The same command again goes on from the answers in --out. Exit code 0: found; 2: bad input, or no value holds (its
    files are written).
    """
    from homogenize.fitting import interval_or_law
    from macro_fem.demand import demand_options
    from macro_fem.job import with_flow
    from macro_fem.output.pictures import Pictures
    from macro_fem.scene.reading import load_scene
    from macro_fem.size import find_size
    from macro_fem.trials import Sought

    if out is not None:
        check_out_job(out, "size.json", inputs=[scene, law_path])
        Pictures(picture, stem="size").check()
    on_demand = demand_options(cell, law_path)
    law = interval_or_law(law_path) if law_path is not None and on_demand is None else None
    hung = with_flow(load_scene(scene)) if asked["limit"] else load_scene(scene)
    sought = Sought(hung, on_demand or law, asked["vary"], asked["factor"])
    found = find_size(sought, (asked["low"], asked["high"]), out=out, jobs=asked["jobs"], cluster=asked["cluster"])
    if out is not None:
        found.save(out, picture=picture)
    if found.value is None:
        sought.scene.refuse(str(found))
    say(*filter(None, [found.note]), err=True)
    answer(asdict(found), str(found))


@main.command(epilog="Example: macro_fem modes scene.toml --law law.json --number 6 --out modes")
@_scene_and_law
@click.option("--number", type=int, default=6, show_default=True, help="How many frequencies.")
@_out
@click.option("--picture/--no-picture", default=True, help="Draw modes.png (needs matplotlib and pyvista).")
@click.option("--report", type=PATH, help="Write a report, PDF (needs typst, matplotlib and pyvista).")
def modes(scene: Path, law_path: Path | None, number: int, out: Path, picture: bool, report: Path | None) -> None:
    """Natural frequencies of the curtain of SCENE at rest, with [motion] at t = 0; writes modes.vtu and modes.png.

    Exit code 0: found; 1: the curtain at rest has not converged; 2: bad input; 3: only the picture failed.
    """
    from macro_fem.modes import run_modes

    found, failed = made(run_modes, scene, law_path, out, number=number, picture=picture, report=report)
    hertz = ", ".join(f"{one:.4g}" for one in found.frequencies_Hz)
    say(*found.notes)
    under = found.loads + ("" if found.time_s is None else ", as they are at t = 0 s")
    answer(found, f"natural frequencies in Hz: {hertz}; under {under}; written to {out}")
    end_as(failed)


@main.command(epilog="Example: macro_fem deck scene.toml --law law.json --out deck")
@_scene_and_law
@click.option("--out", type=PATH, required=True, help="Folder for deck.inp, umat.f and deck.json.")
@click.option("--run/--no-run", "runs", default=True, help="Run it, where CALCULIX names a folder of .ci/calculix.")
def deck(scene: Path, law_path: Path | None, out: Path, runs: bool) -> None:
    """Write SCENE for CalculiX: mesh, supports, loads, steps, user material; run it, and compare forces with ours.

    It takes a curtain at rest under dead loads. Exit code 0: written, and converged if it ran; 1: CalculiX has not
    converged; 2: bad input.
    """
    from macro_fem.deck import deck_lines, run_deck
    from macro_fem.output.sentences import default_law_lines

    say(*default_law_lines(law_path))
    summary = run_deck(scene, law_path, out, runs=runs)
    say(*deck_lines(summary, out))
    answer(summary)
    law = () if law_path is None else ("--law", law_path)
    say_next("macro_fem", "run", scene, *law, "--out", _beside(out, "ours"), why="our own answer, with pictures")
    if summary["status"] == "not converged":
        raise click.exceptions.Exit(1)


_many_options = options(
    sweep_options,
    click.option("--law", "laws", type=PATH, multiple=True, help="Law file; every scene is solved with each one."),
    click.argument("arguments", nargs=-1, type=click.UNPROCESSED, required=True, metavar="SCENE... [OPTIONS OF run]"),
)


def _runs(arguments: tuple[str, ...], laws: tuple[Path, ...], out: Path) -> list[SweepItem]:
    """A run of every scene with every law, named by both where there are several laws."""
    scenes = [Path(one) for one in takewhile(lambda one: not one.startswith("-"), arguments)]
    if not scenes:
        raise InputError("SCENE: name at least one file, before the options")
    further = further_options(arguments[len(scenes) :], ("--out", "--report", "--dxf"))
    items = []
    for scene, law in product(scenes, laws or (None,)):
        name = scene.stem if law is None or len(laws) < 2 else f"{scene.stem}_{law.stem}"
        folder, own = out.resolve() / name, () if law is None else ("--law", str(law.resolve()))
        words = ("run", str(scene.resolve()), "--out", str(folder), *own, *further)
        labels = (("scene", scene.stem), ("law", "" if law is None else law.stem))
        items.append(SweepItem(name, "macro_fem", words, folder / "summary.json", labels=labels))
    return items


@main.command(
    context_settings={"ignore_unknown_options": True},
    epilog="Example: macro_fem sweep low.toml high.toml --out curtains --jobs 2 --law law.json",
)
@_many_options
def sweep(out: Path, arguments: tuple[str, ...], laws: tuple[Path, ...], **workers: Any) -> None:
    """Solve every SCENE into a folder of its name, and write sweep.csv beside them.

    The same command again runs only what is not finished. Exit code 1 if a scene failed: sweep.csv says why.
    """
    from macro_fem.output.designs import design_columns

    columns = partial(design_columns, names=COLUMNS)
    first = out / run_sweep(_runs(arguments, laws, out), out, columns, **workers)[0]["name"]
    _say_next_of_curtain(first, read_json_object(first / "summary.json"))


@main.command(
    context_settings={"ignore_unknown_options": True},
    epilog="Example: macro_fem compare-designs low.toml high.toml --law thin.json --law thick.json --out designs",
)
@_many_options
@click.option("--picture/--no-picture", default=True, help="Draw designs.png and curtains.png (needs matplotlib).")
def compare_designs(
    out: Path, arguments: tuple[str, ...], laws: tuple[Path, ...], picture: bool, **workers: Any
) -> None:
    """Solve every SCENE with every law, and write designs.csv and designs.xlsx, a chart of them, and all curtains.

    What a run writes is in a folder of its name. The same command again runs only what is not finished. Exit code 1 if
    a design failed, of which the table says why; 3: only pictures failed.
    """
    from macro_fem.output import designs
    from macro_fem.output.pictures import Pictures

    Pictures(picture, stem="designs").check()
    items = _runs(arguments, laws, out)
    items = [replace(one, arguments=(*one.arguments, *["--no-picture"] * (not picture))) for one in items]

    def save(rows: list[Row]) -> None:
        say(
            *(designs.design_line(row) for row in rows if row["status"]),
            *[] if find_spec("openpyxl") else [designs.NO_SHEET],
        )
        if best := designs.lightest(rows):
            words = next(one.arguments for one in items if one.name == best["name"])
            report = out / f"{best['name']}.pdf"
            say_next("macro_fem", *words, "--report", report, why="a report of the lightest that holds")
        designs.save_designs(out, rows, [one.record.parent for one in items], picture=picture)

    run_sweep(items, out, designs.design_columns, **workers, table="designs.csv", then=save)


def _beside(out: Path, what: str) -> Path:
    """A folder named like `out` beside it, or in it where it is the current one."""
    return out.parent / f"{out.resolve().name}_{what}"


def _say_next_of_curtain(out: Path, summary: Mapping[str, Any]) -> None:
    """How to see every ring of the curtain in a folder, if it is at rest and its law has rings."""
    if (count := summary.get("order", {}).get("rings")) is None:
        return
    words: list[Any] = ["--max-rings", round(1.05 * count)] if count > MOST_RINGS else []
    words += ["--out", _beside(out, "rings")]
    say_next("macro_fem", "localize", out, *words, why="every ring, and the forces in the worst cell")


_ring_options = options(
    _scene_and_law,
    click.option("--space/--plane", default=True, show_default=True, help="Centres free in space, or in the plane."),
    click.option(
        "--start",
        type=click.Choice(["slack", "disk"]),
        default="slack",
        show_default=True,
        help="Slack weave, or one that the membrane guides.",
    ),
)


@main.command(epilog="Example: macro_fem rings scene.toml --law law.json --out each")
@_ring_options
@_out
@click.option("--picture/--no-picture", default=True, help="Draw rings.png (needs matplotlib).")
@click.option("--html", is_flag=True, help="Write rings.html, which turns in a browser (needs plotly).")
@click.option("--animation", is_flag=True, help="Draw rings in motion as motion.gif.")
@_goes_on
def rings(scene: Path, law_path: Path | None, out: Path, goes_on: bool, animation: bool, **how: Any) -> None:
    """Solve SCENE ring by ring and write summary.json, rings.vtu and rings.png, or motion.csv, motion.pvd, motion.png.

    Exit code 0: converged to a local minimum; 1: files are written, status and message say why not; 2: bad input; 3:
    only pictures failed.
    """
    from homogenize import default_law, load_law
    from macro_fem.job import run_rings
    from macro_fem.motion.files import run_motion
    from macro_fem.output.sentences import default_law_lines, every_ring_lines, motion_lines
    from macro_fem.rings.cost import ring_cost
    from macro_fem.scene.reading import load_scene

    say(*default_law_lines(law_path))
    plane, law = () if how["space"] else ("--plane",), () if law_path is None else ("--law", law_path)
    hung, own = load_scene(scene), (default_law() if law_path is None else load_law(law_path)).cell
    is_moving = hung.motion is not None
    summary: Mapping[str, Any]
    if is_moving:
        summary, failed = moved, _ = made(run_motion, scene, law_path, out, animation=animation, goes_on=goes_on, **how)
        say(*motion_lines(moved, out))
    elif goes_on or animation:
        raise InputError(AT_REST if goes_on else NO_MOMENTS)
    else:
        if own is not None:
            say(f"expected: {ring_cost(hung, own, space=how['space'])}")
        summary, failed = rings, _ = made(run_rings, scene, law_path, out, **how)
        say(*every_ring_lines(rings, out))
    _answer_or_go_on(summary, failed, "rings", scene, *law, *plane, "--out", out)
    if not is_moving:
        say_next("macro_fem", "compare", scene, *law, *plane, why="beside the membrane of the law")


@main.command(epilog="Example: macro_fem compare scene.toml --law law.json --out both.json")
@_ring_options
@click.option("--out", type=PATH, help="File for the numbers, JSON.")
def compare(scene: Path, law_path: Path | None, space: bool, start: Any, out: Path | None) -> None:
    """Solve SCENE as a membrane and ring by ring, and print both side by side.

    Exit code 0: both converged; 1: one of them did not; 2: bad input.
    """
    from homogenize import load_law
    from macro_fem.job import compare as solve_both
    from macro_fem.output.sentences import default_law_lines
    from macro_fem.scene.reading import load_scene

    if out is not None:
        check_out_file(out, inputs=[scene, law_path])
    say(*default_law_lines(law_path))
    law = None if law_path is None else load_law(law_path)
    both = solve_both(load_scene(scene), law, space=space, start=start)
    summary, ends = both.summary, (both.disk, both.rings)
    say(*both.rings.scene.notes, *(one.message for one in ends if one.status != "converged"))
    answer(summary, str(both))
    if out is not None:
        write_text(out, json_text(summary))
    if any(one.status != "converged" for one in ends):
        raise click.exceptions.Exit(1)


@main.command(epilog="Example: macro_fem localize curtain --out rings --window 0,0,100,100 --tubes")
@click.argument("curtain", type=PATH)
@click.option("--out", required=True, type=click.Path(file_okay=False, path_type=Path), help="Folder to write into.")
@click.option("--window", help="Only the rings in x0,y0,x1,y1 (mm, before deformation).")
@click.option("--tubes/--lines", default=False, show_default=True, help="Write tori, or centre lines.")
@click.option("--max-rings", type=click.IntRange(min=1), default=100_000, show_default=True, help="More are refused.")
@click.option("--picture/--no-picture", default=True, show_default=True, help="Draw rings.png (needs pyvista).")
@click.option("--html", is_flag=True, help="Write rings.html, which turns in a browser (needs plotly).")
@click.option("--render", is_flag=True, help="Draw render.png: the rings as metal, with a shadow (needs pyvista).")
@click.option(
    "--format", "solids", type=click.Choice(["3mf", "glb", "stl"]), help="Write tori for printers, CAD and browsers."
)
def localize(curtain: Path, out: Path, window: str | None, max_rings: int, **files: Any) -> None:
    """Every ring of CURTAIN, the folder of a run: rings.vtu, rings.png, worst_cell.csv, localize.json."""
    from macro_fem.output.sentences import ring_field_lines
    from macro_fem.rings.localize import run_localize

    ends: Any = None if window is None else numbers_of(window, "--window", "x0,y0,x1,y1")
    found, failed = made(run_localize, curtain, out, ends, max_rings, **files)
    say(*ring_field_lines(found, out))
    answer(found)
    end_as(failed)
    words = ["--out", _beside(out, "tubes"), *([] if window is None else ["--window", window])]
    say_next("macro_fem", "localize", curtain, *words, "--tubes", "--no-picture", why="wires for ParaView")
