"""Pictures of a law alone: cuts through the admissible strains, strength. `homogenize.plots` adds those of tables."""

from typing import Any, cast

import numpy as np

from homogenize.laws.protocol import MembraneLaw
from homogenize.laws.strength import MAKE_AGAIN, Strength
from rve.common import Array, InputError
from rve.common.drawing.plane import BLUE, VERMILION, new_axes, new_figure, viridis
from rve.common.optional import Axes
from rve.common.tensor import from_disc

SHEARS = (0.0, 0.05, 0.1, 0.15, 0.2)
"""E12 of the sections that are drawn."""
MARGIN = 0.2
"""Sections reach this strain beyond what the uniaxial supports allow."""
UNIAXIAL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def locking_surface(law: MembraneLaw, D: Array, G: Array, lowest: float = -np.inf) -> Array:
    """Strains (..., 3) on the locking surface over D = (E11 - E22)/2 and G = E12, arrays of one shape.

    nan where (E11 + E22)/2 is below `lowest`, or where a side of I + 2E would be.
    """
    flat = np.stack([D.ravel(), G.ravel(), -D.ravel()], axis=1)
    T = -law.cut(flat).violation.reshape(D.shape)
    T = np.where((np.minimum(T + D, T - D) > -0.5) & (lowest < T), T, np.nan)
    return np.stack([T + D, G, T - D], axis=-1)


def plot_sections(law: MembraneLaw, shears: tuple[float, ...] = SHEARS, ax: Any = None) -> Axes:
    """Cuts through the set of admissible strains at constant shear E12: E22 over E11."""
    ax = new_axes() if ax is None else ax
    along, across = law.support(UNIAXIAL)
    D = np.linspace(-across - MARGIN, along + MARGIN, 400)
    for number, shear in enumerate(shears):
        E = locking_surface(law, D, np.full_like(D, shear))
        ax.plot(E[:, 0], E[:, 2], color=viridis()(number / max(len(shears) - 1, 1)), label=f"E12 = {shear:.3f}")
    ax.set(xlabel="E11", ylabel="E22", title="Admissible strains lie below and left of the curves")
    ax.grid(alpha=0.3)
    ax.legend(fontsize=10)
    return cast("Axes", ax)


def plot_strength(
    law: MembraneLaw, strength: Strength | None, yield_N_per_mm2: float | None = None, axes: Any = None
) -> Any:
    """The locking surface in strain space, first yield and collapse in the space of line loads, and sections of both.

    strength: that of the law. axes: three, the first two of them 3D, by default those of a new figure; they are
    returned. InputError if there is no strength, or neither it nor the caller has a yield stress.
    """
    if strength is None:
        raise InputError(f"the law holds no strength; {MAKE_AGAIN}")
    stress = strength.yield_stress(yield_N_per_mm2)
    if axes is None:
        figure = new_figure(13.5, 4.8)
        solid = [solid_axes(figure.add_subplot(1, 3, k, projection="3d")) for k in (1, 2)]
        axes = [*solid, figure.add_subplot(1, 3, 3)]
    _plot_locking(law, axes[0])
    first, last = strength_loads(strength, stress)
    axes[1].plot_surface(
        *np.moveaxis(first, -1, 0), cmap="cividis", alpha=0.9, rcount=73, ccount=25, label="first yield"
    )
    axes[1].plot_wireframe(*np.moveaxis(last, -1, 0), color=VERMILION, lw=0.7, rcount=24, ccount=6, label="collapse")
    axes[1].set(xlabel="S11 (N/mm)", ylabel="S12 (N/mm)", zlabel="S22 (N/mm)", title="Space of line loads")
    axes[1].legend(loc="upper left", fontsize=11)
    _plot_strength_sections(strength, stress, axes[2])
    axes[0].figure.suptitle(f"{strength.joint} rings of {strength.material.name}, yield stress {stress:g} N/mm2")
    return axes


def solid_axes(ax: Any) -> Any:
    """3D axes whose names do not run into their numbers."""
    ax.set_box_aspect(None, zoom=0.82)
    ax.locator_params(nbins=5)
    ax.xaxis.labelpad = ax.yaxis.labelpad = 8.0
    ax.zaxis.labelpad = 11.0
    return ax


def _plot_locking(law: MembraneLaw, ax: Any) -> None:
    """The locking surface over the strains that loads along the axes allow."""
    along, across = law.support(UNIAXIAL)
    low, mid, high = law.support(np.array([[0.5, -0.5, 0.5], [0.5, 0.0, 0.5], [0.5, 0.5, 0.5]]))
    grid = np.meshgrid(np.linspace(-across - 0.1, along + 0.1, 60), np.linspace(mid - low - 0.1, high - mid + 0.1, 61))
    E = np.moveaxis(locking_surface(law, *grid), -1, 0)
    ax.plot_surface(*E, cmap="cividis", linewidth=0.2, edgecolor="0.3", rcount=30, ccount=30)
    ax.set(xlabel="E11", ylabel="E12", zlabel="E22", title="Strain space: locking surface")


def strength_loads(strength: Strength, stress: float) -> tuple[Array, Array]:
    """Line loads (73, 25, 3) in N/mm of first yield and of collapse, over directions and shares of the smaller one."""
    share, angle = np.meshgrid(np.linspace(0.0, 1.0, 25), np.linspace(0.0, 2.0 * np.pi, 73))
    S = from_disc(np.stack([share * np.cos(angle), share * np.sin(angle)], axis=-1).reshape(-1, 2))
    used = strength.utilisation(S, stress), strength.collapse_utilisation(S, stress)
    first, last = ((S / values[:, None]).reshape(*share.shape, 3) for values in used)
    return first, last


def _plot_strength_sections(strength: Strength, stress: float, ax: Any) -> None:
    """First yield (lines) and collapse (dashes) over the principal line loads, for three principal directions."""
    share = np.linspace(0.0, 1.0, 91)
    uses = (strength.utilisation, "-", "first yield"), (strength.collapse_utilisation, "--", "collapse")
    for degrees, colour, mark in ((0, "black", "o"), (22.5, BLUE, "s"), (45, VERMILION, "^")):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        first, second = np.array([c * c, c * s, s * s]), np.array([s * s, -c * s, c * c])
        S = share[:, None] * first + (1.0 - share[:, None]) * second
        for use, line, name in uses:
            used, style = use(S, stress), {"color": colour, "lw": 1.8, "marker": mark, "markevery": 15}
            ax.plot(share / used, (1.0 - share) / used, line, label=f"{degrees:g} deg, {name}", **style)
    ax.set(title="Principal line loads", xlim=(0.0, None), ylim=(0.0, None))
    ax.set(xlabel="principal line load at this angle to x (N/mm)", ylabel="principal line load across it (N/mm)")
    ax.grid(alpha=0.3)
    ax.legend(fontsize=9, loc="lower right")
