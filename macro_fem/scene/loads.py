"""Loads of a scene as nodal forces, consistent with the element's shape functions; wind as a pressure.

A speed v presses with C_D rho v^2 / 2 per area of the front, with C_D of a free-standing porous plate (K. Steiros, M.
Hultmark, J. Fluid Mech. 853 (2018) R3, equations 2.12 and 2.15): with the open share beta = 1 - solidity, the
resistance k = 1/beta^2 - 1 and the speed u of the air in the plane of the plate over v,

    C_D = 4/3 (1 - u)(2 + u)/(2 - u) = k u^2 - 4/3 (1 - u)^3/(2 - u)^2.

n layers of solidity s behind each other are one screen of solidity 1 - (1 - s)^n on the front that they share.
"""

from dataclasses import replace
from functools import lru_cache
from typing import TypeVar

import numpy as np

from homogenize import LawInterval, MembraneLaw, with_material
from homogenize.laws import Law
from macro_fem.fem.assembly import load_vector
from macro_fem.fem.cells import cross
from macro_fem.fem.discretization import Discretization
from macro_fem.scene.meshing.mesh import CurtainMesh, edge_nodes, facet_nodes, point_node
from macro_fem.scene.obstacles import unit
from macro_fem.scene.scene import Scene
from macro_fem.scene.tables import Bar, EdgeLoad, Load, PatchLoad, PointLoad, Wind
from rve import DirectOptions
from rve import solidity as solidity_of
from rve.common import Array
from rve.common.records import floats
from rve.geometry import CellInfo, padded

Kind = TypeVar("Kind", bound=MembraneLaw | LawInterval)
OURS = (Bar, EdgeLoad, PatchLoad, PointLoad, Wind)
PER_MM2 = 1e-6
"""m2 per mm2: kg/m2 times m/s2 is N/m2."""
AIR_DENSITY = 1.25
"""kg/m3, the recommended value of EN 1991-1-4:2005, 4.5 (1), note 2."""
SOLID = 4.0 / 3.0
"""C_D of a plate without holes."""
BREEZE = 1.0
"""m/s, the speed of `breeze`; forces of moving nodes are this one's, scaled."""


def areal_mass(scene: Scene, cell: CellInfo | None) -> float:
    """Areal mass in kg/m2 of the scene, else of the law, times the factor on weight; InputError if neither knows."""
    if scene.curtain.areal_mass is not None:
        return scene.weight * scene.curtain.areal_mass
    if cell is None:
        scene.refuse("[curtain] areal_mass: is missing, in kg/m2, and the law does not tell it")
    return scene.weight * cell.areal_mass_kg_per_m2


def meet(scene: Scene, law: Kind) -> tuple[Scene, Kind]:
    """The scene with the areal mass of a law that knows it without its rings, and the law with the scene's material."""
    law = with_material(law, dict(scene.material), f"{scene.source}: [material]")
    own = law.law if isinstance(law, LawInterval) else law
    mass = own.areal_mass_kg_per_m2 if isinstance(own, Law) else None
    if mass is None or scene.curtain.areal_mass is not None:
        return scene, law
    return replace(scene, curtain=replace(scene.curtain, areal_mass=mass)), law


def weight_per_area(scene: Scene, cell: CellInfo | None) -> Array:
    """Weight of the curtain (d,) in N/mm2; InputError if its areal mass is not known."""
    return areal_mass(scene, cell) * scene.vector(scene.load.acceleration) * PER_MM2


def wind_per_area(wind: Wind, scene: Scene, cell: CellInfo | None) -> Array:
    """The force of a wind on the flat sheet square to it (d,), N/mm2."""
    return np.asarray(wind_pressure(wind, cell) * unit(wind.direction)[: scene.d])


def nodal_forces(
    scene: Scene, mesh: CurtainMesh, disc: Discretization, cell: CellInfo | None, factor: float = 1.0
) -> Array:
    """All loads (n_nodes, d) in N; live ones (edges, points, patches, wind) are scaled by `factor`, weights are not.

    Wind with a speed is as on the flat sheet square to it, and wind that follows is none of them: see `curtain.wind`.
    """
    dead = load_vector(disc, weight_per_area(scene, cell))
    dead += bar_masses(scene, mesh, disc)[:, None] * scene.vector(scene.load.acceleration)
    live = np.zeros_like(dead)
    for edge in scene.of(EdgeLoad):
        live += edge_shares(mesh, disc, edge.edge)[:, None] * scene.vector(edge.force)
    for point in scene.of(PointLoad):
        live[point_node(point.at, disc)] += scene.vector(point.force)
    for patch in scene.of(PatchLoad):
        live += patch_load(patch, scene, mesh, disc)
    for wind in scene.of(Wind):
        if wind.speed is not None and cell is None:
            scene.refuse(
                f"[load.wind] speed = {wind.speed:g}: the law has no rings to tell the drag; give the pressure"
            )
        live += 0.0 if wind.follows else load_vector(disc, wind_per_area(wind, scene, cell))
    for own in loads_of_plugins(scene):
        live += own_forces(own, scene, mesh, disc)
    return dead + factor * live


def loads_of_plugins(scene: Scene) -> list[Load]:
    """The loads of a scene whose kinds are those of plugins."""
    return [one for one in scene.of(Load) if not isinstance(one, OURS)]


def own_forces(load: Load, scene: Scene, mesh: CurtainMesh, disc: Discretization) -> Array:
    """Nodal forces (n_nodes, d) of a load of a plugin: per area even in each cell, as bounds need it, per length even
    about each node. InputError for what says none."""
    forces, kind = np.zeros((disc.n_nodes, scene.d)), type(load)
    if kind.per_area is Load.per_area and kind.per_length is Load.per_length:
        scene.refuse(f"{load.where}: {kind.__name__} has neither per_area nor per_length")
    if kind.per_area is not Load.per_area:
        middles = mesh.mesh.p.T[mesh.mesh.t.T].mean(axis=1)
        each = _as_forces(load.per_area(middles), middles, load, scene)
        forces += load_vector(disc, np.tile(each, (disc.n_quad, 1)))
    if kind.per_length is not Load.per_length:
        if "edge" not in vars(load):
            scene.refuse(f"{load.where}: {kind.__name__} has per_length but no field `edge`")
        shares = edge_shares(mesh, disc, vars(load)["edge"])
        forces += shares[:, None] * _as_forces(load.per_length(disc.nodes), disc.nodes, load, scene)
    return forces


def _as_forces(given: Array, X: Array, load: Load, scene: Scene) -> Array:
    """Forces (n, d) at points X (n, 2); InputError for other shapes and numbers that are not finite."""
    given = floats(given, f"{scene.source}: {load.where}: force of {type(load).__name__}")
    if given.shape not in ((len(X), 2), (len(X), 3)) or not np.isfinite(given).all():
        scene.refuse(f"{load.where}: {type(load).__name__} gives {given.shape}, not finite forces (n, 2) or (n, 3)")
    if given.shape[1] > scene.d and given[:, 2].any():
        name = type(load).__name__
        scene.refuse(f"{load.where}: {name} has forces along z: give it a text space_reason, or [solver] space = true")
    return np.asarray(padded(given[:, : scene.d], scene.d))


def bar_masses(scene: Scene, mesh: CurtainMesh, disc: Discretization, *, turning: bool = False) -> Array:
    """Masses (n_nodes,) of all bars at the nodes of their edges, kg; turning: with the second moment of an even bar,
    m length^2 / 12, about the middle of straight ones with three nodes or more."""
    mass = np.zeros(disc.n_nodes)
    for bar in scene.of(Bar):
        shares, nodes = edge_shares(mesh, disc, bar.edge), edge_nodes(mesh, disc, bar.edge)
        own = shares[nodes] / shares.sum()
        if turning and bar.straight and len(nodes) > 2:
            along = np.linalg.norm(disc.nodes[nodes] - disc.nodes[nodes[0]], axis=1)
            s = along / along[-1] - 0.5
            powers = np.stack([np.ones_like(s), s, s * s])
            even = own * (1.0 + np.linalg.solve(own * powers @ powers.T, [0.0, 0.0, 1.0 / 12.0 - own @ s**2]) @ powers)
            own = even if even.min() > 0.0 else own  # as of nodes that are uneven
        mass[nodes] += bar.mass * own
    return mass


def edge_shares(mesh: CurtainMesh, disc: Discretization, name: str) -> Array:
    """Integral of every shape function over a named edge (n_nodes,), mm."""
    facets = mesh.edges[name]
    parts = [1.0 / 6.0, 1.0 / 6.0, 2.0 / 3.0] if disc.element == "P2" else [0.5, 0.5]
    each = np.multiply.outer(parts, np.hypot(*mesh.sides[facets].T))
    return np.bincount(facet_nodes(mesh, disc, facets).ravel(), each.ravel(), disc.n_nodes).astype(float)


def patch_load(load: PatchLoad, scene: Scene, mesh: CurtainMesh, disc: Discretization) -> Array:
    """A force spread over a disk, even within each cell; InputError if the disk holds no part of the curtain."""
    shares = disk_areas(mesh.mesh.p.T[mesh.mesh.t.T], np.array(load.at), load.radius)
    across = float(np.ptp(mesh.mesh.p, axis=1).max())
    if load.radius > across:
        what = f"is larger than the curtain, {across:g} mm across, were metres meant?"
        scene.refuse(f"[load.patch] radius = {load.radius:g}: {what}")
    if shares.sum() <= 0.0:
        scene.refuse(f"[load.patch] at = {list(load.at)}, radius = {load.radius:g}: holds no cell of the curtain")
    even = np.tile(shares / disc.cell_area, disc.n_quad)
    return load_vector(disc, even[:, None] * scene.vector(load.force) / shares.sum())


def disk_areas(corners: Array, centre: Array, radius: float) -> Array:
    """The area (n,) that each of the polygons with these corners (n, k, 2) shares with a disk: triangles, sectors."""
    a = corners - centre
    b = np.roll(a, -1, axis=1)
    along = b - a
    length2 = np.maximum((along * along).sum(axis=-1), 1e-300)
    middle = -(a * along).sum(axis=-1) / length2
    reach2 = middle**2 - ((a * a).sum(axis=-1) - radius**2) / length2
    reach = np.sqrt(np.maximum(reach2, 0.0))
    enters, leaves = (a + np.clip(middle + sign * reach, 0.0, 1.0)[..., None] * along for sign in (-1.0, 1.0))

    def angle(u: Array, v: Array) -> Array:
        return np.asarray(np.arctan2(cross(u, v), (u * v).sum(axis=-1)))

    parts = cross(enters, leaves) + radius**2 * (angle(a, enters) + angle(leaves, b))
    shares = 0.5 * np.abs(parts.sum(axis=1))
    return np.asarray(np.where(shares > 1e-12 * radius**2, shares, 0.0))


def dynamic_pressure(wind: Wind) -> float:
    """rho v^2 / 2 of a wind with a speed, N/mm2."""
    assert wind.speed is not None
    return 0.5e-6 * (AIR_DENSITY if wind.air_density is None else wind.air_density) * wind.speed**2


def breeze(wind: Wind) -> Wind:
    """The wind, with the speed BREEZE in place of its own."""
    return wind if wind.speed is None else replace(wind, speed=BREEZE)


def wind_pressure(wind: Wind, cell: CellInfo | None) -> float:
    """Pressure on one flat layer square to the wind, N/mm2."""
    if wind.speed is None:
        assert wind.pressure is not None
        return 1e-6 * wind.pressure
    return dynamic_pressure(wind) * float(layered_drag(cell, np.ones(1))[0])


def layered_drag(cell: CellInfo | None, layers: Array) -> Array:
    """C_D (k,) per area of a front of `layers` (k,) of the rings of a law."""
    assert cell is not None  # see `nodal_forces`
    return drag_coefficient(1.0 - (1.0 - ring_solidity(cell)) ** layers)


@lru_cache(maxsize=8)
def ring_solidity(cell: CellInfo) -> float:
    """Projected area of the rings of a law over the reference area, see `rve.solidity`."""
    return solidity_of(cell.cell(), DirectOptions(reference=cell.reference))


def drag_coefficient(solidity: Array | float) -> Array:
    """C_D (...) of free-standing screens, per total area, from 0 (nothing there) to 4/3 (solid): see the header."""
    open_2 = np.clip(1.0 - np.asarray(solidity), 0.0, 1.0) ** 2
    low, high = np.zeros_like(open_2), np.ones_like(open_2)
    # Halvings of the interval of u, after which it is known to rounding.
    for _ in range(60):
        u = 0.5 * (low + high)
        # both formulas of C_D are equal where C_D + 4/3 (1 - u)^3/(2 - u)^2, here times (2 - u)^2, is k u^2
        is_left = open_2 * SOLID * (1.0 - u) * (5.0 - 2.0 * u) > (1.0 - open_2) * (u * (2.0 - u)) ** 2
        low, high = np.where(is_left, u, low), np.where(is_left, high, u)
    return np.where(open_2 < 1.0, SOLID * (1.0 - u) * (2.0 + u) / (2.0 - u), 0.0)
