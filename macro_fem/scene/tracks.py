"""Tracks: curves in plan, at one height, along which the top edge hangs on runners or as a whole.

A track is a list of points [x, z], an arc, or straight. The mesh length of the top edge over the length of the track is
the fullness; a curtain that is drawn covers a part of the track, at its start or its end. Places along the track go
with the arc length along the top edge, so that the mesh is gathered evenly. Between the corners of the mesh a track is
straight, which keeps bounds of the curtain rigorous: they hold for the polygon through these places.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from msgspec import Meta

from macro_fem.scene.sites import NONE, Held, Site, edge_line, placed_along
from macro_fem.scene.tables import (
    MAX_CORNERS,
    Capacity,
    Coordinate,
    Count,
    Degrees,
    Factor,
    Length,
    Place,
    RingsPerHook,
    Share,
    Support,
)
from rve.common import Array, InputError

if TYPE_CHECKING:
    from macro_fem.scene.meshing.mesh import CurtainMesh

AGREES = 0.01
"""A fullness that is given besides a track of known length may differ from theirs by this part of it."""


@dataclass(frozen=True)
class Track(Support, kind="track"):
    """The top edge on a curve in plan at the height y = `height`, that of the top edge by default.

    The curve is `path`, a list of points [x, z], an arc of `radius` and `angle` (degrees; positive bulges towards the
    viewer), or straight and as long as `fullness` says: mesh length of the top edge over length of the track. `pitch`:
    distance of the runners along the mesh, `count`: how many there are; without both the whole edge is held. `drawn`:
    the part of the track that the curtain covers, from its `side`. `capacity` and `rings_per_hook`: of each runner.
    """

    one = "runner"

    path: Annotated[tuple[Place, ...], Meta(min_length=2, max_length=MAX_CORNERS)] | None = None
    radius: Length | None = None
    angle: Degrees | None = None
    height: Coordinate | None = None
    fullness: Factor | None = None
    pitch: Length | None = None
    count: Count | None = None
    drawn: Share = 1.0
    side: Literal["start", "end"] = "start"
    capacity: Capacity | None = None
    rings_per_hook: RingsPerHook = 1

    def check(self) -> None:
        if self.path is not None:
            for key in ("radius", "angle"):
                if getattr(self, key) is not None:
                    self.refuse(f"{key} = {getattr(self, key):g}: is not used together with path")
            for one, two in pairwise(self.path):
                if one == two:
                    self.refuse(f"path: holds [{one[0]:g}, {one[1]:g}] twice in a row")
        elif self.fullness is None and (self.radius is None or self.angle is None):
            missing = "radius" if self.radius is None else "angle"
            self.refuse(f"{missing}: is missing; a track needs path, or radius and angle, or fullness")
        if self.angle == 0.0:
            self.refuse("angle = 0: makes no arc; leave it out for a straight track")
        if self.pitch is not None and self.count is not None:
            self.refuse(f"count = {self.count}: is not used together with pitch")
        for key, unset in () if self.has_hooks else (("capacity", None), ("rings_per_hook", 1)):
            if getattr(self, key) != unset:
                self.refuse(f"{key} = {getattr(self, key):g}: has no effect without pitch, that of the runners")
        if self.side == "end" and self.drawn == 1.0 and not self.history:
            self.refuse("side = 'end': has no effect with drawn = 1")

    @property
    def space_reason(self) -> str:
        return "kind = 'track' leaves the plane"

    def hold(self, site: Site, factor: float) -> Held:
        line, s, curve = track_of(self, site.mesh, site.where)
        if self.has_hooks:
            nodes, facets = site.hooks(), NONE
            places = track_places(self, curve, np.linspace(0.0, s[-1], len(nodes)), s[-1])
        else:
            nodes, places = placed_along(site, line, track_places(self, curve, s, s[-1]))
            facets = site.mesh.edges["top"]
        return Held("track", nodes, np.ones(places.shape, bool), places, facets)


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
    wanted = math.nan if item.fullness is None else edge_length / item.fullness
    radius, angle = item.radius, None if item.angle is None else math.radians(item.angle)
    if item.path is not None:
        plan = np.array(item.path)
        curve = Curve(float(np.linalg.norm(np.diff(plan, axis=0), axis=1).sum()), height, plan)
    elif radius is None and angle is None:
        curve = Curve(wanted, height, np.array([[middle - 0.5 * wanted, 0.0], [middle + 0.5 * wanted, 0.0]]))
    else:
        if radius is None:
            radius = wanted / abs(angle or 1.0)
        if angle is None:
            angle = wanted / radius
        if abs(angle) > 2.0 * math.pi:
            raise InputError(
                f"{where} radius = {radius:g}: a track of {wanted:g} mm, which fullness = {item.fullness:g} asks for, "
                f"is longer than the whole circle of {2.0 * math.pi * radius:g} mm"
            )
        curve = Curve(radius * abs(angle), height, None, radius, angle, middle)
    if abs(wanted / curve.length - 1.0) > AGREES:
        raise InputError(
            f"{where} fullness = {item.fullness:g}: contradicts a track of {curve.length:g} mm and a top edge of "
            f"{edge_length:g} mm, which make {edge_length / curve.length:.4g}; give one of them less"
        )
    return curve


def track_places(item: Track, curve: Curve, s: Array, edge_length: float) -> Array:
    """Places (n, 3) on the track of material points at the distances s (n,) along the top edge, mm."""
    covered = item.drawn * curve.length
    start = 0.0 if item.side == "start" else curve.length - covered
    return curve.at(start + covered * s / edge_length)


def track_of(item: Track, mesh: CurtainMesh, where: str) -> tuple[np.ndarray, Array, Curve]:
    """Corners (k,) of the mesh along the top edge, their distances (k,) from its left end, and the track."""
    line, s = edge_line(mesh, "top", f"{where} needs edge")
    x, y = mesh.mesh.p[:, line]
    return line, s, track_curve(item, s[-1], 0.5 * float(x.min() + x.max()), float(y.max()), where)
