"""Loads of a scene as nodal forces, consistent with the element's shape functions."""

from __future__ import annotations

import numpy as np
import skfem

from homogenize import CellInfo
from macro_fem.fem.assembly import load_vector
from macro_fem.fem.cells import cross
from macro_fem.fem.discretization import ELEMENTS, Discretization
from macro_fem.scene.meshing.mesh import CurtainMesh
from macro_fem.scene.obstacles import unit
from macro_fem.scene.schema import Scene
from macro_fem.scene.sites import point_node
from macro_fem.scene.tables import Bar, EdgeLoad, PatchLoad, PointLoad, Wind
from macro_fem.scene.wind import wind_pressure
from rve.common import Array, InputError

PER_MM2 = 1e-6
"""m2 per mm2: kg/m2 times m/s2 is N/m2."""


def areal_mass(scene: Scene, cell: CellInfo | None) -> tuple[float, str]:
    """Areal mass in kg/m2 and where it comes from: "scene" (`areal_mass`), else "law"; InputError if neither knows."""
    if scene.curtain.areal_mass is not None:
        return scene.curtain.areal_mass, "scene"
    if cell is None:
        raise InputError(f"{scene.source}: [curtain] areal_mass: is missing, and the law has no rings to tell it")
    return cell.areal_mass_kg_per_m2, "law"


def weight_per_area(scene: Scene, cell: CellInfo | None) -> Array:
    """Weight of the curtain (d,) in N/mm2; InputError if its areal mass is not known."""
    return areal_mass(scene, cell)[0] * scene.vector(scene.load.acceleration) * PER_MM2


def wind_per_area(wind: Wind, scene: Scene, cell: CellInfo | None) -> Array:
    """The force of a wind on the flat sheet square to it (d,), N/mm2; 0 of a speed in the plane: no front."""
    if scene.d == 2 and wind.speed is not None:
        return np.zeros(2)
    return np.asarray(wind_pressure(wind, cell) * unit(wind.direction)[: scene.d])


def nodal_forces(
    scene: Scene, mesh: CurtainMesh, disc: Discretization, cell: CellInfo | None, factor: float = 1.0
) -> Array:
    """All loads (n_nodes, d) in N; live ones (edges, points, patches, wind) are scaled by `factor`, weights are not.

    Wind with a speed is as on the flat sheet square to it, and wind that follows is none of them: see `macro_fem.drag`.
    """
    dead = load_vector(disc, weight_per_area(scene, cell))
    for bar in scene.of(Bar):
        shares = edge_shares(mesh, disc, bar.edge, f"{scene.source}: [load.bar] edge")
        dead += shares[:, None] / shares.sum() * bar.mass * scene.vector(scene.load.acceleration)
    live = np.zeros_like(dead)
    for edge in scene.of(EdgeLoad):
        shares = edge_shares(mesh, disc, edge.edge, f"{scene.source}: [load.edge] edge")
        live += shares[:, None] * scene.vector(edge.force)
    for point in scene.of(PointLoad):
        live[point_node(point.at, disc)] += scene.vector(point.force)
    for patch in scene.of(PatchLoad):
        live += patch_load(patch, scene, mesh, disc)
    for wind in scene.of(Wind):
        if wind.speed is not None and cell is None:
            what = f"speed = {wind.speed:g}: the law has no rings to tell the drag; give the pressure"
            raise InputError(f"{scene.source}: [load.wind] {what}")
        live += 0.0 if wind.follows else load_vector(disc, wind_per_area(wind, scene, cell))
    return dead + factor * live


def edge_shares(mesh: CurtainMesh, disc: Discretization, name: str, where: str) -> Array:
    """Integral of every shape function over a named edge (n_nodes,), mm."""
    facets = mesh.edge(name, where)
    basis = skfem.FacetBasis(mesh.mesh, ELEMENTS[disc.element][0](), facets=facets, intorder=2)
    return skfem.LinearForm(lambda v, w: v).assemble(basis)


def patch_load(load: PatchLoad, scene: Scene, mesh: CurtainMesh, disc: Discretization) -> Array:
    """A force spread over a disk, even within each cell; InputError if the disk holds no part of the curtain."""
    shares = disk_areas(mesh.mesh.p.T[mesh.mesh.t.T], np.array(load.at), load.radius)
    if shares.sum() <= 0.0:
        raise InputError(
            f"{scene.source}: [load.patch] at = {list(load.at)}, radius = {load.radius:g}: holds no cell of the curtain"
        )
    even = np.tile(shares / disc.cell_area, disc.n_quad)
    return load_vector(disc, even[:, None] * scene.vector(load.force) / shares.sum())


def disk_areas(corners: Array, centre: Array, radius: float) -> Array:
    """The area (n,) that each of the polygons with these corners (n, k, 2) shares with a disk: triangles, sectors.

    >>> square = np.array([[[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 9.0]]])
    >>> bool(np.allclose(disk_areas(square, np.zeros(2), 2.0), np.pi))
    True
    """
    a = corners - centre
    b = np.roll(a, -1, axis=1)
    along = b - a
    length2 = np.maximum((along * along).sum(axis=-1), 1e-300)
    middle = -(a * along).sum(axis=-1) / length2
    reach2 = middle**2 - ((a * a).sum(axis=-1) - radius**2) / length2
    reach = np.sqrt(np.maximum(reach2, 0.0))
    enters, leaves = (a + np.clip(middle + sign * reach, 0.0, 1.0)[..., None] * along for sign in (-1.0, 1.0))

    def angle(u: Array, v: Array) -> Array:
        return np.arctan2(cross(u, v), (u * v).sum(axis=-1))

    parts = cross(enters, leaves) + radius**2 * (angle(a, enters) + angle(leaves, b))
    shares = 0.5 * np.abs(parts.sum(axis=1))
    return np.asarray(np.where(shares > 1e-12 * radius**2, shares, 0.0))
