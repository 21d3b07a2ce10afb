"""A scene: curtain, what holds, loads and meets it, mesh and solver."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import numpy as np

from macro_fem.scene.moving import Ball, Motion
from macro_fem.scene.obstacles import Obstacle, Start
from macro_fem.scene.shapes import Mesh, MeshFile, Shape
from macro_fem.scene.support_kinds import Support
from macro_fem.scene.tables import Combination, Item, Loading, Project, Solver, Vector, in_3d, leaves_plane
from rve.common import Array, InputError, check_fields, shown
from rve.common.materials import described

Kind = TypeVar("Kind")


@dataclass(frozen=True)
class Scene:
    """The sheet, and the `items` that hold, load and meet it, in any order.

    `material`: of the rings, in place of the law's (`homogenize.with_material`). `source` names the scene's file, in
    whose folder relative mesh files are. `notes`: what was mended in the `drawing` that the sheet is read from.
    `weight`: factor on the weight of the mesh, of a combination of loads. `project`: what heads reports.

    >>> from macro_fem import Bar, Hooks, Rectangle
    >>> Scene(Rectangle(3000, 2500), [Hooks(pitch=200), Bar(mass=12)]).support[0].pitch
    200.0
    """

    curtain: Shape
    items: tuple[Item, ...] = ()
    mesh: Mesh = field(default_factory=Mesh)
    load: Loading = field(default_factory=Loading)
    solver: Solver = field(default_factory=Solver)
    start: Start | None = None
    motion: Motion | None = None
    material: tuple[tuple[str, Any], ...] = ()
    combination: tuple[Combination, ...] = ()
    project: Project = field(default_factory=Project, repr=False)
    source: Path = Path("scene")
    drawing: str | None = None
    notes: tuple[str, ...] = ()
    weight: float = 1.0

    def __post_init__(self) -> None:
        """Check the material; InputError for items that are none, and for fields of other classes."""
        if not isinstance(self.items, Iterable):
            self.refuse(f"items = {shown(self.items)}: is no list of supports, loads and obstacles")
        object.__setattr__(self, "items", _numbered(tuple(self.items)))
        for item in self.items:
            if not isinstance(item, Item):
                self.refuse(
                    f"{shown(item)}: is no support, load or obstacle; "
                    "mesh, load, solver, start, motion, project and combination are given by name"
                )
        if not isinstance(self.material, Mapping | tuple):
            self.refuse(f"material = {shown(self.material)}: is no dict; give {{'material': NAME}}")
        object.__setattr__(self, "material", described(dict(self.material), f"{self.source}: [material]"))
        check_fields(self)

    def refuse(self, what: str) -> NoReturn:
        """InputError that names the file of the scene."""
        raise InputError(f"{self.source}: {what}")

    @contextmanager
    def in_errors(self, where: str = "") -> Iterator[None]:
        """A block whose InputErrors name the file of the scene, and where in it."""
        try:
            yield
        except InputError as error:
            raise InputError(f"{self.source}: {where}{error}") from error

    def of(self, kind: type[Kind]) -> tuple[Kind, ...]:
        """The items of a kind: `scene.of(Bar)`."""
        return tuple(item for item in self.items if isinstance(item, kind))

    @property
    def support(self) -> tuple[Support, ...]:
        """What holds the curtain."""
        return self.of(Support)

    @property
    def obstacle(self) -> tuple[Obstacle, ...]:
        """What the curtain stays outside of."""
        return self.of(Obstacle)

    @property
    def in_space(self) -> bool:
        """Whether the curtain needs a third coordinate."""
        return bool(self.space_reason)

    @property
    def space_reason(self) -> str:
        """Why the curtain needs a third coordinate; "" in the plane."""
        if isinstance(self.load.gravity, tuple) and leaves_plane(self.load.gravity):
            return f"[load] gravity = {list(self.load.gravity)} leaves the plane"
        for item in self.items:
            if item.space_reason:
                return f"[{item.table}] {item.space_reason}"
        if self.start is not None:
            return "[start] lays the sheet in space"
        return "[solver] space = true asks for it" if self.solver.space else ""

    @property
    def sheet_file(self) -> Path | None:
        """The file of the mesh or of its outline, if it is from one."""
        name = self.curtain.file if isinstance(self.curtain, MeshFile) else self.drawing
        return None if name is None else self.source.parent / name

    @property
    def d(self) -> int:
        """Coordinates of a place: 2 in the plane, 3 in space."""
        return 3 if self.in_space else 2

    def vector(self, v: Vector) -> Array:
        """A vector of two or three components as an array (d,)."""
        return np.array(in_3d(v)[: self.d])


def _numbered(items: tuple[Any, ...]) -> tuple[Any, ...]:
    """The items with numbers in the names of bodies and obstacles that have the name of their kind beside others."""
    unnamed = [isinstance(item, Ball | Obstacle) and item.name == type(item).name for item in items]
    names = [item.name if is_unnamed else "" for item, is_unnamed in zip(items, unnamed, strict=True)]
    numbers = (names[: k + 1].count(name) if name and names.count(name) > 1 else 0 for k, name in enumerate(names))
    return tuple(
        replace(item, name=f"{item.name} {number}") if number else item
        for item, number in zip(items, numbers, strict=True)
    )
