"""Tracks: curves in plan, at one height, along which the top edge hangs on runners or as a whole.

A track is a list of points [x, z], an arc, or straight. The mesh length of the top edge over the length of the track is
the fullness; a curtain that is drawn covers a part of the track, at its start or its end. Places along the track go
with the arc length along the top edge, so that the mesh is gathered evenly. Between the corners of the mesh a track is
straight, which keeps bounds of the curtain rigorous: they hold for the polygon through these places.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from macro_fem.scene.tables import Track
from rve.common.errors import InputError
from rve.common.types import Array

AGREES = 0.01
"""A fullness that is given besides a track of known length may differ from theirs by this part of it."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A track: `plan` (k, 2) points [x, z], or an arc of `radius` and `angle` (radians, signed) with its ends at z = 0.

    length and height (y) in mm. The arc is symmetric about x = middle; it bulges towards the viewer if angle > 0.
    """

    length: float
    height: float
    plan: Array | None = None
    radius: float = 0.0
    angle: float = 0.0
    middle: float = 0.0

    def at(self, s: Array) -> Array:
        """Places (n, 3) at the distances s (n,) from the start, measured along the track, mm.

        >>> Curve(np.pi * 100.0, 50.0, radius=100.0, angle=np.pi).at(np.array([50.0 * np.pi])).round(9).tolist()
        [[0.0, 50.0, 100.0]]
        """
        if self.plan is None:
            turn = (s / self.length - 0.5) * abs(self.angle)
            x = self.middle + self.radius * np.sin(turn)
            z = math.copysign(self.radius, self.angle) * (np.cos(turn) - math.cos(0.5 * self.angle))
        else:
            steps = np.linalg.norm(np.diff(self.plan, axis=0), axis=1)
            arc = np.concatenate([[0.0], np.cumsum(steps)])
            x, z = (np.interp(s, arc, self.plan[:, axis]) for axis in range(2))
        return np.stack([x, np.full(len(s), self.height), z], axis=-1)


def track_curve(item: Track, edge_length: float, middle: float, top: float, where: str) -> Curve:
    """The track for a top edge of this length, mm, whose middle is at x and whose highest point is at y = top.

    The length follows from `path`, or from `radius` and `angle`; what these leave open, from `fullness`. InputError,
    which begins with `where`, if they contradict each other.
    """
    height = top if item.height is None else item.height
    wanted = None if item.fullness is None else edge_length / item.fullness
    if item.path is not None:
        plan = np.array(item.path)
        length = float(np.linalg.norm(np.diff(plan, axis=0), axis=1).sum())
        curve = Curve(length, height, plan)
    elif item.radius is None and item.angle is None:
        assert wanted is not None
        half = 0.5 * wanted
        return Curve(wanted, height, np.array([[middle - half, 0.0], [middle + half, 0.0]]))
    else:
        curve = _arc(item, wanted, height, middle, where)
    if wanted is not None and abs(wanted / curve.length - 1.0) > AGREES:
        raise InputError(
            f"{where} fullness = {item.fullness:g}: contradicts a track of {curve.length:g} mm and a top edge of "
            f"{edge_length:g} mm, which make {edge_length / curve.length:.4g}; give one of them less"
        )
    return curve


def _arc(item: Track, wanted: float | None, height: float, middle: float, where: str) -> Curve:
    """The arc; radius or angle follow from the length that is wanted where they are not given."""
    radius, angle = item.radius, None if item.angle is None else math.radians(item.angle)
    if radius is None:
        assert wanted is not None
        assert angle is not None
        radius = wanted / abs(angle)
    elif angle is None:
        assert wanted is not None
        angle = wanted / radius
        if angle > 2.0 * math.pi:
            raise InputError(
                f"{where} radius = {radius:g}: a track of {wanted:g} mm, which fullness = {item.fullness:g} asks for, "
                f"is longer than the whole circle of {2.0 * math.pi * radius:g} mm"
            )
    return Curve(radius * abs(angle), height, None, radius, angle, middle)


def track_places(item: Track, curve: Curve, s: Array, edge_length: float) -> Array:
    """Places (n, 3) on the track of material points at the distances s (n,) along the top edge, mm."""
    covered = item.drawn * curve.length
    start = 0.0 if item.side == "start" else curve.length - covered
    return curve.at(start + covered * s / edge_length)


def check_track(item: Track, source: object) -> None:
    """InputError for keys of a track that contradict each other, or that leave it open."""
    where = f"{source}: [support] (track)"
    if item.path is not None:
        for key in ("radius", "angle"):
            if getattr(item, key) is not None:
                raise InputError(f"{where} {key} = {getattr(item, key):g}: is not used together with path")
        for one, two in zip(item.path, item.path[1:], strict=False):
            if one == two:
                raise InputError(f"{where} path: holds [{one[0]:g}, {one[1]:g}] twice in a row")
    elif item.fullness is None and (item.radius is None or item.angle is None):
        missing = "radius" if item.radius is None else "angle"
        raise InputError(f"{where} {missing}: is missing; a track needs path, or radius and angle, or fullness")
    if item.angle == 0.0:
        raise InputError(f"{where} angle = 0: makes no arc; leave it out for a straight track")
    if item.capacity is not None and item.pitch is None:
        raise InputError(f"{where} capacity = {item.capacity:g}: has no effect without pitch, that of the runners")
    if item.side == "end" and item.drawn == 1.0:
        raise InputError(f"{where} side = 'end': has no effect with drawn = 1")
