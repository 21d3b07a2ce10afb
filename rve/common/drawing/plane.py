"""Plane pictures by matplotlib: figures outside pyplot, without a window or global state."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rve.common.errors import InputError, require
from rve.common.files import atomic_path

if TYPE_CHECKING:
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure

BLUE, VERMILION, GREEN = "#0072B2", "#D55E00", "#009e73"
"""Colours that colour-blind readers tell apart (Okabe and Ito)."""


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of this size in inches; InputError without matplotlib."""
    require("matplotlib", "plots", "a picture")
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def new_axes(width: float = 7.0, height: float = 5.2) -> Any:
    """Axes of a new figure."""
    return new_figure(width, height).subplots()


def viridis() -> ListedColormap:
    """The map viridis without its lightest part, which lines and marks on white cannot have."""
    import matplotlib
    from matplotlib.colors import ListedColormap

    return ListedColormap(matplotlib.colormaps["viridis"].colors[:225])  # type: ignore[attr-defined]


def shade(share: float) -> Any:
    """A colour of `viridis`, from 0 to 1."""
    return viridis()(float(share))


def save_figure(path: str | os.PathLike[str], figure: Any, dpi: float = 150) -> None:
    """Write a figure, atomically; the ending of the name is the format, PNG without one. InputError for others."""
    try:
        with atomic_path(path) as temporary:
            figure.savefig(temporary, dpi=dpi, format=Path(path).suffix[1:] or "png", bbox_inches="tight")
    except ValueError as error:
        raise InputError(f"{path}: {str(error).splitlines()[0]}") from error
