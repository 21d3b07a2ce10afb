"""The drawings of tutorial and reference: python docs/drawings.py [FOLDER], by default docs/drawings/."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import homogenize
import rve
from rve.plots import CLASS_COLOURS, drawn_rings

RED, BLUE, GREY, SHEET = "#c1121f", "#1f3fd0", "0.45", "#e9eef3"
SIZE = 11
"""Points of text in drawings that are 7 inches wide: legible at half size."""


def sheet(ax: Any, corners: Any, **style: Any) -> None:
    """A filled polygon."""
    ax.add_patch(plt.Polygon(np.array(corners, float), **({"fc": SHEET, "ec": "0.3", "lw": 1.2} | style)))


def arrow(ax: Any, start: Any, end: Any, colour: str = "k", both: bool = False, width: float = 1.6) -> None:
    """An arrow, with two heads for a dimension."""
    style = "<|-|>" if both else "-|>"
    how = {"arrowstyle": style, "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 12}
    ax.annotate("", end, start, arrowprops=how)


def words(ax: Any, at: Any, text: str, **style: Any) -> None:
    """Centred text."""
    ax.text(*at, text, **({"ha": "center", "va": "center", "fontsize": SIZE} | style))


def bare(width: float, height: float, columns: int = 1, **options: Any) -> tuple[Any, list[Any]]:
    """A figure with axes of equal scale that show no frame."""
    fig, axes = plt.subplots(1, columns, figsize=(width, height), squeeze=False, **options)
    for ax in axes[0]:
        ax.set_aspect("equal")
        ax.axis("off")
    return fig, list(axes[0])


def axes_and_grain() -> Any:
    """Rings that are locked by a pull along the grain, from the front and from the side."""
    states = rve.solve_table(rve.Cell(r1=5.0, r2=0.5), ([0.0], [90.0])).states
    fig, (front, side) = bare(7.2, 4.4, 2, width_ratios=[3, 1.3], sharey=True)
    sides = 5.0 * np.stack([states.pose.a1[0], states.pose.a2[0]])
    for i in range(4):
        for j in range(3):
            for k in range(2):
                x, y, z = (drawn_rings(states, k).closed_circles(96)[0] + [*([i, j] @ sides), 0.0]).T
                front.plot(x, y, color=CLASS_COLOURS[k], lw=2.2)
                if i == 0:
                    side.plot(z, y, color=CLASS_COLOURS[k], lw=2.2)
    for ax, label in ((front, "x"), (side, "z")):
        arrow(ax, (-9, -9), (1, -9))
        arrow(ax, (-9, -9), (-9, 1))
        words(ax, (3, -9), label)
        words(ax, (-9, 3), "y")
        ax.set(ylim=(-12, 42))
    front.set(xlim=(-12, 52))
    side.set(xlim=(-12, 14))
    arrow(front, (47, 2), (47, 30), RED)
    words(front, (50, 16), "grain", color=RED, rotation=90)
    words(front, (18, 40), "from the front")
    words(side, (0, 40), "from the side")
    return fig


def reference_width() -> Any:
    """One piece of mesh, pulled along the grain, pulled evenly, and pulled across."""
    fig, (ax,) = bare(7.2, 3.6)
    left = 0.0
    for name, width, height in (
        ("pulled along the grain\nreference: width x height", 1.0, 1.0),
        ("pulled evenly", 1.192, 0.888),
        ("pulled across", 1.584, 0.337),
    ):
        sheet(ax, [(left, -height), (left + width, -height), (left + width, 0), (left, 0)])
        middle = left + 0.5 * width
        if name != "pulled across":
            arrow(ax, (middle, -height), (middle, -height - 0.28), RED)
        if name.startswith("pulled along"):
            arrow(ax, (left - 0.1, -1), (left - 0.1, 0), both=True, width=1)
            words(ax, (left - 0.2, -0.5), "height", rotation=90)
        else:
            arrow(ax, (left, -0.5 * height), (left - 0.2, -0.5 * height), RED)
            arrow(ax, (left + width, -0.5 * height), (left + width + 0.2, -0.5 * height), RED)
            words(ax, (middle, -0.5 * height), f"{width:.2f} x {height:.2f}")
        words(ax, (middle, 0.24), name)
        left += width + 0.62
    arrow(ax, (0, -0.12), (1, -0.12), both=True, width=1)
    words(ax, (0.5, -0.24), "width")
    ax.set(xlim=(-0.3, left - 0.3), ylim=(-1.35, 0.5))
    return fig


def alpha_and_beta() -> Any:
    """The direction of a line load: alpha turns its principal axes, beta shares it between them."""
    fig, (turn, share) = bare(7.2, 3.7, 2)
    a = np.radians(25.0)
    first, second = np.array([np.cos(a), np.sin(a)]), np.array([-np.sin(a), np.cos(a)])
    square = np.array([first + second, second - first, -first - second, first - second])
    sheet(turn, square)
    for way, size in ((first, 1.1), (second, 0.7)):
        for sign in (1, -1):
            arrow(turn, sign * way, sign * (1 + size) * way, RED)
    words(turn, 2.35 * first, "s1", color=RED)
    words(turn, 1.95 * second, "s2", color=RED)
    turn.plot([0, 2.0], [0, 0], color=GREY, lw=1, ls="--")
    t = np.linspace(0, a, 20)
    turn.plot(1.5 * np.cos(t), 1.5 * np.sin(t), color=BLUE)
    words(turn, (1.72, 0.36), r"$\alpha$", color=BLUE)
    words(turn, (2.15, 0), "x")
    arrow(turn, (-2.2, -2.0), (-2.2, -1.0), width=1)
    words(turn, (-2.0, -0.95), "y")
    turn.set(xlim=(-2.6, 2.6), ylim=(-2.3, 2.3))
    b = np.linspace(0, 0.5 * np.pi, 60)
    share.plot(np.cos(b), np.sin(b), color=GREY, lw=1)
    arrow(share, (0, 0), (1.25, 0), width=1)
    arrow(share, (0, 0), (0, 1.25), width=1)
    words(share, (1.25, -0.13), "s1")
    words(share, (0, 1.34), "s2")
    for angle, note in ((0, "β = 0: s1 alone"), (45, "β = 45: both alike"), (90, "β = 90: s2 alone")):
        at = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
        share.plot(*at, "o", color=BLUE)
        words(share, at + np.array([0.08, 0.1]), note, ha="left", color=BLUE)
    arrow(share, (0, 0), np.array([np.cos(1.1), np.sin(1.1)]), RED)
    t = np.linspace(0, 1.1, 30)
    share.plot(0.4 * np.cos(t), 0.4 * np.sin(t), color=BLUE)
    words(share, (0.52, 0.3), r"$\beta$", color=BLUE)
    share.set(xlim=(-0.2, 2.1), ylim=(-0.25, 1.5))
    return fig


def two_line_loads() -> Any:
    """The same force on a cell, divided by its length before and after deformation."""
    fig, (before, after) = bare(7.2, 3.4, 2)
    cells = ((before, 1.0, 1.0, "reference cell"), (after, 1.45, 0.55, "cell as it hangs"))
    for ax, width, height, name in cells:
        sheet(ax, [(0, 0), (width, 0), (width, height), (0, height)])
        for x, sign in ((width, 1), (0, -1)):
            for y in np.linspace(0.12, 0.88, 4) * height:
                arrow(ax, (x, y), (x + 0.35 * sign, y), RED)
        words(ax, (width + 0.58, 0.5 * height), "force T", color=RED, rotation=90)
        words(ax, (0.5 * width, height + 0.18), name)
        ax.set(xlim=(-0.6, width + 0.75), ylim=(-0.65, 1.35))
    arrow(before, (0.5, 0), (0.5, 1), both=True, width=1)
    words(before, (0.62, 0.5), "L")
    arrow(after, (0.72, 0), (0.72, 0.55), both=True, width=1)
    words(after, (0.84, 0.27), "l")
    words(before, (0.5, -0.3), "per reference length: T/L")
    words(before, (0.5, -0.5), "(files: line load; S after turning back)", fontsize=SIZE - 1.5)
    words(after, (0.72, -0.3), "per present length: T/l = s")
    words(after, (0.72, -0.5), r"(tables: Cauchy line load, $\alpha$ and $\beta$)", fontsize=SIZE - 1.5)
    return fig


def edges() -> Any:
    """Names of edges."""
    fig, (plain, other) = bare(7.2, 3.2, 2)
    sheet(plain, [(0, 0), (3, 0), (3, 2), (0, 2)])
    hole = np.array([(1.1, 0.7), (1.8, 0.7), (1.8, 1.3), (1.1, 1.3)])
    sheet(plain, hole, fc="white")
    words(plain, (1.45, 1.0), "hole 1", fontsize=SIZE - 1)
    for at, name in (((1.5, 2.2), "top"), ((1.5, -0.2), "bottom")):
        words(plain, at, name)
    words(plain, (-0.2, 1), "left", rotation=90)
    words(plain, (3.2, 1), "right", rotation=90)
    for at in ((0, 2), (3, 2)):
        plain.plot(*at, "o", color=RED)
    words(plain, (3.1, 2.25), "corners", color=RED)
    sheet(other, [(0, 0), (3, 0), (3, 1.3), (1.5, 2), (0, 1.3)])
    other.plot([0, 1.5, 3], [1.3, 2, 1.3], color=BLUE, lw=3)
    words(other, (1.5, 2.2), "top: both slopes", color=BLUE)
    words(other, (1.5, -0.2), "bottom")
    words(other, (-0.2, 0.65), "left", rotation=90)
    words(other, (3.2, 0.65), "right", rotation=90)
    for ax in (plain, other):
        ax.set(xlim=(-0.5, 3.7), ylim=(-0.4, 2.5))
    return fig


def supports() -> Any:
    """What each kind of support holds."""
    fig, axes = bare(7.2, 2.9, 6)
    x = np.linspace(0, 2, 5)
    for ax, name in zip(axes, ("corners", "top", "rail", "hooks", "edge", "point"), strict=True):
        sheet(ax, [(0, 0), (2, 0), (2, 2.6), (0, 2.6)])
        words(ax, (1, -0.45), name)
        if name in ("corners", "hooks"):
            at = x[[0, -1]] if name == "corners" else x
            ax.plot(at, np.full(len(at), 2.6), "v", color=RED, ms=9)
        if name in ("top", "rail"):
            ax.plot([0, 2], [2.6, 2.6], color=RED, lw=4)
        if name == "rail":
            arrow(ax, (0.4, 2.95), (1.6, 2.95), RED, both=True, width=1.2)
        if name == "edge":
            ax.plot([0, 0], [0, 2.6], color=RED, lw=4)
        if name == "point":
            ax.plot(1.3, 1.2, "v", color=RED, ms=9)
        ax.set(xlim=(-0.35, 2.35), ylim=(-0.8, 3.2))
    return fig


def weave_angle() -> Any:
    """The grain on a curtain at three angles."""
    fig, axes = bare(7.2, 2.6, 3)
    for ax, angle in zip(axes, (0, 30, 90), strict=True):
        sheet(ax, [(-1.4, -1), (1.4, -1), (1.4, 1), (-1.4, 1)])
        way = np.array([-np.sin(np.radians(angle)), np.cos(np.radians(angle))])
        for shift in (-0.5, 0.0, 0.5):
            at = shift * np.array([way[1], -way[0]])
            arrow(ax, at - 0.75 * way, at + 0.75 * way, RED)
        words(ax, (0, -1.3), f"weave_angle = {angle}")
        ax.set(xlim=(-1.6, 1.6), ylim=(-1.5, 1.2))
    return fig


def obstacles() -> Any:
    """The kinds of obstacles with their keys."""
    fig, axes = bare(9.0, 2.5, 5)
    body = {"fc": "0.8", "ec": "0.3"}
    for ax, name in zip(axes, ("floor", "wall", "cylinder", "sphere", "box"), strict=True):
        words(ax, (1, -0.45), name)
        ax.set(xlim=(-0.1, 2.5), ylim=(-0.7, 2.5))
    sheet(axes[0], [(0, 0), (2, 0), (2, 0.7), (0, 0.7)], **body)
    arrow(axes[0], (1, 0), (1, 0.7), both=True, width=1)
    words(axes[0], (1, 1.0), "height", fontsize=9)
    sheet(axes[1], [(0, 0), (0.7, 0), (0.7, 2), (0, 2)], **body)
    arrow(axes[1], (0.7, 1), (1.5, 1), RED)
    words(axes[1], (1.35, 1.35), "facing", fontsize=9, color=RED)
    axes[1].plot(0.7, 1, "o", color=BLUE)
    words(axes[1], (1.2, 0.6), "point", fontsize=9, color=BLUE)
    sheet(axes[2], [(0.3, 0), (1.5, 0), (1.5, 2), (0.3, 2)], **body)
    arrow(axes[2], (0.9, 1), (0.9, 2.2), RED)
    words(axes[2], (1.4, 2.3), "axis", fontsize=9, color=RED)
    arrow(axes[2], (0.9, 0.5), (1.5, 0.5), both=True, width=1)
    words(axes[2], (2.1, 0.5), "radius", fontsize=9)
    axes[2].plot(0.9, 1, "o", color=BLUE)
    words(axes[2], (2.05, 1.1), "point", fontsize=9, color=BLUE)
    axes[3].add_patch(plt.Circle((1, 1), 0.9, **body))
    axes[3].plot(1, 1, "o", color=BLUE)
    arrow(axes[3], (1, 1), (1.9, 1), width=1)
    words(axes[3], (0.95, 1.3), "centre", fontsize=9, color=BLUE)
    words(axes[3], (1.2, 0.7), "radius", fontsize=9)
    sheet(axes[4], [(0.2, 0.2), (1.8, 0.2), (1.8, 1.7), (0.2, 1.7)], **body)
    axes[4].plot(0.2, 0.2, "o", color=BLUE)
    words(axes[4], (0.95, 0.5), "corner", fontsize=9, color=BLUE)
    arrow(axes[4], (0.2, 1.9), (1.8, 1.9), both=True, width=1)
    words(axes[4], (1, 2.15), "size", fontsize=9)
    return fig


def locking_set() -> Any:
    """Strains without shear that the rings allow, with the supporting lines of three loads."""
    rows = homogenize.default_law().rows
    E = rows.E[(np.abs(rows.S[:, 1]) < 1e-9) & (np.abs(rows.E[:, 1]) < 1e-6)][:, [0, 2]]
    E = E[np.argsort(E[:, 0])]
    fig, ax = plt.subplots(figsize=(6.4, 4.6))
    low = -0.5
    ax.fill(*np.concatenate([[[low, low], [low, 0.0]], E, [[E[-1, 0], low]]]).T, fc=SHEET, ec="none")
    ax.plot(*np.concatenate([[[low, 0.0]], E, [[E[-1, 0], low]]]).T, color="0.3", lw=1.6)
    for share, at in ((0.0, 0), (0.37, 11), (1.0, -1)):
        normal, place = np.array([share, 1.0 - share]), E[at]
        size = 0.22 / np.linalg.norm(normal)
        along = np.array([-normal[1], normal[0]]) * size
        ax.plot(*np.array([place - along, place + along]).T, color=RED, lw=1.2, ls="--")
        arrow(ax, place, place + 0.7 * size * normal, RED)
        ax.plot(*place, "o", color=RED, ms=5)
    words(ax, (-0.18, 0.21), "pull along the grain", color=RED)
    words(ax, (0.42, -0.03), "S", color=RED)
    words(ax, (0.93, -0.29), "pull across", color=RED)
    words(ax, (0.03, -0.4), "K: slack inside, locked on the border")
    ax.set(xlabel="E11, across the grain", ylabel="E22, along it", xlim=(low, 1.1), ylim=(low, 0.28), aspect="equal")
    return fig


def strip_by_hand() -> Any:
    """A strip under its weight and a bar, its line load over the height, and the share of one hook."""
    fig, (strip, load) = bare(7.2, 3.8, 2)
    strip.set(xlim=(-1.8, 4.3), ylim=(-1.4, 4.6))
    load.set(xlim=(-0.8, 5.3), ylim=(-1.4, 4.6))
    sheet(strip, [(0, 0), (4, 0), (4, 3), (0, 3)])
    strip.plot([0, 4], [0, 0], color="0.2", lw=5)
    for x in (0.5, 1.5, 2.5, 3.5):
        strip.plot(x, 3, "o", color=BLUE)
        arrow(strip, (x, 3), (x, 3.7), BLUE)
    arrow(strip, (1.5, 4.0), (2.5, 4.0), both=True, width=1)
    words(strip, (2.0, 4.3), "110 mm: 24.6 N a hook", color=BLUE)
    arrow(strip, (-0.4, 0), (-0.4, 3), both=True, width=1)
    words(strip, (-1.1, 1.5), "1 m")
    arrow(strip, (2, 1.9), (2, 1.1), RED)
    words(strip, (2, 2.2), "2.785 kg/m$^2$", color=RED)
    arrow(strip, (2, 0), (2, -0.7), RED)
    words(strip, (2, -1.0), "bar: 20 kg/m", color=RED)
    sheet(load, [(0, 0), (2.63, 0), (3.0, 3), (0, 3)], fc="#f6d5d7", ec=RED)
    words(load, (1.3, -0.4), "0.196 N/mm", color=RED)
    words(load, (1.5, 3.35), "S22 = 0.224 N/mm", color=RED)
    return fig


DRAWINGS: dict[str, Callable[[], Any]] = {
    "axes_and_grain": axes_and_grain,
    "reference_width": reference_width,
    "alpha_and_beta": alpha_and_beta,
    "two_line_loads": two_line_loads,
    "edges": edges,
    "supports": supports,
    "weave_angle": weave_angle,
    "obstacles": obstacles,
    "locking_set": locking_set,
    "strip_by_hand": strip_by_hand,
}


def main(folder: Path) -> None:
    """Write every drawing as SVG; the same code gives the same bytes with the same matplotlib."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, draw in DRAWINGS.items():
        with mpl.rc_context({"svg.hashsalt": name, "font.size": SIZE, "path.simplify": True}):
            fig = draw()
            fig.savefig(folder / f"{name}.svg", bbox_inches="tight", facecolor="white", metadata={"Date": None})
            plt.close(fig)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=Path(__file__).parent / "drawings")
    main(parser.parse_args().folder)
