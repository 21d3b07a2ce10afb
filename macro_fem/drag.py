"""Wind on the present shape: drag of layers on their front, pressure normal to the surface.

A cell of the vector area a = F_1 x F_2 per reference area shows the front v = |a . w| to a wind along w, so that it is
1/v layers there; cells before and behind its middle add theirs. Each of n layers takes 1/n of q C_D per area of the
front, with C_D of n layers (`macro_fem.scene.loads`) and q = rho v^2 / 2.

Wind that follows presses along a: a pressure per present area, a speed by its component along the normal,
q C_D (a . w / |a|)^2, on 1/|a| layers.
"""

from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from macro_fem.fem.assembly import gradient
from macro_fem.fem.cells import cross, recovered
from macro_fem.problem import CurtainProblem
from macro_fem.scene import loads
from macro_fem.scene.obstacles import unit
from macro_fem.scene.tables import Wind
from macro_fem.solution import CurtainSolution
from rve.common import Array

EDGE = 0.3
"""Share of a cell's height on both sides of its edges over which its shade fades in; rounds hardly settle with 0.05."""
LEAST_FRONT = 1e-9
"""Front per reference area below which it is none."""


def wind_density(problem: CurtainProblem, x: Array) -> Array:
    """What winds press the points with (n_points, 3), N/mm2, on a shape with nodes at x (n_nodes, 3); InputError for
    pressure that follows and blows along the flat sheet."""
    F = gradient(problem.disc, x)
    area, seen = np.cross(F[:, :, 0], F[:, :, 1]), vector_areas(problem, F)
    total = np.zeros_like(area)
    for wind in problem.winds:
        if wind.speed is None:
            total += _side(problem, wind) * problem.factor * loads.wind_pressure(wind, None) * area
        else:
            total += np.tile(problem.factor * _drag(problem, wind, x, seen), (problem.disc.n_quad, 1))
    return total


def _drag(problem: CurtainProblem, wind: Wind, x: Array, a: Array) -> Array:
    """What a wind with a speed presses cells of vector areas a (n_cells, 3) with, (n_cells, 3), N/mm2."""
    along = unit(wind.direction)
    v = a @ along
    layers = layers_of(problem, wind, x, a)
    push = loads.dynamic_pressure(wind) * loads.layered_drag(problem.law.cell, layers) / layers
    if not wind.follows:
        return np.asarray(push[:, None] * along)
    size = np.maximum(np.linalg.norm(a, axis=1), LEAST_FRONT)
    return np.asarray((push * size * v * np.abs(v) / size**4)[:, None] * a)


def vector_areas(problem: CurtainProblem, F: Array) -> Array:
    """Vector areas (n_cells, 3) per reference area, of gradients F (n_points, 3, 2), averaged over neighbours, since
    slack cells fold in many ways.
    """
    disc = problem.disc
    return recovered(problem.mesh.mesh.t.T, disc.cell_mean(np.cross(F[:, :, 0], F[:, :, 1])), disc.cell_area)


def layers_of(problem: CurtainProblem, wind: Wind, x: Array, a: Array) -> Array:
    """Layers (n_cells,) on the way of a wind, of cells with vector areas a (n_cells, 3) and nodes at x (n_nodes, 3)."""
    along = unit(wind.direction)
    own = 1.0 / np.maximum(np.linalg.norm(a, axis=1) if wind.follows else np.abs(a @ along), LEAST_FRONT)
    return own + _shade(problem, x, along, own)


def _shade(problem: CurtainProblem, x: Array, along: Array, layers: Array) -> Array:
    """Layers (n_cells,) that cells add before and behind the middle of others that they do not touch."""
    disc, t = problem.disc, problem.mesh.mesh.t.T
    _, _, Vt = np.linalg.svd(along[None])
    corners = x[disc.cell_dofs[:, :3]] @ Vt[1:].T
    middle = corners.mean(axis=1)
    reach = 1.2 * float(np.linalg.norm(corners - middle[:, None], axis=2).max())
    tree = cKDTree(middle)
    near = tree.sparse_distance_matrix(tree, reach, output_type="coo_matrix")
    touch = sparse.csr_matrix((np.ones(t.size), (np.repeat(np.arange(len(t)), 3), t.ravel())))
    is_far = np.asarray((touch[near.row].multiply(touch[near.col])).sum(axis=1)).ravel() == 0.0
    point, cell = near.row[is_far], near.col[is_far]
    share = np.clip((_inside(middle[point], corners[cell]) + EDGE) / (2.0 * EDGE), 0.0, 1.0)
    return np.bincount(point, share * layers[cell], minlength=disc.n_cells).astype(float)


def _inside(p: Array, corners: Array) -> Array:
    """Least barycentric coordinate (n,) of points p (n, 2) in triangles (n, 3, 2); far below 0 in flat ones."""
    a, b, c = (corners[:, i] - p for i in range(3))
    parts = np.stack([cross(b, c), cross(c, a), cross(a, b)], axis=-1)
    total = parts.sum(axis=1, keepdims=True)
    flat = np.abs(total) <= 1e-12 * np.abs(parts).max(axis=1, keepdims=True)
    return np.asarray(np.where(flat, -1.0, parts / np.where(flat, 1.0, total)).min(axis=1))


def _side(problem: CurtainProblem, wind: Wind) -> float:
    """1 for pressure along F_1 x F_2 of the flat sheet, -1 against it; InputError for pressure that blows along it."""
    start = problem.scene.start
    axes = problem.frame.T if start is None else (unit(start.x_axis), unit(start.y_axis))
    along = float(np.cross(*axes) @ unit(wind.direction))
    if abs(along) < 1e-3:
        problem.scene.refuse(
            f"[load.wind] direction = {list(wind.direction)}: lies in the flat sheet, so that it tells no side for "
            "follows = true; lay the sheet across it by [start]"
        )
    return float(np.sign(along))


def wind_summary(solution: CurtainSolution) -> dict[str, list[dict[str, float]]]:
    """Drag of one flat layer in winds with a speed, and front, its mean layers and solidity, and drag of the shape."""
    problem, lines = solution.problem, []
    cell, reference = problem.law.cell, problem.disc.cell_area
    for wind in problem.scene.of(Wind):
        if wind.speed is None:
            continue
        assert cell is not None  # see `macro_fem.scene.loads.nodal_forces`
        a = vector_areas(problem, solution.F)
        layers = layers_of(problem, replace(wind, follows=False), solution.x, a)  # on its way
        front = float(reference @ (1.0 / layers))
        line = {
            "speed_m_per_s": wind.speed,
            "solidity": loads.ring_solidity(cell),
            "drag_coefficient": float(loads.layered_drag(cell, np.ones(1))[0]),
            "pressure_N_per_m2": loads.wind_pressure(wind, cell) / loads.PER_MM2,
            "front_area_m2": front * loads.PER_MM2,
            "layers": float(reference.sum() / front),
            "drag_N": float(reference @ (problem.factor * _drag(problem, wind, solution.x, a)) @ unit(wind.direction)),
        }
        lines.append(line)
    return {"wind": lines} if lines else {}
