"""A picture of a law alone: cuts through the set of admissible strains. `homogenize.plots` draws laws beside tables."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import numpy as np

from homogenize.laws.protocol import MembraneLaw
from rve.common.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHEARS = (0.0, 0.05, 0.1, 0.15, 0.2)
"""E12 of the sections that are drawn."""
MARGIN = 0.2
"""Sections reach this strain beyond what the uniaxial supports allow."""


def surface_height(law: MembraneLaw, D: Array, G: Array) -> Array:
    """(E11 + E22)/2 on the locking surface over D = (E11 - E22)/2 and G = E12, arrays of one shape."""
    flat = np.stack([D.ravel(), G.ravel(), -D.ravel()], axis=1)
    return np.asarray(-law.cut(flat).violation.reshape(D.shape))


def plot_sections(
    law: MembraneLaw, shears: tuple[float, ...] = SHEARS, reach: tuple[float, float] | None = None, ax: Any = None
) -> Axes:
    """Cuts through the set of admissible strains at constant shear E12: E22 over E11.

    `reach`: least and greatest (E11 - E22)/2, by default what the supports under loads along x and y allow.
    """
    ax = ax or own_figure().subplots()
    along, across = law.support(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    least, most = (-across - MARGIN, along + MARGIN) if reach is None else reach
    D = np.linspace(least, most, 400)
    for number, shear in enumerate(shears):
        T = surface_height(law, D, np.full_like(D, shear))
        is_open = np.minimum(T + D, T - D) > -0.5  # I + 2E has positive sides
        label = f"E12 = {shear:.3f}"
        ax.plot((T + D)[is_open], (T - D)[is_open], color=colours()(number / max(len(shears) - 1, 1)), label=label)
    ax.set(xlabel="E11", ylabel="E22", title="Admissible strains lie below and left of the curves")
    ax.grid(alpha=0.3)
    ax.legend(fontsize=8)
    return cast("Axes", ax)


def own_figure(size: tuple[float, float] = (7.0, 5.2)) -> Figure:
    """A figure of its own, outside pyplot: no window, no global state."""
    from matplotlib.figure import Figure

    return Figure(figsize=size, layout="constrained")


def colours() -> Any:
    """The colour map of all pictures of laws."""
    import matplotlib

    return matplotlib.colormaps["viridis"]
