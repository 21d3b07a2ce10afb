"""Masses of a discrete curtain, lumped at its nodes."""

from __future__ import annotations

import numpy as np

from macro_fem.fem.assembly import load_vector
from macro_fem.problem import CurtainProblem
from macro_fem.scene.loads import PER_MM2, areal_mass, edge_shares
from macro_fem.scene.tables import Bar
from rve.common import Array, InputError

TONNE = 1e-3
"""N s2/mm per kg: with lengths in mm and forces in N."""


def nodal_masses(problem: CurtainProblem) -> Array:
    """Masses (n_nodes,) of the mesh and of the bars in its edges, N s2/mm; InputError for P2."""
    scene, disc, mesh, mass = problem.scene, problem.disc, problem.mesh, mesh_masses(problem)
    for bar in scene.of(Bar):
        shares = edge_shares(mesh, disc, bar.edge, f"{scene.source}: [load.bar] edge")
        mass = mass + TONNE * bar.mass * shares / shares.sum()
    return np.asarray(mass)


def mesh_masses(problem: CurtainProblem) -> Array:
    """Masses (n_nodes,) of the mesh alone, N s2/mm; InputError as for `nodal_masses`."""
    scene, disc = problem.scene, problem.disc
    if disc.element != "P1":
        raise InputError(f"{scene.source}: [mesh] element = {disc.element!r}: motion needs P1")
    per_area = areal_mass(scene, problem.law.cell)[0] * PER_MM2 * TONNE
    return np.asarray(per_area * load_vector(disc, np.array([1.0]))[:, 0])
