"""Sizes that rings cannot resolve: more likely metres than millimetres."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from homogenize import CellInfo
from macro_fem.scene.obstacles import Body, breadth
from macro_fem.scene.schema import Scene
from macro_fem.scene.shapes import Disk, MeshFile, Rectangle
from rve.common.errors import InputError


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
        if 2.0 * breadth(body) < r1:
            _refuse(scene, f"{body.where} width", 2.0 * breadth(body), f"the radius of a ring, {r1:g} mm")


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
