"""Diagrams as SVG text, the same bytes for the same numbers."""

import io
from typing import Any

import numpy as np

from benchmarks.report.records import Diagram

MARKERS = "osD^v<>pPX*h"
COLOURS = (
    *("#3f90da", "#e76300", "#832db6", "#717581", "#bd1f01"),
    *("#008a6e", "#a96b59", "#b58900", "#1f3a5f", "#92a50f"),
)
"""Told apart by colour-blind readers, after M. Petroff (arXiv 2107.02270), without colours too light for lines."""


def svg(diagram: Diagram) -> str:
    """The picture as one <svg> element without prologue, ready to be put into HTML."""
    import matplotlib

    matplotlib.use("svg")
    import matplotlib.pyplot as plt

    settings: dict[Any, Any] = {
        "svg.hashsalt": diagram.key,
        "svg.fonttype": "none",
        "font.size": 10,
        "axes.axisbelow": True,
    }
    with plt.rc_context(settings):
        figure, ax = plt.subplots(figsize=(7.6, 4.6), layout="constrained")
        (_bars if diagram.bars else _curves)(ax, diagram)
        ax.set(xlabel=diagram.x_label, ylabel=diagram.y_label)
        ax.set_title(diagram.title, loc="left", fontsize=11)
        ax.set_axisbelow(True)
        ax.grid(visible=True, which="major", alpha=0.35)
        if diagram.bars:
            figure.legend(fontsize=10, loc="outside lower center", ncols=3, frameon=False)
        else:
            ax.legend(fontsize=9, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
        plt.close(figure)
    text = out.getvalue()
    text = "\n".join(line.rstrip() for line in text[text.index("<svg") :].splitlines()) + "\n"
    return _own_names(text, diagram.key)


def _own_names(text: str, key: str) -> str:
    """The names of groups begin with the diagram's key, because several pictures share one HTML page."""
    for mark in ('id="', 'href="#', "url(#"):
        text = text.replace(mark, f"{mark}{key}-")
    return text


def _curves(ax: Any, diagram: Diagram) -> None:
    for i, curve in enumerate(diagram.curves):
        x, y = np.array(curve.x, dtype=float), np.array(curve.y, dtype=float)
        kept = np.isfinite(x) & np.isfinite(y) & (x > 0.0) & (y > 0.0)
        marker = MARKERS[i % len(MARKERS)]
        line = "-" if curve.joined else "none"
        style = {"linestyle": line, "marker": marker, "color": COLOURS[i % len(COLOURS)]}
        ax.loglog(x[kept], y[kept], ms=6, lw=1.6, label=curve.label, **style)
    for axis in (ax.xaxis, ax.yaxis):
        _plain_numbers(axis)


def _plain_numbers(axis: Any) -> None:
    """Over less than two decades 1, 2 and 5 times a power of ten are written out, over less than half of one more."""
    from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

    low, high = axis.get_view_interval()
    if high < 100.0 * low:
        axis.set_major_locator(MaxNLocator(5) if high < 5.0 * low else LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())


def _bars(ax: Any, diagram: Diagram) -> None:
    width = 0.8 / len(diagram.curves)
    for i, curve in enumerate(diagram.curves):
        places = np.array(curve.x, dtype=float) + (i - 0.5 * (len(diagram.curves) - 1)) * width
        height = np.nan_to_num(np.array(curve.y, dtype=float), nan=diagram.base) - diagram.base
        ax.bar(places, height, width, bottom=diagram.base, color=COLOURS[i % len(COLOURS)], label=curve.label)
    ax.set_yscale("log")
    _plain_numbers(ax.yaxis)
    ax.set_xticks(range(len(diagram.ticks)), diagram.ticks)
