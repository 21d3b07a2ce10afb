"""Loads of a scene as nodal forces, consistent with the element's shape functions."""

from __future__ import annotations

import numpy as np
import skfem

from homogenize.law import Array, CellInfo, InputError
from macro_fem.assembly import Discretization, load_vector
from macro_fem.mesh import CurtainMesh
from macro_fem.scene import Bar, EdgeLoad, PatchLoad, PointLoad, Scene
from macro_fem.supports import point_node

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
        live += point_load(point, scene, disc)
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
    facets = mesh.edge(name, where)
    basis = skfem.FacetBasis(mesh.mesh, FACET_ELEMENTS[disc.element](), facets=facets, intorder=2)
    return skfem.LinearForm(lambda v, w: v).assemble(basis)


def point_load(load: PointLoad, scene: Scene, disc: Discretization) -> Array:
    """A force on the node at a point; InputError if there is none."""
    force = np.zeros((disc.n_nodes, 2))
    force[point_node(load.at, disc, f"{scene.source}: [load.point]")] = load.force
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
