"""Loads of a scene as nodal forces, consistent with the element's shape functions."""

from __future__ import annotations

import numpy as np
import skfem
from scipy.spatial import cKDTree

from homogenize.law import Array, CellInfo, InputError
from macro_fem.assembly import Discretization, load_vector
from macro_fem.mesh import CurtainMesh
from macro_fem.scene import Bar, EdgeLoad, PatchLoad, PointLoad, Scene

PER_MM2 = 1e-6
"""m2 per mm2: kg/m2 times m/s2 is N/m2."""

FACET_ELEMENTS = {
    "P1": skfem.ElementTriP1,
    "P2": skfem.ElementTriP2,
    "CR": skfem.ElementTriCR,
    "Q1": skfem.ElementQuad1,
    "Q2": skfem.ElementQuad2,
}


def areal_mass(scene: Scene, cell: CellInfo | None) -> tuple[float, str]:
    """Areal mass in kg/m2 and where it comes from: "scene" (`areal_mass`), else "law"; InputError if neither knows."""
    if scene.curtain.areal_mass is not None:
        return scene.curtain.areal_mass, "scene"
    if cell is None:
        raise InputError(f"{scene.source}: [curtain] areal_mass: is missing, and the law has no rings to tell it")
    return cell.areal_mass_kg_per_m2, "law"


def weight_per_area(scene: Scene, cell: CellInfo | None) -> float:
    """Weight of the curtain in N/mm2; InputError if its areal mass is not known."""
    return areal_mass(scene, cell)[0] * scene.load.gravity * PER_MM2


def nodal_forces(
    scene: Scene, mesh: CurtainMesh, disc: Discretization, cell: CellInfo | None, factor: float = 1.0
) -> Array:
    """All loads (n_nodes, 2) in N; live loads (edges, points, patches) are scaled by `factor`, weights are not."""
    dead = load_vector(disc, np.array([0.0, -weight_per_area(scene, cell)]))
    for bar in scene.load.bar:
        dead += bar_weight(bar, scene, mesh, disc)
    live = np.zeros_like(dead)
    for edge in scene.load.edge:
        live += edge_load(edge, scene, mesh, disc)
    for point in scene.load.point:
        live += point_load(point, scene, mesh, disc)
    for patch in scene.load.patch:
        live += patch_load(patch, scene, disc)
    return dead + factor * live


def edge_load(load: EdgeLoad, scene: Scene, mesh: CurtainMesh, disc: Discretization) -> Array:
    """A force per reference length along a named edge."""
    where = f"{scene.source}: [load.edge] edge"
    return edge_shares(mesh, disc, load.edge, where)[:, None] * np.array(load.force)


def bar_weight(bar: Bar, scene: Scene, mesh: CurtainMesh, disc: Discretization) -> Array:
    """The weight of a bar, spread evenly over its edge."""
    shares = edge_shares(mesh, disc, bar.edge, f"{scene.source}: [load.bar] edge")
    return shares[:, None] / shares.sum() * np.array([0.0, -bar.mass * scene.load.gravity])


def edge_shares(mesh: CurtainMesh, disc: Discretization, name: str, where: str) -> Array:
    """Integral of every shape function over a named edge (n_nodes,), mm."""
    if name not in mesh.edges:
        raise InputError(f"{where} = {name!r}: the curtain has no such edge, only {', '.join(sorted(mesh.edges))}")
    basis = skfem.FacetBasis(mesh.mesh, FACET_ELEMENTS[disc.element](), facets=mesh.edges[name], intorder=2)
    return skfem.LinearForm(lambda v, w: v).assemble(basis)


def point_load(load: PointLoad, scene: Scene, mesh: CurtainMesh, disc: Discretization) -> Array:
    """A force on the node nearest to a point; InputError if the point is off the curtain."""
    distance, node = cKDTree(disc.nodes).query(np.array(load.at))
    longest = float(np.linalg.norm(np.diff(mesh.mesh.p[:, mesh.mesh.facets], axis=1), axis=0).max())
    if distance > longest:
        raise InputError(f"{scene.source}: [load.point] at = {list(load.at)}: is {distance:g} mm away from the curtain")
    force = np.zeros((disc.n_nodes, 2))
    force[node] = load.force
    return force


def patch_load(load: PatchLoad, scene: Scene, disc: Discretization) -> Array:
    """A force spread over the points within a disk; InputError if the disk holds none of them."""
    inside = np.linalg.norm(disc.points - np.array(load.at), axis=1) <= load.radius
    area = float(disc.weight[inside].sum())
    if area == 0.0:
        raise InputError(
            f"{scene.source}: [load.patch] at = {list(load.at)}, radius = {load.radius:g}: holds no cell of the curtain"
        )
    return load_vector(disc, inside[:, None] * np.array(load.force) / area)
