"""A solved curtain as `rve.localize` takes it, without files: what curtain.vtu holds, by name and shape."""

from __future__ import annotations

from macro_fem.output.files import corner_positions
from macro_fem.scene.meshing.places import counterclockwise
from macro_fem.solution import CurtainSolution
from rve import Curtain


def to_curtain(solution: CurtainSolution) -> Curtain:
    """Corners of the mesh before and after deformation, strain, line load and state of every cell."""
    mesh, disc = solution.problem.mesh.mesh, solution.problem.disc
    return Curtain.of(
        mesh.p.T,
        corner_positions(solution),
        counterclockwise(mesh.p.T, mesh.t.T),
        E=disc.cell_mean(solution.E),
        S=disc.cell_mean(solution.S),
        line_load=solution.principal()[0][:, 0],
        state=solution.state(),
    )
