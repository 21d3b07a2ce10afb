"""Curves of tracks: a list of points [x, z], an arc, or straight, at one height."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rve.common import Array, InputError

if TYPE_CHECKING:
    from macro_fem.scene.support_kinds import Track

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
