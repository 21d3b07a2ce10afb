"""Keys of scenes in motion: how long and how, what changes over time, and bodies that are thrown.

Times are s, velocities mm/s, masses kg; a history lists pairs [time, share] between which the share changes evenly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal, TypeVar

import numpy as np
from msgspec import Meta

from macro_fem.scene.tables import Item, Length, Name, Point3, Timed
from rve.common.typed import Typed

Kind = TypeVar("Kind", bound=Timed)
Speed = Annotated[float, Meta(ge=-1e9, le=1e9)]


@dataclass(frozen=True)
class Motion(Typed):
    """A curtain in motion for `duration` s, in steps of `step` s or, without it, of what `accuracy` asks for: the error
    of a step over the size of the curtain.

    `start`: "hung" is the curtain at rest under loads and moves at t = 0, "reference" the flat reference state at rest.
    `damping` in 1/s: a force of minus damping times mass times velocity, for what friction between rings takes.
    `scheme`: "bdf2" is of second order, "euler" loses energy and is for settling.
    """

    duration: Annotated[float, Meta(gt=0.0, le=1e6)]
    step: Annotated[float, Meta(gt=0.0, le=1e6)] | None = None
    accuracy: Annotated[float, Meta(ge=1e-8, le=1.0)] = 1e-3
    start: Literal["hung", "reference"] = "hung"
    damping: Annotated[float, Meta(ge=0.0, le=1e6)] = 0.0
    scheme: Literal["bdf2", "euler"] = "bdf2"

    def check(self) -> None:
        """BadField for a step beyond the duration."""
        if self.step is not None and self.step > self.duration:
            self.refuse(f"step = {self.step:g}: is longer than the duration, {self.duration:g} s")


class Thrown(Item):
    """A body with mass, subject to gravity, that moves freely but for its pushes on the curtain."""

    kinds: ClassVar[dict[str, type[Thrown]]] = {}
    table = "body"

    def __init_subclass__(cls, kind: str, **more: Any) -> None:
        """Make the kind known to scene files."""
        super().__init_subclass__(**more)
        cls.kind, Thrown.kinds[kind] = kind, cls

    @property
    def space_reason(self) -> str:
        """Bodies move in space."""
        return f"kind = {self.kind!r} moves in space"


@dataclass(frozen=True)
class Ball(Thrown, kind="sphere"):
    """A ball of `radius` mm and `mass` kg that begins at `at` with `velocity` mm/s."""

    radius: Length
    mass: Annotated[float, Meta(ge=0.0, le=1e9)]
    at: Point3
    velocity: tuple[Speed, Speed, Speed] = (0.0, 0.0, 0.0)
    name: Name = "ball"

    def check(self) -> None:
        """BadField for a body without mass, whose motion nothing decides."""
        if self.mass == 0.0:
            self.refuse("mass = 0: must be greater than 0")


SCALED = ("force", "move", "pressure", "drawn")
"""Keys that a history multiplies; of a wind with a speed it multiplies the pressure."""


def at_time(item: Kind, t: float) -> Kind:
    """The item as it is at the time t, s: what its history says, in place of the whole.

    >>> from macro_fem import Edge
    >>> at_time(Edge("top", move=(10.0, 0.0), history=((0.0, 0.0), (2.0, 1.0))), 0.5).move
    (2.5, 0.0)
    """
    if not item.history:
        return item
    times, shares = np.transpose(item.history)
    share = float(np.interp(t, times, shares))
    new: dict[str, Any] = {}
    for key in SCALED:
        value = getattr(item, key, None)
        if value is not None:
            new[key] = tuple(share * part for part in value) if isinstance(value, tuple) else share * value
    speed = getattr(item, "speed", None)
    if speed is not None:
        new["speed"] = speed * float(np.sqrt(max(share, 0.0)))
    return replace(item, **new)
