"""A mesh as it is made: a rectangular piece of whole rings with its clearance, and what a maker asks of a ring."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from rve.common import SENTENCES, Array, Index, InputError, JsonObject, NotConverged, check_out_file, checked, digits
from rve.common.cell_fields import ring_volume
from rve.common.ring_sizes import ring_sizes, ring_words
from rve.geometry.cell import Cell
from rve.geometry.contacts import find_contacts, unlisted_pairs
from rve.geometry.pattern import padded
from rve.geometry.pose import Pose, start_pose
from rve.geometry.weave import Weave
from rve.placed.drawn import DrawnRings
from rve.placed.fit import axes_of_weave, fit_rings, neighbours
from rve.placed.solids import SOLID_ENDINGS, write_solids
from rve.solve import lattice_mm, solve_table

MOST_RINGS = 100_000
"""Of a piece; slicers and browsers end well before."""
REACH = 2.0
"""Gaps are searched up to this many r1, more than any slack weave has."""


@dataclass(frozen=True, eq=False, repr=False)
class Piece:
    """A piece of mesh of whole rings, its corner at the origin, every ring linked to the others.

    cell: the rings as they are made; rings: where they are, in mm; size_mm: width, height (along the grain where it is
    y) and thickness; clearance_mm: least gap of any two rings; links: pairs that interlink, all and only those of the
    weave.
    """

    cell: Cell
    rings: DrawnRings
    size_mm: tuple[float, float, float]
    clearance_mm: float
    links: int

    @classmethod
    @checked
    def cut(
        cls,
        cell: Cell,
        size: tuple[float, float],
        clearance: float | None = None,
        load: tuple[float, float] | None = None,
    ) -> Self:
        """As many whole rings as `size`, width and height in mm, has room for.

        The pose is the slack one of largest clearance, or that locked under the `load` (alpha, beta) in degrees.
        clearance: least gap in mm, for which the wire is made thinner where need be; centre circles stay. InputError
        for a size without two linked rings or with too many, and a clearance that leaves no wire. NotConverged if the
        load has no locked pose.

        >>> piece = Piece.cut(Cell.of(inner=8, wire=1.6), (60, 40), clearance=0.9)
        >>> piece.links > len(piece.rings.centre), round(piece.clearance_mm, 6)
        (True, 0.9)
        """
        pose, weave = start_pose(cell.weave, 1), cell.weave
        if load is not None:
            states = solve_table(replace(cell, cells=(1, 1), centres="plane"), ([load[0]], [load[1]])).states
            assert states is not None
            if states.found.status[0] != "converged":
                raise NotConverged(f"alpha = {load[0]:g}, beta = {load[1]:g}: {SENTENCES[str(states.found.status[0])]}")
            pose = states.found.pose
        patterns = weave, unlisted_pairs(weave)
        found = [find_contacts(pose, pairs, cell.wire, REACH) for pairs in patterns]
        gap = cell.r1 * min(float(contacts.min_gap[0]) for contacts in found)
        if clearance is not None and not 0.0 <= clearance < np.inf:
            raise InputError(f"clearance = {clearance:g}: is no length in mm")
        if clearance is not None and gap < clearance:
            if not clearance < gap + 2.0 * cell.r2:
                apart = digits(gap + 2.0 * cell.r2)
                what = f"leaves no wire, since centre lines of rings are only {apart} mm apart"
                raise InputError(f"clearance = {clearance:g}: {what}; ask for less, or for larger rings")
            both = zip(found, patterns, strict=True)
            rooms = [(cell.r1 * one.distance[0] - clearance) / pairs.pair_wires[:, None] for one, pairs in both]
            cell, gap = replace(cell, r2=float(min(room.min(initial=np.inf) for room in rooms))), clearance
        index, centre, normal, half = _whole_rings(cell, weave, pose, size)
        fit = fit_rings(index, centre, normal, cell)
        if not all(contacts.links_intact[0] for contacts in found) or fit.linked < fit.links:
            raise InputError(f"{weave.name}: rings of this pose do not interlink as the weave says")
        low, high = (centre - half).min(axis=0), (centre + half).max(axis=0)
        width, height, thickness = (high - low).tolist()
        kind = index[:, 0]
        rings = DrawnRings(centre - low, normal, cell.r1 * weave.radii[kind], cell.r2 * weave.wires[kind])
        least = min(gap, float(fit.gap_mm.min()))
        return cls(cell, rings, (width, height, thickness), least, fit.links)

    def save(self, path: str | Path) -> None:
        """Write the rings as solids, by the ending of the name: .3mf, .glb or .stl. InputError for other endings and
        files that cannot be written."""
        check_out_file(path, endings=SOLID_ENDINGS)
        write_solids(Path(path), self.rings)

    @property
    def record(self) -> JsonObject:
        """Its numbers, with units in their names."""
        count = len(self.rings.centre)
        numbers = {"rings": count, "links": self.links, "clearance_mm": self.clearance_mm, "size_mm": self.size_mm}
        relative = float((np.asarray(self.rings.r1) * np.asarray(self.rings.r2) ** 2).sum())
        mass = {"mass_kg": self.cell.ring_mass * relative / (self.cell.r1 * self.cell.r2**2)}
        return {"weave": self.cell.weave.name, **ring_sizes(self.cell.r1, self.cell.r2), **numbers, **mass}

    def __str__(self) -> str:
        size, told = " x ".join(digits(one, 4) for one in self.size_mm), self.record
        touch = "" if self.clearance_mm > 1e-6 * self.cell.r1 else "; rings touch, and printers need a clearance"
        return (
            f"{told['rings']} rings of {ring_words(self.cell.r1, self.cell.r2)}\n"
            f"{size} mm, {digits(1e3 * told['mass_kg'], 4)} g of {self.cell.material.name}; {self.links} links, all "
            f"and only those of {told['weave']}\nleast clearance {0.0 if touch else self.clearance_mm:.3g} mm{touch}"
        )

    __repr__ = __str__


def _whole_rings(cell: Cell, weave: Weave, pose: Pose, size: tuple[float, float]) -> tuple[Index, Array, Array, Array]:
    """Class and lattice point (n, 3), centre (n, 3) in mm, normal (n, 3) and half the extent (n, 3) of the rings that
    are wholly inside a rectangle of this size and linked to the others; of all its places on the lattice at which rings
    touch two of its sides, that with most."""
    if not all(0.0 < one < np.inf for one in size):
        raise InputError(f"size = {size[0]:g} x {size[1]:g}: is no width and height in mm")
    cos, sin = pose.a1[0] / np.linalg.norm(pose.a1[0])
    axes = axes_of_weave(cell, 0.0) @ [[cos, sin], [-sin, cos]]  # rows are level, whatever the pose's shear
    lattice = cell.r1 * np.stack([pose.a1[0], pose.a2[0]]) @ axes.T
    centres, normals = cell.r1 * padded(pose.centres[0]), pose.normals[0].copy()
    centres[:, :2], normals[:, :2] = centres[:, :2] @ axes.T, normals[:, :2] @ axes.T
    half = cell.r1 * weave.radii[:, None] * np.sqrt(1.0 - np.minimum(normals**2, 1.0))
    half += cell.r2 * weave.wires[:, None]
    corners = np.array([[x, y] for x in (-1.0, 1.0) for y in (-1.0, 1.0)]) * size
    most = np.ceil(np.abs(corners @ np.linalg.inv(lattice)).max(axis=0)).astype(int) + 2
    if weave.classes * float(np.prod(2.0 * most + 1.0)) > 8.0 * MOST_RINGS:
        raise InputError(f"size = {size[0]:g} x {size[1]:g}: has more than {MOST_RINGS} rings; ask for a smaller piece")
    ranges = np.arange(weave.classes), *(np.arange(-n, n + 1) for n in most)
    index = np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, 3)
    place, extent = (index[:, 1:] @ lattice + centres[index[:, 0], :2]), half[index[:, 0], :2]
    best = np.zeros(0, dtype=int)
    for left in centres[:, 0] - half[:, 0]:
        for below in centres[:, 1] - half[:, 1]:
            low, high = place - extent - (left, below), place + extent - (left, below)
            inside = np.flatnonzero(((low > -1e-9 * cell.r1) & (high < size)).all(axis=1))
            best = max(best, inside, key=len)
    index = index[best]
    if len(index):
        pairs = [np.stack(ends) for pair, *ends in neighbours(weave, index) if weave.linked[pair]]
        links = np.concatenate(pairs, axis=1)
        graph = coo_matrix((np.ones(links.shape[1]), links), shape=(len(index), len(index)))
        label = connected_components(graph, directed=False)[1]
        index = index[label == np.bincount(label).argmax()]
    if not 2 <= len(index) <= MOST_RINGS:
        what = "two linked rings" if len(index) < 2 else f"more than {MOST_RINGS} rings"
        least = ring_words(cell.r1, cell.r2)
        raise InputError(f"size = {size[0]:g} x {size[1]:g}: has {'no ' * (len(index) < 2)}{what} of {least}")
    kind = index[:, 0]
    flat = centres[kind] + padded(index[:, 1:] @ lattice)
    return index, flat, normals[kind], half[kind]


def ring_facts(cell: Cell) -> JsonObject:
    """What a maker asks of a ring: sizes in mm, mass in kg and wire in mm of one, where its weave jams, clearance of
    the slack mesh, and how many cells and rings there are slack and pulled; NotConverged if a pull has no answer."""
    along, across = ((0.0, 90.0), (0.0, 0.0)) if cell.grain == "y" else ((0.0, 0.0), (0.0, 90.0))
    table = solve_table(cell, (np.array([along[0], across[0]]), np.array([along[1], across[1]])))
    for status in table.status[table.status != "converged"]:
        raise NotConverged(f"pulled along or across the grain: {SENTENCES[str(status)]}")
    slack, limit = lattice_mm(start_pose(cell.weave, 1), cell), cell.weave.jamming_ratio
    pulled = np.stack([table.x2_mm, table.x3_mm], axis=1)
    states = {"slack": np.concatenate(slack), "pulled_along_grain": pulled[0], "pulled_across_grain": pulled[1]}
    weave, inner = cell.weave, 2.0 * (cell.r1 - cell.r2)
    count, mesh = weave.classes / (weave.repeat[0] * weave.repeat[1]), {}
    mean = cell.ring_mass * float(weave.masses.mean())
    for name, axes in states.items():
        area, grain = abs(float(np.linalg.det(axes))), float(axes[1, 1] if cell.grain == "y" else axes[0, 0])
        numbers = {"cells_per_m_along_grain": 1e3 / grain, "cells_per_m_across_grain": 1e3 * grain / area}
        rings = 1e6 * count / area
        mesh[name] = numbers | {"rings_per_m2": rings, "mass_kg_per_m2": rings * mean}
    return {
        "weave": weave.name,
        **ring_sizes(cell.r1, cell.r2),
        "material": cell.material.name,
        "ring_mass_kg": cell.ring_mass,
        "wire_length_mm": ring_volume(cell.r1, cell.r2) / (np.pi * cell.r2**2),
        "rings_per_cell": count,
        "least_r1_over_r2": limit,
        "least_aspect_ratio": limit - 1.0,
        "thickest_wire_at_this_inner_mm": inner / (limit - 1.0),
        "slack_clearance_mm": 2.0 * (cell.r1 / limit - cell.r2),
        "mesh": mesh,
    }
