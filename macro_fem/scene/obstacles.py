"""Obstacles of a scene: half-spaces and convex bodies that the curtain stays outside of, and where the sheet starts.

Every obstacle answers with tangent half-spaces normal . x >= offset: the normal is that at its point closest to a
place, the offset its support function, the largest normal . y of its points y.
"""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from macro_fem.scene import tables
from macro_fem.scene.tables import NO_MOVE, Timed, Vector, Way, check_directions, in_3d, leaves_plane
from rve.common import Array, Typed
from rve.geometry import padded


def unit(v: Vector | Array) -> Array:
    """The unit vector (3,) along a vector of two or three components, whatever its size.

    >>> unit((0.0, 1e-300)).tolist()
    [0.0, 1.0, 0.0]
    """
    way = np.array(in_3d(tuple(v))) / max(map(abs, v))  # squares of very small components would be 0
    return np.asarray(way / np.linalg.norm(way))


class Obstacle(Timed):
    """What the curtain stays outside of; in motion its `history` scales `move`."""

    kinds: ClassVar[dict[str, type[Any]]] = {}
    table = "obstacle"
    name: str

    @property
    def is_plane(self) -> bool:
        """Whether it is a half-space of the plane of the curtain."""
        return True

    @property
    def space_reason(self) -> str:
        return "" if self.is_plane else f"{self.name} is not a half-space of the plane"

    @property
    def breadth(self) -> float:
        """Half the least width, mm; infinite for a half-space."""
        return np.inf

    def normal(self, x: Array) -> Array:
        """Normals (n, 3) for places x (n, 3)."""
        raise NotImplementedError

    def support(self, normal: Array) -> Array:
        """Offsets (n,) for normals (n, 3)."""
        raise NotImplementedError


class Body(Obstacle):
    """An obstacle that is no half-space, with which the curtain is no convex problem: a round one, or a box."""

    clear: str
    radius: float

    @property
    def is_plane(self) -> bool:
        return False

    @property
    def breadth(self) -> float:
        return self.radius


@dataclass(frozen=True)
class Floor(Obstacle, kind="floor"):
    """Everything below `height`, mm."""

    height: tables.Coordinate = 0.0
    move: Way = NO_MOVE
    name: tables.Name = "floor"

    def normal(self, x: Array) -> Array:
        return np.tile([0.0, 1.0, 0.0], (len(x), 1))

    def support(self, normal: Array) -> Array:
        return np.full(len(normal), self.height)


@dataclass(frozen=True)
class Wall(Obstacle, kind="wall"):
    """Everything behind the plane through `point`, which is `facing` the curtain along its normal."""

    facing: tables.Direction
    point: Way = (0.0, 0.0)
    move: Way = NO_MOVE
    name: tables.Name = "wall"

    def check(self) -> None:
        check_directions(self, facing=self.facing)

    @property
    def is_plane(self) -> bool:
        return not leaves_plane(self.facing)

    def normal(self, x: Array) -> Array:
        return np.tile(unit(self.facing), (len(x), 1))

    def support(self, normal: Array) -> Array:
        return np.asarray(normal @ in_3d(self.point))


@dataclass(frozen=True)
class Sphere(Body, kind="sphere"):
    """A ball of `radius` around `centre`."""

    centre: tables.Point3
    radius: tables.Length
    move: Way = NO_MOVE
    name: tables.Name = "sphere"
    clear: Literal["cells", "nodes"] = "cells"

    def normal(self, x: Array) -> Array:
        return _directions(x - self.centre)

    def support(self, normal: Array) -> Array:
        return np.asarray(normal @ self.centre + self.radius)


@dataclass(frozen=True)
class Cylinder(Body, kind="cylinder"):
    """A round cylinder of `radius` about the endless line through `point` along `axis`."""

    axis: tables.Direction
    radius: tables.Length
    point: tables.Point3 = (0.0, 0.0, 0.0)
    move: Way = NO_MOVE
    name: tables.Name = "cylinder"
    clear: Literal["cells", "nodes"] = "cells"

    def check(self) -> None:
        check_directions(self, axis=self.axis)

    def normal(self, x: Array) -> Array:
        axis = unit(self.axis)
        away = x - self.point
        return _directions(away - (away @ axis)[:, None] * axis)

    def support(self, normal: Array) -> Array:
        return np.asarray(normal @ self.point + self.radius)


@dataclass(frozen=True)
class Box(Body, kind="box"):
    """A box with sides along x, y and z: its `corner` of least coordinates and its `size`. Its edges are rounded by the
    radius `rounding`, by default the length of a cell, since a mesh follows no sharper edge.
    """

    corner: tables.Point3
    size: tuple[tables.Length, tables.Length, tables.Length]
    rounding: tables.Length | None = None
    move: Way = NO_MOVE
    name: tables.Name = "box"
    clear: Literal["cells", "nodes"] = "cells"

    def check(self) -> None:
        if self.rounding is not None and self.rounding > self.breadth * (1.0 + 1e-9):
            self.refuse(f"rounding = {self.rounding:g}: is more than half of its least length, {min(self.size):g} mm")

    def normal(self, x: Array) -> Array:
        """Normals (n, 3) for places x (n, 3); that of the nearest face deep inside."""
        centre, core, _ = self._parts
        away = x - centre
        out = np.abs(away) - core
        normal = np.sign(away) * np.maximum(out, 0.0)
        inside = np.flatnonzero(np.abs(normal).max(axis=1) <= 1e-9 * min(self.size))
        face = out[inside].argmax(axis=1)
        normal[inside] = 0.0
        normal[inside, face] = np.where(away[inside, face] < 0.0, -1.0, 1.0)
        return _directions(normal)

    def support(self, normal: Array) -> Array:
        centre, core, radius = self._parts
        return np.asarray(normal @ centre + np.abs(normal) @ core + radius)

    @property
    def breadth(self) -> float:
        return 0.5 * min(self.size)

    @property
    def _parts(self) -> tuple[Array, Array, float]:
        """Its centre (3,), half the sizes (3,) of the box around which the radius goes, and this radius."""
        half, radius = 0.5 * np.array(self.size), min(self.rounding or 0.0, self.breadth)
        return np.array(self.corner) + half, half - radius, radius


def _directions(away: Array) -> Array:
    """Unit vectors along the rows of `away` (n, 3), upwards where these are 0."""
    size = np.linalg.norm(away, axis=1, keepdims=True)
    return np.where(size > 0.0, away / np.where(size > 0.0, size, 1.0), [0.0, 1.0, 0.0])


@dataclass(frozen=True)
class Start(Typed):
    """Where the flat sheet lies before it is let go: the material point X is at origin + X_1 x_axis + X_2 y_axis."""

    origin: tables.Point3
    x_axis: tables.Direction = (1.0, 0.0, 0.0)
    y_axis: tables.Direction = (0.0, 1.0, 0.0)

    def check(self) -> None:
        check_directions(self, x_axis=self.x_axis, y_axis=self.y_axis)
        # Largest cosine of the angle between the two axes along which a sheet starts.
        if abs(float(unit(self.x_axis) @ unit(self.y_axis))) > 1e-3:
            self.refuse(f"y_axis = {list(self.y_axis)}: is not at a right angle to x_axis")

    @property
    def axes(self) -> Array:
        """Unit vectors (3, 3) along the sheet and normal to it, in rows."""
        x, y = unit(self.x_axis), unit(self.y_axis)
        return np.array([x, y, np.cross(x, y)])

    def places(self, X: Array) -> Array:
        """Places (n, 3) of material points X (n, 2), or beside the sheet (n, 3)."""
        return np.asarray(np.array(self.origin) + X @ self.axes[: X.shape[1]])


@dataclass(frozen=True)
class PlacedObstacle:
    """An obstacle, `number` in the scene, after `factor` of its move; d components of places."""

    number: int
    obstacle: Obstacle
    factor: float
    d: int

    @property
    def shift(self) -> Array:
        """By how much it has moved (3,), mm."""
        return self.factor * np.array(in_3d(self.obstacle.move))

    def normal(self, x: Array) -> Array:
        """Normals (n, d) of the tangent half-spaces for places x (n, d)."""
        return np.asarray(self.obstacle.normal(padded(x) - self.shift)[:, : self.d])

    def offset(self, normal: Array) -> Array:
        """Offsets (n,) of the tangent half-spaces of normals (n, d)."""
        whole = padded(normal)
        return np.asarray(self.obstacle.support(whole) + whole @ self.shift)

    def gap(self, x: Array) -> Array:
        """Distance (n,) of places x (n, d) from the obstacle, mm; negative inside."""
        normal = self.normal(x)
        return np.asarray((normal * x).sum(axis=1) - self.offset(normal))

    def least_gap(self, start: Array, end: Array) -> Array:
        """Least distance (n,) of the obstacle from straight ways between places (n, d), mm; negative inside.

        The distance from a convex body is convex along a line, which brackets it.
        """
        low, high = np.zeros(len(start)), np.ones(len(start))
        # Steps of the search for the least distance along a way; each leaves two thirds of the bracket.
        for _ in range(40):
            third = (high - low) / 3.0
            first, second = (self.gap(start + at[:, None] * (end - start)) for at in (low + third, high - third))
            low, high = np.where(first > second, low + third, low), np.where(first > second, high, high - third)
        ends = np.minimum(self.gap(start), self.gap(end))
        return np.minimum(ends, self.gap(start + 0.5 * (low + high)[:, None] * (end - start)))

    def deepest(self, start: Array, end: Array, than: float = 0.0) -> float:
        """Largest depth in mm, if more than `than`, of straight ways between places (n, d) inside the obstacle."""
        away = self.gap(start) + self.gap(end) - np.linalg.norm(end - start, axis=1)
        may = np.flatnonzero(away < -2.0 * than)
        return max(than, -float(self.least_gap(start[may], end[may]).min(initial=0.0)))
