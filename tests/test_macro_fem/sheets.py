"""Sheets on rectangles, and the problems of scenes."""

import numpy as np
import skfem

from homogenize import default_law, with_material
from macro_fem import read_scene
from macro_fem.curtain import make_problem, solve_problem
from macro_fem.fem import SupportedFem
from macro_fem.scene import build_mesh, drag_coefficient, ring_solidity


def fallen(t, damping=0.0, drag=0.0, g=9810.0):
    """Way in mm of a free fall at t with a damping in 1/s or a quadratic drag in 1/mm, and the work of the damping in
    N mm per N s2/mm."""
    if drag:
        return np.log(np.cosh(np.sqrt(g * drag) * t)) / drag, 0.0
    c, once, twice = damping, np.exp(-damping * t), np.exp(-2.0 * damping * t)
    return g / c * (t - (1.0 - once) / c), g**2 / c * (t - 2.0 * (1.0 - once) / c + 0.5 * (1.0 - twice) / c)


def still_air():
    """The quadratic drag of a flat sheet of the default law in still air, 1/mm."""
    cell = default_law().cell
    return 0.5e-3 * 1.25 * float(drag_coefficient(ring_solidity(cell))) / cell.areal_mass_kg_per_m2


def sheet(width, height, cells, support, mesh=(), load=(), solver=(), **curtain):
    """Tables of a scene on a rectangle; `curtain` and `mesh`: further keys of theirs."""
    first = {"curtain": {"width": width, "height": height, **curtain}, "mesh": {"cells": cells, **dict(mesh)}}
    return first | {"support": support, "load": dict(load), "solver": dict(solver)}


def solve_scene(scene, law):
    """The curtain of a scene at its full load, in one step and without bounds."""
    law = with_material(law, dict(scene.material), scene.source)
    return solve_problem(make_problem(scene, law, build_mesh(scene, law.cell)))


def mesh_of(width, height, nx, ny):
    """A mesh of nx by ny rectangles, each cut in two."""
    return skfem.MeshTri.init_tensor(np.linspace(0, width, nx + 1), np.linspace(0, height, ny + 1))


def least_angle(p, t):
    """The smallest angle in degrees of triangles t (n, 3) of points p: the quality of a mesh."""
    edge = np.roll(p[t], -1, axis=1) - p[t]
    back = -np.roll(edge, 1, axis=1)
    cosine = (edge * back).sum(-1) / (np.linalg.norm(edge, axis=-1) * np.linalg.norm(back, axis=-1))
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)).min())


def supported(disc, fixed, displacement):
    """The discretisation with the components `fixed` held at a displacement, both (n_nodes, d)."""
    X = np.column_stack([disc.nodes, np.zeros((disc.n_nodes, fixed.shape[1] - 2))])
    return SupportedFem(disc, np.where(fixed, X + displacement, 0.0), ~fixed.ravel())


def posed(scene, law=None, factor=1.0):
    """The problem of a scene, or of its tables, with a law, the shipped one of rings unless another is given."""
    scene, law = read_scene(scene) if isinstance(scene, dict) else scene, law or default_law()
    return make_problem(scene, law, build_mesh(scene, law.cell), factor)
