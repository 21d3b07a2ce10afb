"""What is looked at in space: surfaces and lines with a colour or with values on one scale of colours.

The same `View` makes a picture and an animation (`rve.common.drawing.render`) and a page that turns in a browser
(`rve.common.drawing.page`). Coordinates are mm, or the `unit` of the view; the second axis points up.
"""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rve.common.types import Array

Index = NDArray[np.intp]

VIRIDIS = (
    *("#440154", "#482475", "#414487", "#355f8d", "#2a788e", "#21918c"),
    *("#22a884", "#44bf70", "#7ad151", "#bddf26", "#fde725"),
)
"""Eleven even steps of the perceptually uniform map viridis."""
PLASMA = (
    *("#0d0887", "#37049a", "#5601a3", "#7401a8", "#9011a1", "#a92495"),
    *("#bf3984", "#d14f72", "#e16561", "#f07d4f", "#f89a3f"),
)
"""Eleven even steps of the perceptually uniform map plasma without its lightest part: for lines on white."""
OVER = "#d6004d"
"""The colour of values above the scale."""
TOP_SHARE = 0.995
"""The scale of colours ends where this share of the values lies below."""
NICE = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)


@dataclass(frozen=True)
class Scale:
    """Colours of values from `low` to `top`; `largest` may be above `top`.

    spread: "even", "root" (by the square root: small values are told apart) or "log" (by the logarithm).
    """

    label: str
    low: float
    top: float
    largest: float
    colours: tuple[str, ...] = VIRIDIS
    over: str = OVER
    spread: str = "even"

    @classmethod
    def of(cls, values: Array, label: str) -> Scale:
        """From 0 to a round number that `TOP_SHARE` of the values do not exceed.

        >>> scale = Scale.of(np.append(np.linspace(0.0, 0.9, 999), 7.0), "line load, N/mm")
        >>> scale.top, scale.largest, scale.is_exceeded
        (1.0, 7.0, True)
        """
        largest = float(np.max(values, initial=0.0))
        bulk = float(np.quantile(values, TOP_SHARE)) if len(values) else 0.0
        return cls(label, 0.0, rounded_up(bulk if bulk > 0.0 else largest), largest, spread="root")

    @property
    def is_exceeded(self) -> bool:
        """Whether some values are above the scale."""
        return self.largest > self.top * (1.0 + 1e-9)

    def share(self, values: Array) -> Array:
        """Where values lie on the scale, 0 at its low and 1 at its top end; not limited to that range."""
        if self.spread == "log":
            return np.asarray(np.log(np.maximum(values, self.low) / self.low) / np.log(self.top / self.low))
        even = (np.asarray(values) - self.low) / (self.top - self.low)
        return np.sqrt(np.maximum(even, 0.0)) if self.spread == "root" else even

    def ticks(self) -> list[float]:
        """Values to write beside the scale, low to top.

        >>> Scale("force, N", 0.0, 2.0, 2.0).ticks(), Scale("force, N", 0.05, 2.0, 2.0, spread="log").ticks()
        ([0.0, 0.5, 1.0, 1.5, 2.0], [0.05, 0.1, 1.0, 2.0])
        """
        if self.spread == "log":
            powers = 10.0 ** np.arange(np.ceil(np.log10(self.low)), np.floor(np.log10(self.top)) + 1)
            at = self.share(powers)
            inner = [float(f"{power:.6g}") for power in powers[(at > 0.16) & (at < 0.93)]]  # texts do not overlap
            return [self.low, *inner, self.top]
        shares = (0.0, 0.1, 0.3, 0.6, 1.0) if self.spread == "root" else (0.0, 0.25, 0.5, 0.75, 1.0)
        return [float(f"{self.low + x * (self.top - self.low):.6g}") for x in shares]

    def tick_labels(self) -> list[str]:
        """What is written at `ticks`; a logarithmic scale also shows all values below its low end there.

        >>> Scale("force, N", 0.05, 2.0, 2.0, spread="log").tick_labels()
        ['≤ 0.05', '0.1', '1', '2']
        """
        labels = [f"{value:.3g}" for value in self.ticks()]
        return [f"≤ {labels[0]}", *labels[1:]] if self.spread == "log" else labels


def rounded_up(value: float, steps: tuple[float, ...] = NICE) -> float:
    """The smallest of `steps`, from 1 to 10, times a power of ten that is not below `value`; 1 for 0.

    >>> rounded_up(0.0234), rounded_up(1200.0), rounded_up(0.0)
    (0.025, 1500.0, 1.0)
    """
    if not value > 0.0:
        return 1.0
    power = int(np.floor(np.log10(value)))
    step = next(step for step in steps if step >= value / 10.0**power * (1.0 - 1e-9))
    return float(f"{step * 10.0**power:.6g}")


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles (t, 3) of points (p, 3), in one colour, or coloured by `values` (p,) on the scale of the view.

    is_smooth: shaded as a smooth surface, else facet by facet; is_lit: shaded at all.
    """

    name: str
    points: Array
    triangles: Index
    colour: str = "#b8bec6"
    values: Array | None = field(default=None, repr=False)
    opacity: float = 1.0
    is_smooth: bool = True
    is_lit: bool = True
    in_legend: bool = True


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines (n, k, 3) of k points each, in one colour, or coloured by `values` (n,) on the scale of the view.

    `radius` in mm: in a picture lines are tubes; in a page they are `width` pixels wide.
    """

    name: str
    points: Array
    radius: float
    colour: str = "#b8bec6"
    values: Array | None = field(default=None, repr=False)
    width: float = 3.0
    in_legend: bool = True


@dataclass(frozen=True, eq=False)
class Camera:
    """Looks along `direction` (3,) with `up` (3,); the box around the points `focus` (p, 3) fills the picture.

    Without focus it is the box around all parts of the view. hides: names of parts that this camera does not see.
    """

    name: str
    direction: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    focus: Array | None = field(default=None, repr=False)
    hides: tuple[str, ...] = ()


FRONT = Camera("front", (0.0, -0.12, -1.0))
THREE_QUARTERS = Camera("three quarters", (-0.75, -0.45, -1.0))


@dataclass(frozen=True, eq=False)
class View:
    """Parts with their scale of colours (None if no part has values) and the cameras that look at them.

    title: one or two lines above the picture; notes: lines below it; axes, unit: what the three coordinates are, "" for
    numbers without unit.
    """

    title: str
    parts: tuple[Surface | Lines, ...]
    scale: Scale | None = None
    cameras: tuple[Camera, ...] = (FRONT, THREE_QUARTERS)
    notes: tuple[str, ...] = ()
    axes: tuple[str, str, str] = ("x", "y", "z")
    unit: str = "mm"

    def box(self) -> Array:
        """The box (2, 3) around all parts, mm."""
        low = np.min([part.points.reshape(-1, 3).min(axis=0) for part in self.parts], axis=0)
        high = np.max([part.points.reshape(-1, 3).max(axis=0) for part in self.parts], axis=0)
        return np.stack([low, high])


def merged(name: str, solids: list[tuple[Array, Index]], colour: str, **style: bool | float) -> Surface:
    """One surface of several solids, each points (p, 3) and triangles (t, 3)."""
    starts = np.cumsum([0, *(len(points) for points, _ in solids)])
    triangles = [triangles + start for (_, triangles), start in zip(solids, starts, strict=False)]
    points = np.concatenate([points for points, _ in solids])
    return Surface(name, points, np.concatenate(triangles), colour, None, **style)  # type: ignore[arg-type]


def packed(views: Sequence[View]) -> bytes:
    """Views as an npz archive: their arrays, and `tree`, JSON of all else that names each array by its number.

    >>> view = View("two", (Lines("rail", np.zeros((1, 2, 3)), 2.0),), notes=("a", "b"))
    >>> [again] = unpacked(packed([view]))
    >>> again.notes, again.parts[0].points.shape, again.cameras[0].direction
    (('a', 'b'), (1, 2, 3), (0.0, -0.12, -1.0))
    """
    entries: dict[str, Any] = {}

    def tree(node: Any) -> Any:
        if isinstance(node, np.ndarray):
            entries[name := str(len(entries))] = node
            return {"array": name}
        if is_dataclass(node):
            return {"kind": type(node).__name__} | {one.name: tree(getattr(node, one.name)) for one in fields(node)}
        return [tree(one) for one in node] if isinstance(node, Sequence) and not isinstance(node, str) else node

    entries["tree"] = np.array(json.dumps(tree(views)))
    stream = io.BytesIO()
    np.savez(stream, **entries)
    return stream.getvalue()


def unpacked(data: bytes) -> tuple[View, ...]:
    """The views that `packed` has written; nothing in `data` is executed. ValueError for a pickle."""
    kinds = {kind.__name__: kind for kind in (View, Surface, Lines, Scale, Camera)}
    with np.load(io.BytesIO(data), allow_pickle=False) as stored:

        def value(node: Any) -> Any:
            if isinstance(node, list):
                return tuple(value(one) for one in node)
            if not isinstance(node, dict):
                return node
            if "array" in node:
                return stored[node["array"]]
            return kinds[node["kind"]](**{name: value(one) for name, one in node.items() if name != "kind"})

        return tuple(value(json.loads(str(stored["tree"]))))
