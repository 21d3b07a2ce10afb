"""Contradictions in a scene, keys that change nothing, and sizes that are more likely metres than millimetres."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from homogenize import CellInfo
from macro_fem.scene.moving import Thrown
from macro_fem.scene.obstacles import Body, is_flat
from macro_fem.scene.shapes import Disk, MeshFile, Rectangle
from macro_fem.scene.tables import NO_MOVE, LiveLoad, Support, Wind, in_3d
from rve.common.errors import InputError

if TYPE_CHECKING:
    from macro_fem.scene.schema import Scene


def check_scene(scene: Scene) -> None:
    """InputError for records that contradict each other, and for keys that change nothing."""
    source, load = scene.source, scene.load
    _check_motion(scene)
    _check_combinations(scene)
    if not scene.support and scene.motion is None:
        raise InputError(f"{source}: [support]: is missing, so nothing holds the curtain")
    if scene.mesh.pattern != "aligned" and (not isinstance(scene.curtain, Rectangle) or scene.curtain.holes):
        what = f'shape = "{scene.curtain.shape}"' if not isinstance(scene.curtain, Rectangle) else "holes"
        raise InputError(f"{source}: [mesh] pattern = {scene.mesh.pattern!r}: has no effect with {what}")
    for item in scene.support:
        _check_held(item, scene)
    follows = any(wind.follows for wind in scene.of(Wind))
    if scene.start is not None and not follows and all(map(is_flat, scene.obstacle)):
        raise InputError(f"{source}: [start]: has no effect without bodies and following pressure")
    moves = any(any(getattr(item, "move", ())) for item in scene.items)
    if load.steps > 1 and not moves and not any(item.grows for item in scene.of(LiveLoad)):
        raise InputError(f"{source}: [load] steps = {load.steps}: has no effect without live loads and moves")
    check_solver(scene, source)


def _check_motion(scene: Scene) -> None:
    """InputError for histories that do not go on in time, and for keys that need [motion]."""
    for item in scene.items:
        history, release = getattr(item, "history", ()), getattr(item, "release", None)
        if scene.motion is None:
            for key, value in (("history", history), ("release", release)):
                if value:
                    raise InputError(f"{scene.source}: {item.where} {key}: has no effect without [motion] duration")
            if isinstance(item, Thrown):
                raise InputError(f"{scene.source}: {item.where}: moves over time; give [motion] duration, in s")
        for before, after in pairwise(history):
            if after[0] <= before[0]:
                raise InputError(
                    f"{scene.source}: {item.where} history: {after[0]:g} s does not come after {before[0]:g} s"
                )
    if scene.motion is not None and scene.load.steps > 1:
        raise InputError(f"{scene.source}: [load] steps = {scene.load.steps}: has no effect in motion, use history")


def _check_combinations(scene: Scene) -> None:
    """InputError for combinations of one name, of loads that are not there, or of a scene in motion."""
    names = [one.name for one in scene.combination]
    kinds = {"name", "weight"} | {item.kind for item in scene.of(LiveLoad)}
    for number, one in enumerate(scene.combination):
        where = f"{scene.source}: [combination] {one.name}"
        if one.name in names[:number]:
            raise InputError(f"{where}: is the name of two combinations")
        if scene.motion is not None:
            raise InputError(f"{where}: has no effect with [motion]; give the factored loads")
        for item in fields(one):
            if item.name not in kinds and getattr(one, item.name) != 1.0:
                raise InputError(f"{where}: {item.name}: has no effect, as the scene has no [load.{item.name}]")


def _check_held(item: Support, scene: Scene) -> None:
    """InputError for a move along what is not held, and for a component that the scene has not."""
    held, move = getattr(item, "held", "both"), getattr(item, "move", NO_MOVE)
    for axis, way in zip("xyz", in_3d(move), strict=True):
        if way != 0.0 and held != "both" and axis not in held:
            raise InputError(
                f"{scene.source}: {item.where} move = {list(move)}: has no effect along {axis}, as held = {held!r}"
            )
    if held == "z" and not scene.in_space:
        raise InputError(f"{scene.source}: {item.where} held = 'z': holds nothing, as the scene lies in the plane")


def check_solver(scene: Scene, source: str | Path, by: str = "[solver] bounds and adapt:") -> None:
    """InputError if the solver does not go with the mesh or the shape; `by`: the words that asked for bounds."""
    element, shape, solver = scene.mesh.element, scene.curtain, scene.solver
    if element in ("Q1", "Q2") and (not isinstance(shape, Rectangle | MeshFile) or shape.holes):
        raise InputError(f"{source}: [mesh] element = {element!r}: needs a rectangle without holes or a mesh file")
    if not solver.is_bounded:
        return
    where = f"{source}: {by}"
    if solver.kind == "elastic":
        raise InputError(f"{where} need rings that lock, [solver] kind = 'rigid' or 'auto', not 'elastic'")
    if any(wind.follows for wind in scene.of(Wind)):
        raise InputError(f"{where} do not go with following pressure, no dead load")
    bodies = [item.name for item in scene.obstacle if not is_flat(item)]
    if bodies:
        raise InputError(f"{where} do not go with {bodies[0]}: outside a body the problem is not convex")
    if element != "P1":
        raise InputError(f"{where} need element = 'P1', not {element!r}")


def check_sizes(scene: Scene, r1: float | None) -> None:
    """InputError for a curtain or pitch smaller than a ring of radius r1, and for a body thinner than this radius.

    The sentence says the value in mm that was probably meant. Laws without rings, None, have no size.
    """
    if r1 is None:
        return
    for where, value in _lengths(scene):
        if value < 2.0 * r1:
            _refuse(scene, where, value, f"the diameter of a ring, {2.0 * r1:g} mm")
    for body in scene.of(Body):
        if 2.0 * body.breadth < r1:
            _refuse(scene, f"{body.where} width", 2.0 * body.breadth, f"the radius of a ring, {r1:g} mm")


def check_mesh_size(extents: tuple[float, ...], cell: CellInfo | None, where: str) -> None:
    """InputError, which begins with `where`, for a mesh file of these extents, mm, smaller than a ring."""
    if cell is not None and min(extents) < 2.0 * cell.r1_mm:
        raise InputError(
            f"{where} its extents of {' and '.join(f'{one:g}' for one in extents)} mm are less than the diameter of a "
            f"ring, {2.0 * cell.r1_mm:g} mm; were metres meant? Scale the mesh by 1000"
        )


def _lengths(scene: Scene) -> Iterator[tuple[str, float]]:
    """Names and values of lengths of the sheet, mm."""
    curtain = scene.curtain
    if isinstance(curtain, Rectangle):
        yield "[curtain] width", curtain.width
        yield "[curtain] height", curtain.height
    elif isinstance(curtain, Disk):
        yield "[curtain] radius", curtain.radius
    elif not isinstance(curtain, MeshFile):
        width, height = np.ptp(curtain.corners(1), axis=0).tolist()
        yield "[curtain] outline: its width", width
        yield "[curtain] outline: its height", height
    for item in scene.support:
        pitch = getattr(item, "pitch", None)
        if pitch is not None:
            yield f"{item.where} pitch", pitch


def _refuse(scene: Scene, where: str, value: float, what: str) -> None:
    raise InputError(
        f"{scene.source}: {where} = {value:g}: is less than {what}; lengths are in mm, did you mean {1e3 * value:g}?"
    )
