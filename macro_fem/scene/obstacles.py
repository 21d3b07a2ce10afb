"""Obstacles of a scene: half-spaces and convex bodies that the curtain stays outside of, and where the sheet starts.

Every obstacle answers with tangent half-spaces normal . x >= offset: the normal for a place is that at the point of
the obstacle closest to it, and the offset is the largest normal . y of the obstacle's points y, its support function.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from macro_fem.scene.tables import NO_MOVE, Vector, in_3d, leaves_plane, length, vector
from rve.common.errors import InputError
from rve.common.types import Array
from rve.common.values import choice, entry, finite, read_record, text

MOST = 1e9
"""Largest coordinate, mm."""

HALVINGS = 40
"""Steps of the search for the least distance along a way; each leaves two thirds of the bracket."""

RIGHT_ANGLE = 1e-3
"""Largest cosine of the angle between the two axes along which a sheet starts."""


def _three(value: Any) -> Vector:
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise ValueError("is not a list of numbers [x, y, z]")
    return tuple(finite(least=-MOST, most=MOST)(item) for item in value)


def _way(value: Any) -> Vector:
    v = (*value, 0.0) if isinstance(value, list | tuple) and len(value) == 2 else value
    if not any(_three(v)):
        raise ValueError("has no direction: one component must not be 0")
    return _three(v)


def _lengths(value: Any) -> Vector:
    v = _three(value)
    if min(v) <= 0.0:
        raise ValueError("has a component that is not above 0")
    return v


def unit(v: Vector) -> Array:
    """The unit vector (3,) along a vector of two or three components, whatever its size.

    >>> unit((0.0, 1e-300)).tolist()
    [0.0, 1.0, 0.0]
    """
    way = np.array(in_3d(v)) / max(map(abs, v))  # squares of very small components would be 0
    return np.asarray(way / np.linalg.norm(way))


@dataclass(frozen=True)
class Floor:
    """Everything below `height`, mm."""

    height: float = entry(finite(least=-MOST, most=MOST), 0.0)
    move: tuple[float, ...] = vector(NO_MOVE)
    name: str = text("floor")

    def normal(self, x: Array) -> Array:
        """Normals (n, 3) for places x (n, 3)."""
        return np.tile([0.0, 1.0, 0.0], (len(x), 1))

    def support(self, normal: Array) -> Array:
        """Offsets (n,) for normals (n, 3)."""
        return np.full(len(normal), self.height)


@dataclass(frozen=True)
class Wall:
    """Everything behind the plane through `point`, which is `facing` the curtain along its normal."""

    facing: tuple[float, ...] = entry(_way)
    point: tuple[float, ...] = vector((0.0, 0.0))
    move: tuple[float, ...] = vector(NO_MOVE)
    name: str = text("wall")

    def normal(self, x: Array) -> Array:
        """Normals (n, 3) for places x (n, 3)."""
        return np.tile(unit(self.facing), (len(x), 1))

    def support(self, normal: Array) -> Array:
        """Offsets (n,) for normals (n, 3)."""
        return np.asarray(normal @ in_3d(self.point))


def clear() -> Any:
    """A field for what of the mesh stays outside of a body: whole cells, or its nodes only."""
    return choice("cells", "nodes", default="cells")


@dataclass(frozen=True)
class Sphere:
    """A ball of `radius` around `centre`."""

    centre: tuple[float, ...] = entry(_three)
    radius: float = length()
    move: tuple[float, ...] = vector(NO_MOVE)
    name: str = text("sphere")
    clear: str = clear()

    def normal(self, x: Array) -> Array:
        """Normals (n, 3) for places x (n, 3)."""
        return _directions(x - self.centre)

    def support(self, normal: Array) -> Array:
        """Offsets (n,) for normals (n, 3)."""
        return np.asarray(normal @ self.centre + self.radius)


@dataclass(frozen=True)
class Cylinder:
    """A round cylinder of `radius` about the endless line through `point` along `axis`."""

    axis: tuple[float, ...] = entry(_way)
    radius: float = length()
    point: tuple[float, ...] = entry(_three, (0.0, 0.0, 0.0))
    move: tuple[float, ...] = vector(NO_MOVE)
    name: str = text("cylinder")
    clear: str = clear()

    def normal(self, x: Array) -> Array:
        """Normals (n, 3) for places x (n, 3)."""
        axis = unit(self.axis)
        away = x - self.point
        return _directions(away - (away @ axis)[:, None] * axis)

    def support(self, normal: Array) -> Array:
        """Offsets (n,) for normals (n, 3)."""
        return np.asarray(normal @ self.point + self.radius)


@dataclass(frozen=True)
class Box:
    """A box with sides along x, y and z: its `corner` of least coordinates and its `size`.

    Its edges are rounded by the radius `rounding`, by default the length of a cell: a mesh follows no sharper edge, and
    forces of nodes on either side of one would be those of a plane that cuts it off.
    """

    corner: tuple[float, ...] = entry(_three)
    size: tuple[float, ...] = entry(_lengths)
    rounding: float | None = length(None)
    move: tuple[float, ...] = vector(NO_MOVE)
    name: str = text("box")
    clear: str = clear()

    def normal(self, x: Array) -> Array:
        """Normals (n, 3) for places x (n, 3); that of the nearest face deep inside."""
        away = x - self._centre
        out = np.abs(away) - self._core
        normal = np.sign(away) * np.maximum(out, 0.0)
        inside = np.flatnonzero(np.abs(normal).max(axis=1) <= 1e-9 * min(self.size))
        face = out[inside].argmax(axis=1)
        normal[inside] = 0.0
        normal[inside, face] = np.where(away[inside, face] < 0.0, -1.0, 1.0)
        return _directions(normal)

    def support(self, normal: Array) -> Array:
        """Offsets (n,) for normals (n, 3)."""
        return np.asarray(normal @ self._centre + np.abs(normal) @ self._core + self._radius)

    @property
    def _radius(self) -> float:
        return min(self.rounding or 0.0, 0.5 * min(self.size))

    @property
    def _core(self) -> Array:
        return 0.5 * np.array(self.size) - self._radius

    @property
    def _centre(self) -> Array:
        return np.array(self.corner) + 0.5 * np.array(self.size)


def _directions(away: Array) -> Array:
    """Unit vectors along the rows of `away` (n, 3), upwards where these are 0."""
    size = np.linalg.norm(away, axis=1, keepdims=True)
    return np.where(size > 0.0, away / np.where(size > 0.0, size, 1.0), [0.0, 1.0, 0.0])


Body = Cylinder | Sphere | Box
Obstacle = Floor | Wall | Body
OBSTACLES: dict[str, type[Obstacle]] = {
    "floor": Floor,
    "wall": Wall,
    "cylinder": Cylinder,
    "sphere": Sphere,
    "box": Box,
}


@dataclass(frozen=True)
class Start:
    """Where the flat sheet lies before it is let go: the material point X is at origin + X_1 x_axis + X_2 y_axis."""

    origin: tuple[float, ...] = entry(_three)
    x_axis: tuple[float, ...] = entry(_way, (1.0, 0.0, 0.0))
    y_axis: tuple[float, ...] = entry(_way, (0.0, 1.0, 0.0))

    def places(self, X: Array) -> Array:
        """Places (n, 3) of material points X (n, 2)."""
        return np.asarray(np.array(self.origin) + X @ np.array([unit(self.x_axis), unit(self.y_axis)]))


def breadth(body: Body) -> float:
    """Half the least width of a body, mm."""
    return 0.5 * min(body.size) if isinstance(body, Box) else body.radius


def with_rounding(obstacle: Obstacle, cell: float) -> Obstacle:
    """The obstacle as a mesh with cells of this length (mm) meets it: a box has round edges."""
    if not isinstance(obstacle, Box) or obstacle.rounding is not None:
        return obstacle
    return replace(obstacle, rounding=cell)


def is_flat(obstacle: Obstacle) -> bool:
    """Whether an obstacle is a half-space, so that the curtain stays a convex problem."""
    return isinstance(obstacle, Floor | Wall)


def is_in_plane(obstacle: Obstacle) -> bool:
    """Whether an obstacle is a half-space whose normal lies in the plane of the reference sheet."""
    return isinstance(obstacle, Floor) or (isinstance(obstacle, Wall) and not leaves_plane(obstacle.facing))


@dataclass(frozen=True)
class Placed:
    """An obstacle after part of its move: `number` in the scene, its `shift` (3,), components d of places."""

    number: int
    obstacle: Obstacle
    shift: Vector
    d: int

    def normal(self, x: Array) -> Array:
        """Normals (n, d) of the tangent half-spaces for places x (n, d)."""
        places = np.column_stack([x, np.zeros((len(x), 3 - self.d))]) - self.shift
        return np.asarray(self.obstacle.normal(places)[:, : self.d])

    def offset(self, normal: Array) -> Array:
        """Offsets (n,) of the tangent half-spaces of normals (n, d)."""
        whole = np.column_stack([normal, np.zeros((len(normal), 3 - self.d))])
        return np.asarray(self.obstacle.support(whole) + whole @ self.shift)

    def gap(self, x: Array) -> Array:
        """Distance (n,) of places x (n, d) from the obstacle, mm; negative inside."""
        normal = self.normal(x)
        return np.asarray((normal * x).sum(axis=1) - self.offset(normal))

    def least_gap(self, start: Array, end: Array) -> Array:
        """Least distance (n,) of the obstacle from straight ways between places (n, d), mm; negative inside.

        The distance from a convex body is convex along a line, so that its least value can be bracketed.
        """
        low, high = np.zeros(len(start)), np.ones(len(start))
        for _ in range(HALVINGS):
            third = (high - low) / 3.0
            first, second = (self.gap(start + at[:, None] * (end - start)) for at in (low + third, high - third))
            low, high = np.where(first > second, low + third, low), np.where(first > second, high, high - third)
        ends = np.minimum(self.gap(start), self.gap(end))
        return np.minimum(ends, self.gap(start + 0.5 * (low + high)[:, None] * (end - start)))


def placed(number: int, obstacle: Obstacle, factor: float, d: int) -> Placed:
    """An obstacle after `factor` of its move."""
    return Placed(number, obstacle, tuple(factor * way for way in in_3d(obstacle.move)), d)


def check_obstacle(item: Obstacle, source: str | Path) -> None:
    """InputError for a box whose edges are to be rounder than it is thick."""
    if isinstance(item, Box) and item.rounding is not None and item.rounding > 0.5 * min(item.size) * (1.0 + 1e-9):
        raise InputError(
            f"{source}: [obstacle] (box) rounding = {item.rounding:g}: is more than half of its least length, "
            f"{min(item.size):g} mm"
        )


def read_start(table: Any, source: str | Path) -> Start | None:
    """The record of [start], None without one; InputError for axes that are not at right angles."""
    if table is None:
        return None
    start = read_record(Start, table, f"{source}: [start]")
    if abs(float(unit(start.x_axis) @ unit(start.y_axis))) > RIGHT_ANGLE:
        raise InputError(f"{source}: [start] y_axis = {list(start.y_axis)}: is not at a right angle to x_axis")
    return start
