"""Keys of scenes in motion: how long and how, what changes over time, and bodies that are thrown.

Times are s, velocities mm/s, masses kg; a history lists pairs [time, share] between which the share changes evenly.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal, TypeVar

import numpy as np
from msgspec import Meta

from macro_fem.scene.tables import Item, Length, Mass, Name, Point3, Timed
from rve.common import Typed

Kind = TypeVar("Kind", bound=Timed)
Speed = Annotated[float, Meta(ge=-1e9, le=1e9, title="mm/s")]
Span = Annotated[float, Meta(ge=1e-9, le=1e6, title="s")]
"""Seconds; inertia over much shorter ones is beyond what numbers hold."""


@dataclass(frozen=True)
class Motion(Typed):
    """A curtain in motion for `duration` s, in steps of `step` s or, without it, of what `accuracy` asks for: the error
    of a step over the size of the curtain.

    `start`: "hung" is the curtain at rest under loads and moves at t = 0, "reference" the flat reference state at rest.
    `damping` in 1/s: a force of minus damping times mass times velocity, for what friction between rings takes.
    `scheme`: "bdf2" is of second order, "euler" loses energy and is for settling.
    """

    duration: Span
    step: Span | None = None
    accuracy: Annotated[float, Meta(ge=1e-8, le=1.0)] = 1e-3
    start: Literal["hung", "reference"] = "hung"
    damping: Annotated[float, Meta(ge=0.0, le=1e6, title="1/s")] = 0.0
    scheme: Literal["bdf2", "euler"] = "bdf2"

    def check(self) -> None:
        if self.step is not None and self.step > self.duration:
            self.refuse(f"step = {self.step:g}: is longer than the duration, {self.duration:g} s")
        if self.step is not None and self.accuracy != Motion.accuracy:
            self.refuse(f"accuracy = {self.accuracy:g}: has no effect with step")


@dataclass(frozen=True)
class Ball(Item, kind="sphere"):
    """A ball of `radius` mm and `mass` kg, with its weight, that begins at `at` with `velocity` mm/s and moves freely
    but for its pushes on the curtain.
    """

    kinds: ClassVar[dict[str, type[Any]]] = {}
    table = "body"
    radius: Length
    mass: Mass
    at: Point3
    velocity: tuple[Speed, Speed, Speed] = (0.0, 0.0, 0.0)
    name: Name = "ball"

    def check(self) -> None:
        if self.mass == 0.0:
            self.refuse("mass = 0: must be greater than 0")

    @property
    def space_reason(self) -> str:
        return f"kind = {self.kind!r} moves in space"


def scaled(item: Kind, share: float, keys: tuple[str, ...] = ("force", "move", "pressure", "drawn")) -> Kind:
    """The item with those of its `keys` that it has times `share`, and a speed, whose pressure goes with its square;
    BadField for a share that it cannot have."""
    own = {key: value for key, value in vars(item).items() if value is not None}
    new = {
        key: tuple(share * x for x in own[key]) if isinstance(own[key], tuple) else share * own[key]
        for key in keys
        if key in own
    }
    if "speed" in own:
        if share < 0.0:
            item.refuse("a wind with a speed does not turn, give one for each direction")
        new["speed"] = float(np.sqrt(share)) * own["speed"]
    return replace(item, **new)


def at_time(item: Kind, t: float) -> Kind:
    """The item as it is at the time t, s: what its history says, in place of the whole."""
    return scaled(item, float(np.interp(t, *np.transpose(item.history)))) if item.history else item
