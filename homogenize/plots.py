"""Pictures of a law beside its table: locking surface, strains over the load angles, errors, sections."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from homogenize.fitting.bounds import bounds_of
from homogenize.fitting.report import random_loads
from homogenize.fitting.row_tests import rows_from_table
from homogenize.laws import pictures
from homogenize.laws.pictures import locking_surface, solid_axes
from homogenize.laws.protocol import MembraneLaw
from homogenize.laws.rows import LockedRows, with_mirror
from homogenize.laws.stored import Law
from homogenize.query.strain import locked_strain
from rve.common import Array, job, tell
from rve.common.drawing.plane import Scale, new_axes, new_figure, rounded_up, save_figure, viridis
from rve.common.optional import Axes
from rve.common.tensor import trace

if TYPE_CHECKING:
    from rve import StrainTable

RECORD = "pictures.json"
"""The file that stands for the pictures in their folder; it lists them by their checksums (`rve.common.files`)."""
POINTS = 121
"""Points of the locking surface along each side."""


def write_pictures(law: Law, table: StrainTable, folder: str | Path, inputs: Sequence[Path] = ()) -> list[Path]:
    """Writes surface.png, strains.png, errors.png, sections.png and pictures.json into `folder`, all at once.

    Returns the paths of the pictures; InputError if one would overwrite `inputs`, and for a table of other rings.
    """
    if law.cell is not None and table.cell is not None:
        law.cell.check_same(table.cell, "the table", "the law")
    rows = rows_from_table(table)
    tell("drawing")
    figures = {
        "surface.png": plot_surface(law, rows).figure,
        "strains.png": plot_strains(law, table)[0].figure,
        "errors.png": plot_errors(law, rows).figure,
        "sections.png": plot_sections(law, rows).figure,
    }
    with job(folder, RECORD, {"law": law.name, "rows": len(rows)}, inputs) as staged:
        for name, figure in figures.items():
            tell(f"drawing {name}")
            save_figure(staged / name, figure)
    return [Path(folder) / name for name in figures]


def plot_surface(law: MembraneLaw, rows: LockedRows) -> Any:
    """The locking surface in strain space, coloured by the gap between the bounds of h, the rows and their mirrors."""
    ax = solid_axes(new_figure(8.0, 6.0).add_subplot(projection="3d"))
    E, gap, scale = surface_with_gap(law, rows)
    shades = scale.colour_map()(scale.norm()(np.clip(gap, scale.low, scale.top)), alpha=0.75)
    ax.plot_surface(*np.moveaxis(E, -1, 0), facecolors=shades, linewidth=0, rcount=POINTS, ccount=POINTS, shade=False)
    named = f"rows of the table{' and their mirror images' if rows.is_mirrored else ''}"
    ax.plot(*with_mirror(rows).E.T, ".", color="black", ms=4, label=named)
    scale.add_bar(ax, shrink=0.7, pad=0.02)
    ax.legend(loc="upper left", fontsize=10)
    title = f"Locking surface of the {law.name} law and {len(rows)} rows"
    ax.set(xlabel="E11", ylabel="E12", zlabel="E22", title=title)
    return ax


def plot_strains(law: MembraneLaw, table: StrainTable) -> Any:
    """E11, E12, E22 against beta for each alpha, as Fig. 13 of the paper: the law as lines, the rows as points."""
    axes = new_figure(12.5, 4.2).subplots(1, 3)
    alphas = np.unique(table.alpha_deg[table.converged])
    beta = np.clip(45.0 - 45.0 * np.cos(np.linspace(0.0, np.pi, 121)), 0.01, 89.99)  # dense where strains turn
    found = locked_strain(law, np.repeat(alphas, len(beta)), np.tile(beta, len(alphas)))
    drawn = np.where((found.status == "converged")[:, None], found.E, np.nan).reshape(len(alphas), len(beta), 3)
    for number, (alpha, E) in enumerate(zip(alphas, drawn, strict=True)):
        colour = viridis()(number / max(len(alphas) - 1, 1))
        at = table.converged & (table.alpha_deg == alpha)
        for k, ax in enumerate(axes):
            ax.plot(beta, E[:, k], color=colour, lw=1.2, label=f"{alpha:g} deg" if k == 2 else None)
            ax.plot(table.beta_deg[at], table.E[at, k], "o", color=colour, ms=3.5)
    for ax, name in zip(axes, ("E11", "E12", "E22"), strict=True):
        ax.set(xlabel="ratio angle beta (degrees)", ylabel=name, xlim=(0.0, 90.0))
        ax.grid(alpha=0.3)
    axes[2].legend(title="alpha", fontsize=10, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    axes[0].figure.suptitle("Locked strain under a Cauchy load: law (lines), rows (points)")
    return axes


def plot_errors(law: MembraneLaw, rows: LockedRows) -> Axes:
    """Histogram of the error of h at the rows, and of the distance of the bounds at random loads."""
    ax, S, floor = new_axes(), random_loads(), 1e-16
    bins = np.logspace(-16, 0, 65).tolist()
    ax.hist(np.abs(law.support(rows.S) - rows.h) + floor, bins, label="|error of h| at the rows", alpha=0.7)
    ax.hist(bounds_of(rows).gap(S) + floor, bins, label=f"outer - inner bound of h at {len(S)} random loads", alpha=0.7)
    ax.set(xscale="log", xlabel="strain (h at unit trace of S)", ylabel="loads", title=f"Errors of the {law.name} law")
    ax.legend()
    return cast("Axes", ax)


def plot_sections(law: MembraneLaw, rows: LockedRows) -> Axes:
    """Cuts through the admissible strains at the shears of the rows, and the rows without shear."""
    ax = pictures.plot_sections(law, tuple(np.linspace(0.0, np.abs(rows.E[:, 1]).max(), 5).tolist()))
    plane = np.abs(rows.E[:, 1]) < 1e-9
    ax.plot(rows.E[plane, 0], rows.E[plane, 2], "k.", ms=4, label="rows with E12 = 0")
    ax.legend(fontsize=10)
    return ax


def surface_with_gap(law: MembraneLaw, rows: LockedRows) -> tuple[Array, Array, Scale]:
    """Strains (POINTS, POINTS, 3) on the locking surface over the range of the rows, how far the bounds of h there are
    apart (POINTS, POINTS) at the load of unit trace normal to the surface, and their colours.

    nan where the surface lies below all rows.
    """
    E = with_mirror(rows).E
    D, G = 0.5 * (E[:, 0] - E[:, 2]), E[:, 1]
    grid = np.linspace(D.min() - 0.02, D.max() + 0.02, POINTS), np.linspace(G.min(), G.max(), POINTS)
    found = locking_surface(law, *np.meshgrid(*grid), lowest=0.5 * trace(E).min() - 0.02)
    gap = np.full(found.shape[:2], np.nan)
    is_there = np.isfinite(found[..., 0])
    gap[is_there] = bounds_of(rows).gap(law.cut(found[is_there]).S)
    largest = float(np.nanmax(gap, initial=0.0))
    top = rounded_up(largest)
    # The scale of gaps goes over three powers of ten.
    return found, gap, Scale("outer - inner bound of h (S of unit trace)", 1e-3 * top, top, largest, "log")
