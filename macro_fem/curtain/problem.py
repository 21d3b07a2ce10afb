"""A scene made discrete: mesh, supports, loads, law and obstacles of one load step."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from homogenize import MembraneLaw
from macro_fem.fem.assembly import load_vector
from macro_fem.fem.discretization import Discretization, discretize
from macro_fem.fem.hung_law import HungLaw
from macro_fem.fem.supported import SupportedFem
from macro_fem.scene.loads import nodal_forces, wind_per_area
from macro_fem.scene.meshing.mesh import CurtainMesh
from macro_fem.scene.obstacles import Body, Box, PlacedObstacle
from macro_fem.scene.scene import Scene
from macro_fem.scene.support_kinds import Track
from macro_fem.scene.supports import Supports, build_supports, pin_sliding, told
from macro_fem.scene.tables import Bar, PointLoad, Wind
from macro_fem.solvers.cones import Cones
from macro_fem.solvers.walls import TOUCHED, Walls
from rve.common import Array, digits

THINNEST = 0.2
"""Half the least width of a body over the longest side of a cell; thinner ones pass between the points of a mesh."""

STRAIGHT = 0.01
"""A track is bent that needs a strip wider than this part of the size of the sheet to lie in."""
BENT_TRACK = (
    "the straight bar keeps the edge {} on a line, and the track above it bends within a strip {} mm wide: "
    "straight = false under [load.bar] is for a bar bent like the track, or a chain"
)


STRETCHED = "the track is longer than the top edge of the flat sheet, fullness {}: rings along it are drawn apart"


@dataclass(frozen=True, eq=False)
class CurtainProblem:
    """A scene made discrete at one load step: everything a solver needs."""

    scene: Scene
    mesh: CurtainMesh
    disc: Discretization
    law: HungLaw
    supports: Supports
    fem: SupportedFem
    dead: Array  # (n_nodes, d), N: all loads but those of `winds`
    walls: Walls  # half-spaces that nodes stay inside of: floors, walls, tangent planes of bodies
    factor: float = 1.0  # share of live loads and moves
    cones: Cones | None = None  # half-spaces to begin with, instead of the law's own few
    bodies: tuple[PlacedObstacle, ...] = ()  # obstacles that are no half-spaces
    winds: tuple[Wind, ...] = ()  # those whose force depends on the present shape
    wind: Array | None = None  # (points of `exact`, d), N/mm2: what these press with

    @cached_property
    def force(self) -> Array:
        """All loads (n_nodes, d), N."""
        return self.dead if self.wind is None else self.dead + load_vector(self.exact, self.wind)

    @cached_property
    def frame(self) -> Array:
        """Where the reference axes point (d, 2) in a curtain that hangs flat, about: two orthogonal unit vectors.

        In space these follow the supports and the resultant load, so that they turn with the scene.
        """
        if self.fem.d == 2:
            return np.eye(2)
        X, mask = self.disc.nodes, self.supports.mask
        here = mask.any(axis=1) if mask.any() else np.ones(len(mask), bool)
        total = float(np.linalg.norm(self.force, axis=1).sum())
        load = self.force.T @ (X - X[here].mean(axis=0))
        way = supported_map(self)[1] + load / (total * self.mesh.size or 1.0)
        U, size, Vt = np.linalg.svd(way, full_matrices=False)
        if size[1] < 1e-6 * size[0]:
            U, _, Vt = np.linalg.svd(way + 1e-3 * max(size[0], 1.0) * np.eye(3, 2), full_matrices=False)
        return np.asarray(U @ Vt)

    @cached_property
    def exact(self) -> Discretization:
        """Points at which loads are integrated; those of an admissible problem are at corners, which is not exact."""
        return discretize(self.mesh.mesh, "P2") if self.disc.element == "P2" else self.disc

    @property
    def notes(self) -> list[str]:
        """What was mended in the mesh, tracks longer than their edge, and straight bars below tracks that are not."""
        tracks = [one.track - one.track.mean(axis=0) for one in self.supports.held if one.track is not None]
        bulge = max((float(np.ptp(one @ np.linalg.svd(one)[2][1])) for one in tracks), default=0.0)
        edges = [bar.edge for bar in self.scene.of(Bar) if bar.straight and bulge > STRAIGHT * self.mesh.size]
        along = [(one.drawn, *one.along(self.mesh.border)) for one in self.scene.support if isinstance(one, Track)]
        full = [edge.arc[-1] / (share * curve.length) for share, edge, curve in along]
        drawn = [STRETCHED.format(digits(one)) for one in full if one < 0.999]
        return [*self.mesh.notes, *drawn, *(BENT_TRACK.format(edge, digits(bulge)) for edge in edges)]

    @cached_property
    def elastic_law(self) -> HungLaw:
        """The law of an elastic curtain, whose rings give by direction where the law knows it."""
        return self.law.elastic()

    @property
    def disk_of_cell(self) -> float:
        """Radius of a disk of the area of one cell of the weave, mm; 0 without rings."""
        cell = self.law.cell
        return 0.0 if cell is None else float(np.sqrt(cell.b_x_mm * cell.b_y_mm / np.pi))

    @property
    def points(self) -> Array:
        """Where points are held or loaded one by one, (n, 2) in mm of the reference."""
        held = [self.disc.nodes[one.nodes] for one in self.supports.held if not len(one.facets)]
        return np.vstack([*held, *(np.array([one.at]) for one in self.scene.of(PointLoad)), np.zeros((0, 2))])

    @cached_property
    def plastic_law(self) -> HungLaw:
        """The law of a curtain whose rings flow."""
        return self.law.plastic(strings=self.scene.solver.strings)

    @property
    def last_law(self) -> HungLaw:
        """The law beyond which the curtain does not stretch: that of strings where rings flow until they are some,
        before these stretch."""
        return self.plastic_law.drawn() if self.scene.solver.strings else self.law


def make_problem(
    scene: Scene, law: MembraneLaw, mesh: CurtainMesh, factor: float = 1.0, released: frozenset[int] | None = None
) -> CurtainProblem:
    """The discrete problem of a scene on a mesh, live loads and moves scaled by `factor`; InputError as found.

    released: numbers of supports that have let go, in a curtain in motion, which needs no pins; None for one at rest.
    """
    disc = discretize(mesh.mesh, scene.mesh.element)
    if scene.solver.is_elastic and not law.compliance.any():
        scene.refuse(f"[solver] kind = 'elastic': a law of kind {law.name} is inextensible, use kind = 'rigid'")
    force = nodal_forces(scene, mesh, disc, law.cell, factor)
    supports = build_supports(scene, mesh, disc, factor, released or frozenset())
    if released is None:
        supports = pin_sliding(supports, disc, force, scene)
    hung = HungLaw.at(law, scene.curtain.weave_angle)
    fem = supports.fem(disc)
    problem = CurtainProblem(scene, mesh, disc, hung, supports, fem, force, Walls.none(fem.x_held.shape), factor)
    winds = tuple(wind for wind in scene.of(Wind) if wind.is_shaped and fem.d == 3)
    if winds:
        flat = sum((wind_per_area(wind, scene, law.cell) for wind in winds if not wind.follows), np.zeros(3))
        wind = np.tile(factor * flat, (problem.exact.n_points, 1))
        problem = replace(problem, dead=force - load_vector(problem.exact, wind), winds=winds, wind=wind)
    return _with_obstacles(problem) if scene.obstacle else problem


def _with_obstacles(problem: CurtainProblem) -> CurtainProblem:
    """The problem with floors, walls and bodies; InputError for a support inside an obstacle."""
    scene, fem = problem.scene, problem.fem
    obstacles = placed_obstacles(problem)
    side = problem.mesh.longest_side
    for one in obstacles:
        check_breadth(scene, f"[obstacle] {one.obstacle.name}", one.obstacle.breadth, side)
        _check_outside(one, problem)
    bodies = tuple(one for one in obstacles if isinstance(one.obstacle, Body))
    flat = [tangent_walls(one, fem, fem.reference) for one in obstacles if not isinstance(one.obstacle, Body)]
    return replace(problem, walls=Walls.joined([problem.walls, *flat]), bodies=bodies)


def check_breadth(scene: Scene, name: str, half: float, side: float) -> None:
    """InputError for a body, by half its least width, that would pass between the points of cells with such sides."""
    if half < THINNEST * side:
        metres = f"; lengths are in mm, were {half:g} m meant?" if 1e3 * half >= THINNEST * side else ""
        scene.refuse(
            f"{name}: half its least width, {digits(half, 4)} mm, is less than a fifth of the sides of cells, up to "
            f"{digits(side, 4)} mm, between which it would pass: use more cells{metres}"
        )


def placed_obstacles(problem: CurtainProblem) -> list[PlacedObstacle]:
    """The obstacles of the scene of a problem, as its mesh meets them: the edges of boxes are round."""
    cell, placed = float(np.sqrt(2.0 * problem.disc.cell_area.mean())), []
    for number, item in enumerate(problem.scene.obstacle):
        if isinstance(item, Box) and item.rounding is None:
            item = replace(item, rounding=min(cell, item.breadth))
        placed.append(PlacedObstacle(number, item, problem.factor, problem.fem.d))
    return placed


def _check_outside(one: PlacedObstacle, problem: CurtainProblem) -> None:
    """InputError for a support inside an obstacle that no way in which it may slide leads out of."""
    scene, supports, disc = problem.scene, problem.supports, problem.disc
    walls = touching_walls(one, disc.at_nodes, supports.positions)
    deep = np.where(walls.is_movable(problem.fem), 0.0, -walls.gap(supports.positions))
    if deep.max(initial=0.0) <= TOUCHED * problem.mesh.size:
        return
    node = int(deep.argmax())
    name = next(held.name for held in supports.held if node in held.nodes)
    at = f" after {problem.factor:.3g} of the prescribed moves" if scene.load.steps > 1 else ""
    pins, normal = supports.pins, walls.normal[node]
    ways = [told(way) for way in pins.direction[pins.nodes == node] if abs(way @ normal) > 1e-9]
    slides = f", and nothing but that holds it along {ways[0]}: hold it there, outside" if ways else ""
    scene.refuse(f"[obstacle] {one.obstacle.name}: {name} is {digits(deep[node], 4)} mm inside it{at}{slides}")


def kept_outside(body: PlacedObstacle, fem: SupportedFem) -> csr_matrix:
    """The points that stay outside of an obstacle and can move. Those of a half-space have a hull that holds the mesh;
    of a body they are the nodes, with middles of sides and cells where it clears cells.
    """
    at, item = fem.disc.hull, body.obstacle
    if isinstance(item, Body):
        at = fem.disc.meeting if item.clear == "cells" else fem.disc.at_nodes
    return at[np.flatnonzero(abs(at) @ ~np.all(fem.held, axis=1))]


def tangent_walls(body: PlacedObstacle, fem: SupportedFem, x: Array) -> Walls:
    """The half-spaces that touch an obstacle where it is closest to `kept_outside`, for nodes at x."""
    at = kept_outside(body, fem)
    return touching_walls(body, at, at @ x)


def touching_walls(body: PlacedObstacle, at: csr_matrix, places: Array, radius: Array | float = 0.0) -> Walls:
    """The half-spaces of points at places (m, d) that touch a body where it is closest to each, a radius (m,) off."""
    normal = body.normal(places)
    return Walls(at, normal, body.offset(normal) + radius, np.full(len(places), body.number))


def stabilising_tension(problem: CurtainProblem) -> float:
    """The even tension in N/mm that opens out slack parts; see `scene.Solver`."""
    return problem.scene.solver.stabilising_tension * float(np.abs(problem.force).sum()) / problem.mesh.size


def strength_at_points(problem: CurtainProblem, disc: Discretization) -> Array:
    """By how many times rings at the points of a discretisation are stronger than those of the law (n_points,).

    A hook or a point load holds a ring, whose own strength is judged apart; no membrane within bounds bears a force at
    a point. So triangles whose middle is within the disk of one cell of the weave around it do not flow, nor do
    their strings stretch.
    """
    at, distance = problem.points, np.full(disc.n_cells, np.inf)
    if len(at):
        distance = cKDTree(at).query(disc.cell_mean(disc.points))[0]
    # How much stronger the mesh is around held and loaded points. Ten times more changes limits by less than 1e-3.
    return np.tile(np.where(distance < problem.disk_of_cell, 1e3, 1.0), disc.n_quad)


def gathered_start(problem: CurtainProblem) -> Array:
    """Positions (n_nodes, d) of the curtain drawn up into a line through its supports: slack wherever it can be."""
    middle, A = supported_map(problem)
    U, size, Vt = np.linalg.svd(A, full_matrices=False)
    return np.asarray(middle + problem.disc.nodes @ (U * np.minimum(size, 1.0) @ Vt).T)


def supported_map(problem: CurtainProblem) -> tuple[Array, Array]:
    """The affine map X -> b + A X, b and A (d, 2), nearest to where the supports hold their points; 0 where free."""
    X, mask, held = problem.disc.nodes, problem.supports.mask, problem.supports.positions
    d = held.shape[1]
    b, A = np.zeros(d), np.zeros((d, 2))
    for axis in range(d):
        nodes = mask[:, axis]
        if nodes.any():
            centre, mean = X[nodes].mean(axis=0), held[nodes, axis].mean()
            A[axis] = np.linalg.lstsq(X[nodes] - centre, held[nodes, axis] - mean, rcond=1e-9)[0]
            b[axis] = mean - A[axis] @ centre
        elif axis < 2:
            b[axis] = X[:, axis].mean()
    return b, A
