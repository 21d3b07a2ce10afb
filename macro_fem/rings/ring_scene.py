"""A scene as a finite mesh of rings: its outline, loads and supports.

What a finite-element mesh with one cell per reference cell of the weave holds or loads at a node goes to the nearest
ring; a rectangle of whole cells has one there. The weight of a ring is its share of that of the reference area.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from homogenize import MembraneLaw, default_law, with_material
from macro_fem.curtain import CurtainSolution
from macro_fem.fem.assembly import load_vector
from macro_fem.fem.discretization import discretize
from macro_fem.rings.cost import ring_cost
from macro_fem.scene.checks import OF_HOOKS, check_sizes, keys_set
from macro_fem.scene.loads import PER_MM2, areal_mass, bar_masses, breeze, nodal_forces, weight_per_area, wind_per_area
from macro_fem.scene.meshing.mesh import build_mesh, edge_nodes
from macro_fem.scene.obstacles import Body
from macro_fem.scene.scene import Scene
from macro_fem.scene.shapes import Rectangle
from macro_fem.scene.supports import Sliding, build_supports, check_pins, pin_sliding
from macro_fem.scene.tables import Bar, Wind, in_3d
from rve import Cell, FiniteMesh, reference_cell
from rve.common import Array, Index, InputError
from rve.common.materials import material_of
from rve.finite import FiniteOptions, FiniteSolution, HalfSpace
from rve.geometry import CellInfo, padded

WHOLE, NEARLY_WHOLE = 1e-7, 0.02
"""A side of a rectangle within these parts of a cell of whole cells is left as it is, or made whole with a note."""
OF_DISK = ("kind", "tolerance", "max_iterations", "bounds", "adapt")
"""Keys of [solver] that rings do not read."""


@dataclass(frozen=True, eq=False)
class RingScene:
    """A scene as a finite mesh: rings, dead forces (n, 3) in N, held coordinates (n, 3), their places (n, 3) in mm.

    groups: name of each support and the components (n, 3) of rings that it holds.
    mass (n,): in kg, with that of bars. walls: half-spaces that the rings stay out of. pins: rings held along
    directions in which the supports let the mesh slide, so that it does not; they carry no force. winds: those with a
    speed, and the forces (n, 3) in N of their `breeze`; those of their speed are part of `force`. notes: what of the
    scene was changed to fit the rings. info: radii and reference cell of the rings.
    """

    scene: Scene
    mesh: FiniteMesh
    force: Array
    held: np.ndarray
    at: Array
    groups: tuple[tuple[str, np.ndarray], ...]
    pins: Sliding
    mass: Array
    info: CellInfo
    walls: tuple[HalfSpace, ...] = ()
    winds: tuple[tuple[Wind, Array], ...] = ()
    notes: tuple[str, ...] = ()

    def solve(
        self, *, space: bool, disk: CurtainSolution | None = None, options: FiniteOptions | None = None
    ) -> FiniteSolution:
        """The rings in equilibrium, their centres in `space` or the plane; InputError where they cannot be, or where
        walls push them along a direction in which nothing holds them.

        Where the membrane `disk` of the scene is given it guides the rings while folds form.
        """
        scene, pins = self.scene, self.pins
        if scene.in_space and not space:
            scene.refuse(f"{scene.space_reason}: centres cannot stay there")
        guide = None if disk is None else disk.places(self.mesh.X)
        if guide is not None and not scene.in_space:
            guide[:, 2] = np.nan
        try:
            found = self.mesh.solve(
                self.force, self.held, self.at, space=space, walls=self.walls, guide=guide, options=options
            )
        except InputError as error:
            raise InputError(f"{scene.source}: {error}") from error
        # Part of the loads up to which the force of a pin counts as none: walls push a little where nothing touches.
        noise = 1e-6 * float(np.abs(self.force).sum()) if found.status == "converged" else np.inf
        forces = check_pins(pins, found.reaction, noise, scene, "obstacle")
        reaction = found.reaction.copy()
        reaction[pins.nodes] -= forces[:, None] * pins.direction  # pins carry no force
        return replace(found, reaction=reaction)


def in_material(scene: Scene, cell: Cell) -> Cell:
    """The rings of the material that the scene names, else of their own."""
    metal = material_of(dict(scene.material), f"{scene.source}: [material]", base=cell.material)
    return replace(cell, material=metal)


def ring_scene(scene: Scene, rings: Cell | MembraneLaw | None = None, *, at_rest: bool = True) -> RingScene:
    """The rings of a scene, see `EveryRing`; InputError for what they cannot be or hold, what falls if `at_rest`."""
    info: CellInfo | None
    if isinstance(rings, Cell):
        info = reference_cell(in_material(scene, rings))
    else:
        law = default_law() if rings is None else rings
        info = with_material(law, dict(scene.material), f"{scene.source}: [material]").cell
    if info is None:
        scene.refuse("the law has no rings; take one that was fitted to a table of rings")
    if scene.motion is not None:
        scene.refuse("[motion]: is for rings over time: macro_fem rings, or solve(scene, EveryRing())")
    if any(wind.follows for wind in scene.of(Wind)):
        scene.refuse("follows = true of [load.wind]: is not for every ring")
    if bodies := scene.of(Body):
        scene.refuse(f"[obstacle] {bodies[0].name}: rings stay out of floors and walls, of nothing else")
    check_sizes(scene, info.r1_mm)
    mesh = _finite_mesh(_in_whole_cells(scene, info)[0], info)
    return with_loads(scene, info, mesh, None if at_rest else frozenset())


def _in_whole_cells(scene: Scene, info: CellInfo) -> tuple[Scene, tuple[str, ...]]:
    """The scene with the sides of a rectangle that are nearly whole cells made whole, and what was changed.

    Rings at the corners, which supports hold, are there only where the sides are whole cells.
    """
    curtain = scene.curtain
    if not isinstance(curtain, Rectangle) or curtain.holes or curtain.weave_angle % 90.0:
        return scene, ()
    sides = (info.b_x_mm, info.b_y_mm) if curtain.weave_angle % 180.0 == 0.0 else (info.b_y_mm, info.b_x_mm)
    notes = []
    for name, side in zip(("width", "height"), sides, strict=True):
        asked = vars(curtain)[name]
        count = round(asked / side)
        if count and NEARLY_WHOLE > abs(asked / side - count) > WHOLE:
            notes.append(f"{name} = {asked:g} mm is taken as {count} whole cells of the weave, {count * side:.7g} mm")
            whole: dict[str, Any] = {name: count * side}
            curtain = replace(curtain, **whole)
    return replace(scene, curtain=curtain), tuple(notes)


def _finite_mesh(scene: Scene, info: CellInfo) -> FiniteMesh:
    curtain = scene.curtain
    ring_cost(scene, info)
    outline = curtain.corners(scene.mesh.cells)
    cell = info.cell()
    mass = 1e-6 * info.areal_mass_kg_per_m2 * info.b_x_mm * info.b_y_mm  # of all rings of a cell
    density = cell.density * mass / (cell.ring_mass * float(cell.weave.masses.sum()))
    metal = replace(cell.material, density_kg_per_mm3=density)
    cell = replace(cell, material=metal)
    try:
        holes = [np.array(hole) for hole in curtain.holes]
        return FiniteMesh.inside(cell, outline, holes, curtain.weave_angle, info.sides_mm)
    except InputError as error:
        raise InputError(f"{scene.source}: [curtain]: {error}") from error


def _nearest_rings(mesh: FiniteMesh, nodes: Array) -> tuple[Index, csr_matrix]:
    """The ring nearest to each node, (k,), and what nodes hand over to rings, (n, k): the two nearest share alike where
    they are equally far, so that symmetric scenes have symmetric rings."""
    distance, ring = cKDTree(mesh.X).query(nodes, k=2)
    # Part of r1 by which distances of rings from a node may differ that count as one.
    other = 0.5 * (distance[:, 1] - distance[:, 0] < 1e-6 * mesh.cell.r1)
    shares, node = np.column_stack([1.0 - other, other]), np.repeat(np.arange(len(nodes)), 2)
    return ring[:, 0], csr_matrix((shares.ravel(), (ring.ravel(), node)), shape=(len(mesh.X), len(nodes)))


def with_loads(scene: Scene, info: CellInfo, mesh: FiniteMesh, released: frozenset[int] | None = None) -> RingScene:
    """The rings of a mesh under the loads and supports of a scene; released: as of `make_problem`."""
    scene, notes = _in_whole_cells(scene, info)
    unread = [("[solver]", keys_set(scene.solver, OF_DISK)), ("[load]", keys_set(scene.load, ["steps"]))]
    unread += [(item.where, keys_set(item, OF_HOOKS)) for item in scene.items]
    notes += tuple(f"{where} {', '.join(keys)}: has no effect on every ring" for where, keys in unread if keys)
    side = info.b_y_mm if scene.curtain.weave_angle % 180.0 == 90.0 else info.b_x_mm
    width = float(np.ptp(scene.curtain.corners(scene.mesh.cells)[:, 0]))
    one_per_cell = replace(scene.mesh, cells=max(1, round(width / side)), element="P1", pattern="aligned")
    scene = replace(scene, mesh=one_per_cell)
    fem = build_mesh(scene, info)
    notes += fem.notes
    disc = discretize(fem.mesh, "P1")
    weight = weight_per_area(scene, info)
    everything = nodal_forces(scene, fem, disc, info)
    supports = build_supports(scene, fem, disc, released=released or frozenset())
    if len(supports.sliding.nodes):
        scene.refuse("[support] sliding = true: rings slide along x, y or z, on no sloping line")
    if released is None:
        supports = pin_sliding(supports, disc, everything, scene)
    ring, onto = _nearest_rings(mesh, disc.nodes)
    force = padded(mesh.weighing_area[:, None] * weight + onto @ (everything - load_vector(disc, weight)))
    blown = (one for one in scene.of(Wind) if one.speed is not None)
    winds = ((one, onto @ load_vector(disc, wind_per_area(breeze(one), scene, info))) for one in blown)

    def on_rings(mask: np.ndarray) -> np.ndarray:
        """The components (n, 3) of rings that are held with those (n_nodes, d) of nodes."""
        held = padded(onto @ mask.astype(float)) > 0.0
        if not scene.in_space:
            held[:, 2] = held[:, 0] | held[:, 1]
        return held

    held, shares = on_rings(supports.fixed), padded(onto @ supports.fixed.astype(float))
    way = np.where(supports.fixed, supports.positions - padded(disc.nodes, scene.d), 0.0)
    at = padded(mesh.X) + padded(onto @ way) / np.where(shares > 0.0, shares, 1.0)
    bars = []
    mass = areal_mass(scene, info) * PER_MM2 * mesh.weighing_area + onto @ bar_masses(scene, fem, disc, turning=True)
    for bar in (one for one in scene.of(Bar) if one.straight):
        line = ring[edge_nodes(fem, disc, bar.edge)]
        bars.append(line[np.sort(np.unique(line, return_index=True)[1])])
    groups = tuple((one.name, on_rings(one.components(supports.mask.shape))) for one in supports.held)
    walls = []
    for item in scene.obstacle:  # at the end of their moves
        m = item.normal(np.zeros((1, 3)))
        offset = float(item.support(m)[0] + m[0] @ in_3d(item.move))
        walls.append(HalfSpace(tuple(m[0].tolist()), offset, item.name))
    pins = Sliding(ring[supports.pins.nodes], padded(supports.pins.direction))
    mesh = replace(mesh, bars=tuple(bars))
    return RingScene(scene, mesh, force, held, at, groups, pins, mass, info, tuple(walls), tuple(winds), notes)
