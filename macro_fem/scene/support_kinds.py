"""Kinds of supports: what holds the curtain, each a class with its keys and what it holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from macro_fem.scene.sites import Held, Site, edge_line, placed_along, point_node, sloping, unit_direction
from macro_fem.scene.tables import (
    LEAST_MM,
    NO_MOVE,
    Capacity,
    Count,
    Factor,
    HeldAxes,
    Length,
    Name,
    Place,
    RingsPerHook,
    Support,
    Vector,
    Way,
    in_3d,
    leaves_plane,
)


@dataclass(frozen=True)
class Corners(Support, kind="corners"):
    """Both ends of the top edge held; `gather` narrows their distance; `rings_per_hook` as for hooks."""

    one = "corner"

    gather: Factor = 1.0
    move: Way = NO_MOVE
    rings_per_hook: RingsPerHook = 1

    def hold(self, site: Site, factor: float) -> Held:
        nodes = site.edge("top")[0][[0, -1]]
        return site.held("corners", nodes, site.gathered(nodes, self.gather), factor)


@dataclass(frozen=True)
class Top(Support, kind="top"):
    """The whole top edge held; `gather` narrows it."""

    gather: Factor = 1.0
    move: Way = NO_MOVE

    def hold(self, site: Site, factor: float) -> Held:
        nodes, facets = site.edge("top")
        return site.held("top", nodes, site.gathered(nodes, self.gather), factor, facets=facets)


@dataclass(frozen=True)
class Rail(Support, kind="rail"):
    """The top edge held in height, and in space in z too, free to slide sideways."""

    def hold(self, site: Site, factor: float) -> Held:
        nodes, facets = site.edge("top")
        return site.held("rail", nodes, site.disc.nodes[nodes], factor, "yz", facets)


@dataclass(frozen=True)
class Hooks(Support, kind="hooks"):
    """Points of the top edge, held or sliding along a rail: one at each end, evenly spaced close to `pitch` mm.

    `count`: how many there are along each line of the edge, in place of a pitch. `capacity`: the force in N that a hook
    bears; `rings_per_hook`: the rings that share this force. Results are compared with what both bear.
    """

    one = "hook"

    pitch: Length | None = None
    count: Count | None = None
    gather: Factor = 1.0
    sliding: bool = False
    capacity: Capacity | None = None
    rings_per_hook: RingsPerHook = 1

    def check(self) -> None:
        if self.pitch is None and self.count is None:
            self.refuse("pitch: is missing; give it in mm, or the count of hooks")
        if self.pitch is not None and self.count is not None:
            self.refuse(f"count = {self.count}: is not used together with pitch")

    def hold(self, site: Site, factor: float) -> Held:
        nodes = site.hooks()
        return site.held("hooks", nodes, site.gathered(nodes, self.gather), factor, "yz" if self.sliding else "both")


@dataclass(frozen=True)
class Edge(Support, kind="edge"):
    """A named edge held, by default in all directions, and moved by `move` mm.

    `along`: two points [x, y, z] of a straight line on which the edge lies, from its left or lower end to the other,
    such as a cable; with `sliding` the edge slides on that line, which has no end.
    """

    edge: Name
    held: HeldAxes = "both"
    gather: Factor = 1.0
    move: Way = NO_MOVE
    along: tuple[Way, Way] | None = None
    sliding: bool = False

    def check(self) -> None:
        if self.along is None:
            if self.sliding:
                self.refuse("sliding = true: has no effect without along, the line to slide on")
            return
        first, last = map(in_3d, self.along)
        object.__setattr__(self, "along", (first, last))
        if max(abs(a - b) for a, b in zip(first, last, strict=True)) < LEAST_MM:
            self.refuse(f"along = {[first, last]}: is no line: its points are less than {LEAST_MM:g} mm apart")
        if self.gather != 1.0:
            self.refuse(f"gather = {self.gather:g}: has no effect with along, which says where the edge lies")
        if self.held != "both":
            self.refuse(f"held = {self.held!r}: has no effect with along, which holds all but what slides")

    @property
    def space_reason(self) -> str:
        if self.along and any(map(leaves_plane, self.along)):
            return f"along = {[list(point) for point in self.along]} leaves the plane"
        return super().space_reason

    def hold(self, site: Site, factor: float) -> Held:
        if self.along is not None:
            return self._on_line(site, self.along, factor)
        nodes, facets = site.edge(self.edge, "edge")
        X = site.disc.nodes[nodes]
        centre = 0.5 * (X.min(axis=0) + X.max(axis=0))
        return site.held(f"edge {self.edge}", nodes, centre + self.gather * (X - centre), factor, self.held, facets)

    def _on_line(self, site: Site, along: tuple[Vector, Vector], factor: float) -> Held:
        """The edge evenly between two points of a straight line in space, held or free to slide."""
        d = site.scene.d
        line, s = edge_line(site.mesh, self.edge, f"{site.where} edge")
        first, last = (np.array(point[:d]) for point in along)
        nodes, places = placed_along(site, line, first + (s / s[-1])[:, None] * (last - first))
        e = unit_direction(last - first)
        mask = np.ones(places.shape, bool)
        if self.sliding and not sloping(e):
            mask[:, e != 0.0] = False
        slide = e if self.sliding and sloping(e) else None
        facets = site.mesh.edge(self.edge, f"{site.where} edge")
        return Held(f"edge {self.edge}", nodes, mask, places + factor * site.move, facets, slide)


@dataclass(frozen=True)
class Point(Support, kind="point"):
    """The material point `at` held and moved by `move` mm; `rings_per_hook` as for hooks."""

    at: Place
    held: HeldAxes = "both"
    move: Way = NO_MOVE
    rings_per_hook: RingsPerHook = 1

    @property
    def points(self) -> tuple[Vector, ...]:
        return (self.at,)

    def hold(self, site: Site, factor: float) -> Held:
        nodes = point_node(self.at, site.disc)
        name = f"point ({self.at[0]:g}, {self.at[1]:g})"
        return site.held(name, nodes, site.disc.nodes[nodes], factor, self.held)
