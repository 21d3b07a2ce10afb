"""Shapes of the sheet, and the finite elements that it is divided into."""

import math
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from msgspec import Meta

from macro_fem.scene.tables import Degrees, Entry, Length, Polygon
from rve.common import Array, Typed, shown
from rve.common.typed import alone

WEAVE_ANGLES = {"y": 0.0, "x": 90.0}


@dataclass(frozen=True, kw_only=True)
class Shape(Entry):
    """The sheet. `weave_angle`: degrees from the vertical to the weave's y axis; "y" is read as 0, "x" as 90."""

    kinds: ClassVar[dict[str, type[Any]]] = {}
    holes: tuple[Polygon, ...] = ()
    weave_angle: Degrees = 0.0
    areal_mass: Annotated[float, Meta(ge=0.0, le=100.0, title="kg/m2")] | None = None

    def __post_init__(self) -> None:
        """Axes of the weave become angles, then every field is checked."""
        if isinstance(self.weave_angle, str):
            if self.weave_angle not in WEAVE_ANGLES:
                what = "is neither 'x', 'y' nor a number of degrees"
                hint = f"; {alone(self.weave_angle, 'degrees')}".rstrip("; ")
                self.refuse(f"weave_angle = {shown(self.weave_angle)}: {what}{hint}")
            object.__setattr__(self, "weave_angle", WEAVE_ANGLES[self.weave_angle])
        super().__post_init__()

    def corners(self, cells: int) -> Array:
        """Corners (n, 2) of the outline in order; a round one has as many as fit `cells` along the width."""
        raise NotImplementedError

    def extent(self, points: Array) -> Array:
        """Width and height (2,) in mm; `points` (n, 2): corners of its mesh, whose polygon is no exact disk."""
        return np.asarray(np.ptp(points, axis=0))


@dataclass(frozen=True)
class Rectangle(Shape, kind="rectangle"):
    """A rectangle of mesh."""

    width: Length
    height: Length

    def corners(self, cells: int) -> Array:
        W, H = self.width, self.height
        return np.array([[0.0, 0.0], [W, 0.0], [W, H], [0.0, H]])


@dataclass(frozen=True)
class Disk(Shape, kind="disk"):
    """A disk around (0, 0)."""

    radius: Length

    def extent(self, points: Array) -> Array:
        return np.full(2, 2.0 * self.radius)

    def corners(self, cells: int) -> Array:
        """Corners (n, 2) of a regular polygon with the area of the disk, one at the top."""
        n = max(8, math.ceil(math.pi * cells))
        angle = 0.5 * math.pi + 2.0 * math.pi * np.arange(n) / n
        same_area = self.radius * math.sqrt(2.0 * math.pi / (n * math.sin(2.0 * math.pi / n)))
        return same_area * np.round(np.stack([np.cos(angle), np.sin(angle)], axis=-1), 15)  # 0 is 0


@dataclass(frozen=True)
class Outline(Shape, kind="outline"):
    """A polygon by its corners in order."""

    outline: Polygon

    def corners(self, cells: int) -> Array:
        return np.array(self.outline)


@dataclass(frozen=True)
class MeshFile(Shape, kind="file"):
    """A mesh file, Gmsh's .msh or .vtu; its path begins at the folder of the scene file."""

    file: Annotated[str, Meta(min_length=1)]

    def check(self) -> None:
        if self.holes:
            self.refuse('holes: are not used by shape = "file"')


@dataclass(frozen=True)
class Mesh(Typed):
    """`cells` along the width. `pattern`: "aligned" has edges along both diagonal families of the weave."""

    cells: Annotated[int, Meta(ge=1, le=20_000)] = 32
    element: Literal["P1", "P2"] = "P1"
    pattern: Literal["aligned", "crossed", "diagonal"] = "aligned"
