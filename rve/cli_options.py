"""Options of the commands for cell, rings and load directions, and what they ask for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from rve.common.commands.command_line import options
from rve.common.errors import InputError

WEAVE_NAMES = ("4-in-1", "6-in-1")
MATERIAL_NAMES = (
    *("steel", "steel 1.4301", "steel 1.4404", "titanium grade 2", "titanium grade 5", "spring wire 1.4310"),
    *("aluminium EN AW-5019", "aluminium EN AW-5356", "brass CuZn37", "copper"),
)
"""The names in `rve.geometry.weave.WEAVES` and `rve.common.materials.MATERIALS`, not imported to print a help text."""

grain_option = click.option(
    "--grain", type=click.Choice(["y", "x"]), default="y", show_default=True, help="Axis along which rings interlace."
)
cell_options = options(
    click.option("--r1", type=float, default=5.0, show_default=True, help="Radius of a ring's centre circle in mm."),
    click.option("--r2", type=float, default=0.5, show_default=True, help="Radius of the wire in mm."),
    click.option("--material", help=f"Named material: {', '.join(MATERIAL_NAMES)}.  [default: steel]"),
    click.option("--density", type=float, help="Density of the rings in kg/m3; by default the material's."),
    click.option("--young", type=float, help="Young's modulus in N/mm2; by default the material's."),
    click.option("--poisson", type=float, help="Poisson's ratio, without unit; by default the material's."),
    click.option("--yield", type=float, help="Yield stress in N/mm2; by default the material's."),
    click.option("--ultimate", type=float, help="Ultimate stress in N/mm2; by default the material's."),
    click.option("--weave", type=click.Choice(WEAVE_NAMES), default="4-in-1", show_default=True, help="Weave."),
    grain_option,
)
larger_options = options(
    click.option("--cells", default="1x1", show_default=True, help="Primitive cells that move independently, as 2x2."),
    click.option(
        "--centres",
        type=click.Choice(["plane", "space"]),
        default="plane",
        show_default=True,
        help="Where the centres of rings may be.",
    ),
)
branch_options = options(
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


def asked_cell(
    r1: float, r2: float, grain: str, weave: str, cells: str = "1x1", centres: str = "plane", **material: Any
) -> Any:
    """The cell asked for; InputError for rings that no mesh has."""
    from rve.common.materials import material_of
    from rve.common.rings import check_ring_size
    from rve.geometry.cell import Cell
    from rve.geometry.weave import WEAVES

    check_ring_size(r1, "--r1")
    metal = material_of(material, prefix="--")
    try:
        nx, ny = (int(part) for part in cells.split("x"))
    except ValueError:
        raise InputError(f"--cells = {cells}: write two numbers, such as 2x2") from None
    return Cell(r1, r2, WEAVES[weave], grain, metal.density_kg_per_mm3, metal, (nx, ny), centres)


def asked_rings(rings: bool, joint: str | None) -> Any:
    """The options of `with_rings` from the command line, None without --rings."""
    from rve.common.typed import BadField
    from rve.more_columns import RingOptions

    if joint is None:
        return RingOptions() if rings else None
    if not rings:
        raise InputError("--joint: belongs to --rings, which is not given")
    try:
        return RingOptions(joint=joint)
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
