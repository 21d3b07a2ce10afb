"""The upper bound: a quadratic curtain that obeys the law everywhere.

In a triangle with straight sides F of a P2 curtain is linear, and |F L| is convex, so that its largest value is at a
corner. With the half-spaces at the three corners of every triangle, not at quadrature points, a P2 curtain is
admissible everywhere and its potential an upper bound. Loads are integrated as for any P2 curtain.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import skfem

from homogenize import MembraneLaw
from macro_fem.fem.discretization import Discretization, reference_shapes
from macro_fem.problem import CurtainProblem, make_problem
from macro_fem.scene.meshing.mesh import CurtainMesh
from macro_fem.scene.schema import Scene
from rve.common.errors import InputError

CORNERS = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
"""Corners (2, 3) of the reference triangle, in the order of the corners of cells."""


def admissible_problem(scene: Scene, law: MembraneLaw, mesh: CurtainMesh, factor: float = 1.0) -> CurtainProblem:
    """The P2 problem of a scene with the law at the corners of the triangles; InputError for quadrilaterals.

    With walls the P1 problem: a P1 curtain is inside a plane where its nodes are, a P2 curtain need not be.
    """
    if not isinstance(mesh.mesh, skfem.MeshTri1):
        raise InputError("bounds need a mesh of triangles, this one has quadrilaterals")
    quadratic = replace(scene, mesh=replace(scene.mesh, element="P2"))
    problem = make_problem(quadratic, law, mesh, factor)
    if problem.walls is not None:
        return make_problem(replace(scene, mesh=replace(scene.mesh, element="P1")), law, mesh, factor)
    disc = at_corners(problem.disc)
    return replace(problem, disc=disc, fem=problem.supports.fem(disc))


def at_corners(disc: Discretization) -> Discretization:
    """P2 with its points at the corners of the triangles, a third of the area each: exact for linear functions.

    Not for loads, whose shape functions are quadratic.
    """
    values, gradients = reference_shapes(skfem.ElementTriP2(), CORNERS, 6)
    weight = np.tile(disc.cell_area / 3.0, 3)
    return replace(disc, shape_values=values, shape_gradients=gradients, weight=weight)
