"""The command line: python -m macro_fem run scene.toml [--law law.json] --out DIR."""

from __future__ import annotations

import json
import math
from itertools import takewhile
from pathlib import Path
from typing import Any

import click

from macro_fem.scene.old_names import FORCE_IS_IDLE
from rve.common.command_line import Group, answer, idle_option, no_picture, options, say, say_next
from rve.common.errors import InputError
from rve.common.storage.reading import read_json_object
from rve.common.sweeps import run_sweep, sweep_options

MOST_RINGS = 90_000
"""From this many on `rve localize` is told that they are wanted: its own limit is a little above."""


@click.group(cls=Group)
def main() -> None:
    """Curtains of ring mesh: shape, line loads, bounds, pictures."""


@main.command(epilog="Example: macro_fem run scene.toml --law law.json --out curtain")
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--law", "law_path", type=click.Path(path_type=Path), help="Law file; without it r1/r2 = 10.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for summary, VTU and picture.")
@click.option("--picture/--no-picture", default=True, help="Draw curtain.png (needs matplotlib; in space pyvista).")
@click.option("--animation", is_flag=True, help="Draw the load steps as curtain.gif.")
@click.option("--html", is_flag=True, help="Write curtain.html, which turns in a browser (needs plotly).")
@click.option(
    "--table", type=click.Path(path_type=Path), help="Table, CSV, to begin with instead of a law; with --rings."
)
@click.option("--rings", metavar="R1,R2", help="Ask these rings for the law, radii in mm, where the curtain needs it.")
@click.option("--weave", type=click.Choice(["4-in-1", "6-in-1"]), help="With --rings: weave.  [default: 4-in-1]")
@click.option(
    "--grain", type=click.Choice(["y", "x"]), help="With --rings: axis along which rings interlace.  [default: y]"
)
@click.option("--accuracy", type=float, help="With --rings: width of the interval over the height.  [default: 5e-3]")
@click.option("--cache", type=click.Path(path_type=Path), help="Folder where answers of the rings are kept.")
@click.option("--no-cache", is_flag=True, help="Keep no answers of the rings, and read none.")
@click.option("--explain", is_flag=True, help="Say what was used and left out, and why.")
@idle_option("--force", FORCE_IS_IDLE)
def run(
    scene: Path,
    law_path: Path | None,
    out: Path,
    picture: bool,
    animation: bool,
    html: bool,
    explain: bool,
    table: Path | None,
    **rings: Any,
) -> None:
    """Solve SCENE and write summary.json, curtain.vtu and curtain.png.

    Exit code 0: converged; 1: files are written, and status and message say what is wrong (not converged, or taut:
    supports at the largest stretch of the mesh); 2: bad input.
    """
    from macro_fem.demand.options import ring_options
    from macro_fem.fem.petsc import first_writes
    from macro_fem.job import run_scene
    from macro_fem.output.strength import holds_line

    out = click.get_current_context().with_resource(first_writes(out))
    asked = ring_options(**rings) | {"picture": picture, "animation": animation, "html": html}
    summary = run_scene(scene, law_path, out, table=table, **asked)
    say(f"{summary['status']}: {summary['message']}")
    say(
        f"mean height {summary['mean_height_mm']:.3f} mm, lowest point {summary['lowest_point_mm']:.3f} mm, "
        f"largest line load {summary['max_principal_line_load_N_per_mm']:.4g} N/mm"
    )
    say(
        f"{summary['cells']} cells, {summary['dofs']} unknowns, {summary['iterations']} iterations, "
        f"{summary['wall_s']:.2f} s; written to {out}"
    )
    if summary["status"] == "converged":
        say(holds_line(summary))
        say(*filter(None, [summary["support_forces_note"]]))
    if "ring_solves" in summary:
        say(_interval_line(summary))
    if explain:
        for feature in summary["features"]:
            say(f"{feature['feature']:<16} {'used' if feature['used'] else 'left out':<9} {feature['why']}")
    answer(summary)
    if summary["status"] != "converged":
        raise click.exceptions.Exit(1)
    _say_next_of_curtain(out, summary)


@main.command(
    context_settings={"ignore_unknown_options": True},
    epilog="Example: macro_fem sweep low.toml high.toml --out curtains --jobs 2 --law law.json",
)
@sweep_options
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED, required=True, metavar="SCENE... [OPTIONS OF run]")
def sweep(out: Path, arguments: tuple[str, ...], jobs: int, cluster: str | None) -> None:
    """Solve every SCENE into a folder of its name, and write sweep.csv beside them.

    The same command again runs only what is not finished. Exit code 1 if a scene failed: sweep.csv says why.
    """
    from macro_fem.sweep import scene_columns, scene_items

    scenes = list(takewhile(lambda one: not one.startswith("-"), arguments))
    items = scene_items([Path(one) for one in scenes], out, arguments[len(scenes) :])
    finished = run_sweep(items, out, scene_columns, jobs=jobs, cluster=cluster)
    first = out / finished[0]["name"]
    _say_next_of_curtain(first, read_json_object(first / "summary.json"))


def _say_next_of_curtain(out: Path, summary: dict[str, Any]) -> None:
    """How to see every ring of the curtain in a folder, if its law has rings."""
    from rve import cell_of_sides

    rings = summary["rings"]
    if rings is None:
        return
    r1, r2, b_x, b_y = (rings[key] for key in ("r1_mm", "r2_mm", "b_x_mm", "b_y_mm"))
    try:
        cell = cell_of_sides(r1, r2, (b_x, b_y))
    except InputError:  # a weave that we do not know
        return
    words: list[object] = [] if cell.weave.name == "4-in-1" else ["--weave", cell.weave.name]
    words += ["--grain", "x"] if cell.grain == "x" else []
    nx, ny = cell.weave.repeat
    area = 1e6 * summary["mass_kg"] / (summary["areal_mass_kg_per_m2"] or math.inf)
    count = area * cell.weave.classes / (b_x * b_y * nx * ny)
    words += ["--max-rings", math.ceil(1.05 * count)] if count > MOST_RINGS else []
    words += no_picture("pyvista")
    say_next(
        "rve", "localize", out, "--out", f"{out}_rings", *words, why="every ring, and the forces in the worst cell"
    )


def _interval_line(summary: dict[str, Any]) -> str:
    """Interval of the answer, its parts, and what the rings were asked."""
    what, unit = ("mean_height", "mm") if "mean_height_interval_mm" in summary else ("potential", "N_mm")
    low, high = summary[f"{what}_interval_{unit}"]
    law, mesh = summary[f"law_part_{unit}"], summary[f"mesh_part_{unit}"]
    name, shown = what.replace("_", " "), unit.replace("_", " ")
    return (
        f"{name} of the rings in [{low:.6g}, {high:.6g}] {shown}: law {law:.3g}, mesh {mesh:.3g} {shown}; "
        f"{summary['ring_solves']} ring problems solved, {summary['cache_hits']} read from the cache"
    )


_ring_options = options(
    click.argument("scene", type=click.Path(path_type=Path)),
    click.option("--law", "law_path", type=click.Path(path_type=Path), help="Law file; without it r1/r2 = 10."),
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
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for summary, VTU and picture.")
@click.option("--picture/--no-picture", default=True, help="Draw rings.png (needs matplotlib).")
@click.option("--html", is_flag=True, help="Write rings.html, which turns in a browser (needs plotly).")
def rings(scene: Path, law_path: Path | None, space: bool, start: str, out: Path, picture: bool, html: bool) -> None:
    """Solve SCENE ring by ring and write summary.json, rings.vtu and rings.png.

    Exit code 0: converged to a local minimum; 1: files are written, status and message say why not; 2: bad input.
    """
    from macro_fem.every_ring import run_rings

    summary = run_rings(scene, law_path, out, space=space, start=start, picture=picture, html=html)
    say(f"{summary['status']}: {summary['message']}")
    say(
        f"{summary['rings']} rings, mean height {summary['mean_height_mm']:.3f} mm, lowest point "
        f"{summary['lowest_point_mm']:.3f} mm"
    )
    if summary["status"] == "out-of-reach":
        say(f"supports are up to {summary['way_left_mm']:.3f} mm from their places")
    else:
        say(f"largest contact force {summary['largest_contact_force_N']:.4g} N, residual {summary['kkt_residual']:.1e}")
    say(
        f"smallest gap {summary['min_gap_mm']:.1e} mm, {summary['iterations']} iterations, "
        f"{summary['wall_s']:.2f} s; written to {out}"
    )
    answer(summary)
    if summary["status"] != "converged":
        raise click.exceptions.Exit(1)
    law = () if law_path is None else ("--law", law_path)
    say_next(
        "macro_fem", "compare", scene, *law, *(() if space else ("--plane",)), why="beside the membrane of the law"
    )


@main.command(epilog="Example: macro_fem compare scene.toml --law law.json --out both.json")
@_ring_options
@click.option("--out", type=click.Path(path_type=Path), help="File for the numbers, JSON.")
def compare(scene: Path, law_path: Path | None, space: bool, start: str, out: Path | None) -> None:
    """Solve SCENE as a membrane and ring by ring, and print both side by side.

    Exit code 0: both converged; 1: one of them did not; 2: bad input.
    """
    from macro_fem.compare import compare_files, side_by_side
    from rve.common.storage.files import check_out_file, write_text

    if out is not None:
        check_out_file(out, inputs=[scene, law_path])
    summary = compare_files(scene, law_path, space=space, start=start).summary
    answer(summary, "\n".join(side_by_side(summary)))
    if out is not None:
        write_text(out, json.dumps(summary, indent=2, allow_nan=False) + "\n")
    if {summary["disk"]["status"], summary["rings"]["status"]} != {"converged"}:
        raise click.exceptions.Exit(1)
