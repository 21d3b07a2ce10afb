"""Figures of matplotlib, outside pyplot, without a window or global state; scales of colours for all pictures."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rve.common.errors import InputError, require
from rve.common.files import atomic_path
from rve.common.optional import Axes, Figure
from rve.common.records import Array
from rve.common.texts import digits

BLUE, VERMILION, GREEN = "#0072B2", "#D55E00", "#009e73"
"""Colours that colour-blind readers tell apart (Okabe and Ito)."""
OVER = "#d6004d"
"""The colour of values above the scale."""
TOP_SHARE, NEAR = 0.995, 1.25
"""A scale of colours ends where this share of the values lies below, or at the largest if that is less than so far."""


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of this size in inches; InputError without matplotlib."""
    require("matplotlib", "plots", "a picture")
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def new_axes(width: float = 7.0, height: float = 5.2) -> Any:
    """Axes of a new figure."""
    return new_figure(width, height).subplots()


def viridis() -> Any:
    """The map viridis without its lightest part, for lines and marks on white."""
    import matplotlib
    from matplotlib.colors import ListedColormap

    return ListedColormap(matplotlib.colormaps["viridis"].colors[:225])  # type: ignore[attr-defined]


def as_typed(figure: Figure) -> Figure:
    """The figure, whose words are printed as they are typed, "$" and "_" too; labels of ticks may be formulae."""
    from matplotlib.axis import Axis
    from matplotlib.text import Text

    ticks = {text for axis in figure.findobj(Axis) for text in axis.findobj(Text) if text is not axis.label}
    for text in figure.findobj(Text):
        if text not in ticks:
            text.set_parse_math(False)
    return figure


def save_figure(path: str | os.PathLike[str], figure: Any, dpi: float = 150) -> None:
    """Write a figure, atomically; the ending of the name is the format, PNG without one. InputError for others."""
    try:
        with atomic_path(path) as temporary:
            as_typed(figure).savefig(temporary, dpi=dpi, format=Path(path).suffix[1:] or "png", bbox_inches="tight")
    except ValueError as error:
        raise InputError(f"{path}: {str(error).splitlines()[0]}") from error


@dataclass(frozen=True)
class Scale:
    """Colours of values from `low` to `top`; `largest` may be above `top`.

    spread: "even", "root" (colours change with the square root, so that small values are told apart) or "log".
    """

    label: str
    low: float
    top: float
    largest: float
    spread: str = "even"

    @classmethod
    def of(cls, values: Array, label: str) -> Scale:
        """From 0 to a round number that `TOP_SHARE` of the values do not exceed.

        >>> scale = Scale.of(np.append(np.linspace(0.0, 0.9, 999), 7.0), "line load, N/mm")
        >>> scale.top, scale.largest, scale.is_exceeded, scale.title
        (0.9, 7.0, True, 'line load, N/mm; arrow: up to 7')
        """
        largest = float(np.max(values, initial=0.0))
        bulk = float(np.quantile(values, TOP_SHARE)) if len(values) else 0.0
        return cls(label, 0.0, round_top(bulk, largest), largest, "root")

    @property
    def is_exceeded(self) -> bool:
        """Whether some values are above the scale."""
        return self.largest > self.top * (1.0 + 1e-9)

    @property
    def title(self) -> str:
        """The label, and the largest value if it is above the scale."""
        return self.label + (f"; arrow: up to {digits(self.largest)}" if self.is_exceeded else "")

    def colour_map(self) -> Any:
        """The colours for matplotlib and pyvista."""
        import matplotlib
        from matplotlib.colors import ListedColormap

        share = np.linspace(0.0, 1.0, 1024) ** (0.5 if self.spread == "root" else 1.0)
        return ListedColormap(matplotlib.colormaps["viridis"](share)).with_extremes(over=OVER)

    def norm(self) -> Any:
        """The range for matplotlib."""
        from matplotlib.colors import LogNorm, Normalize

        return (LogNorm if self.spread == "log" else Normalize)(self.low, self.top)

    def add_bar(self, *axes: Axes, **style: Any) -> None:
        """A bar of the colours beside the axes."""
        from matplotlib.cm import ScalarMappable

        extend = ("neither", "min", "max", "both")[(self.spread == "log") + 2 * self.is_exceeded]
        figure = axes[0].figure
        assert figure is not None
        bar = figure.colorbar(ScalarMappable(self.norm(), self.colour_map()), ax=axes, extend=extend, **style)
        bar.ax.tick_params(labelsize=8)
        bar.set_label(self.title.replace("; ", "\n"), fontsize=9)  # in one line it is longer than the bar


def round_top(bulk: float, largest: float) -> float:
    """A round end of a scale: above `bulk`, or above the `largest` value where that is near or nothing else is known.

    >>> round_top(0.9, 0.908), round_top(0.9, 7.0), round_top(0.0, 7.0)
    (0.95, 0.9, 7.0)
    """
    return rounded_up(largest if largest < NEAR * rounded_up(bulk) or bulk <= 0.0 else bulk)


def rounded_up(value: float) -> float:
    """The smallest number with one digit, or one and a half, that is not below `value`; 1 for 0.

    >>> rounded_up(0.0234), rounded_up(1200.0), rounded_up(0.0)
    (0.025, 1500.0, 1.0)
    """
    if not value > 0.0:
        return 1.0
    unit = 0.5 * 10.0 ** np.floor(np.log10(value))
    return float(f"{unit * np.ceil(value / unit * (1.0 - 1e-9)):.6g}")
