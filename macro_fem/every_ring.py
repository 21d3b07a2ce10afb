"""A scene solved ring by ring: the finite mesh of its outline, its loads and supports, and the files of the answer.

Supports and live loads are those of a finite-element mesh with one cell per reference cell of the weave: what it holds
or loads at a node goes to the nearest ring. A rectangle of whole cells has a ring at every such node. The weight of a
ring is that of its share of the reference area.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from homogenize import CellInfo, MembraneLaw, default_law, load_law, with_material
from macro_fem.fem.assembly import load_vector
from macro_fem.fem.discretization import discretize
from macro_fem.fem.space import in_space_of
from macro_fem.job import solve as membrane
from macro_fem.scene.loads import nodal_forces, weight_per_area
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.meshing.outline import regular_polygon
from macro_fem.scene.obstacles import is_flat
from macro_fem.scene.schema import Scene, load_scene
from macro_fem.scene.supports import Held, build_supports, pin_sliding
from macro_fem.scene.tables import in_3d
from macro_fem.solution import CurtainSolution
from rve import FiniteMesh, FiniteOptions, FiniteSolution, HalfSpace, cell_of_sides
from rve.common.drawing.page import check_page
from rve.common.errors import InputError, require
from rve.common.storage.files import versions, write_text, write_whole
from rve.common.storage.jobs import check_out_job, job
from rve.common.types import Array

RECORD = "summary.json"
MOST_CELLS = 400_000
"""Reference cells of a scene; more are refused, two rings each."""


@dataclass(frozen=True, eq=False)
class RingScene:
    """A scene as a finite mesh: rings, dead forces (n, 3) in N, held coordinates (n, 3), their places (n, 3) in mm.

    groups: name of each support and the rings (k,) that it holds; a ring that several hold counts for the first.
    walls: half-spaces that the rings stay out of.
    """

    scene: Scene
    mesh: FiniteMesh
    force: Array
    held: np.ndarray
    at: Array
    groups: tuple[tuple[str, np.ndarray], ...]
    walls: tuple[HalfSpace, ...] = ()

    def solve(
        self, *, space: bool, disk: CurtainSolution | None = None, options: FiniteOptions | None = None
    ) -> FiniteSolution:
        """The rings in equilibrium, their centres in `space` or the plane; InputError where they cannot be.

        Where the membrane `disk` of the scene is given it guides the rings while folds form.
        """
        if self.scene.in_space and not space:
            raise InputError(f"{self.scene.source}: {self.scene.space_reason}: centres cannot stay there")
        guide = None if disk is None else disk.places(self.mesh.X)
        if guide is not None and not self.scene.in_space:
            guide[:, 2] = np.nan
        try:
            return self.mesh.solve(
                self.force, self.held, self.at, space=space, walls=self.walls, guide=guide, options=options
            )
        except InputError as error:
            raise InputError(f"{self.scene.source}: {error}") from error


def ring_scene(scene: Scene, law: MembraneLaw | None = None) -> RingScene:
    """The rings of a scene with the rings of a law; InputError for what a mesh of rings cannot be or hold.

    >>> scene = Scene.rectangle(22.0, 12.646069623526).hung_by("top")
    >>> rings = ring_scene(scene)
    >>> len(rings.mesh.X), [len(held) for _, held in rings.groups]
    (8, [3])
    """
    asked = with_material(default_law() if law is None else law, dict(scene.material), f"{scene.source}: [material]")
    info = asked.cell
    if info is None:
        raise InputError(f"{scene.source}: the law has no rings; take one that was fitted to a table of rings")
    if any(bar.straight for bar in scene.load.bar):
        raise InputError(
            f"{scene.source}: [load.bar] straight = true: rings are not tied to a bar, use straight = false"
        )
    if any(wind.follows for wind in scene.load.wind):
        raise InputError(f"{scene.source}: follows = true of [load.wind]: is not for every ring")
    round_ = [item.name for item in scene.obstacle if not is_flat(item)]
    if round_:
        raise InputError(f"{scene.source}: [obstacle] {round_[0]}: rings stay out of floors and walls, of nothing else")
    mesh = _finite_mesh(scene, info)
    return _with_loads(_by_cells(scene, info), info, mesh)


def _finite_mesh(scene: Scene, info: CellInfo) -> FiniteMesh:
    curtain, source = scene.curtain, scene.source
    if curtain.shape == "file":
        raise InputError(f'{source}: [curtain] shape = "file": has no outline of its own, use shape = "outline"')
    outline = _outline(scene)
    spans = np.ptp(outline, axis=0)
    count = float(spans.prod()) / (info.b_x_mm * info.b_y_mm)
    if count > MOST_CELLS:
        raise InputError(
            f"{source}: [curtain]: {count:.3g} cells of the weave are more than {MOST_CELLS}; make it smaller"
        )
    cell = cell_of_sides(info.r1_mm, info.r2_mm, (info.b_x_mm, info.b_y_mm))
    try:
        return FiniteMesh.inside(cell, outline, [np.array(hole) for hole in curtain.holes], curtain.weave_angle)
    except InputError as error:
        raise InputError(f"{source}: [curtain]: {error}") from error


def _outline(scene: Scene) -> Array:
    curtain = scene.curtain
    if curtain.shape == "rectangle":
        W, H = curtain.width or 0.0, curtain.height or 0.0
        return np.array([[0.0, 0.0], [W, 0.0], [W, H], [0.0, H]])
    if curtain.shape == "disk":
        return regular_polygon(curtain.radius or 0.0, max(8, math.ceil(math.pi * scene.mesh.cells)))
    return np.array(curtain.outline)


def _by_cells(scene: Scene, info: CellInfo) -> Scene:
    """The scene with one column of finite elements per reference cell of the weave."""
    side = info.b_y_mm if scene.curtain.weave_angle % 180.0 == 90.0 else info.b_x_mm
    width = float(np.ptp(_outline(scene)[:, 0]))
    mesh = replace(scene.mesh, cells=max(1, round(width / side)), element="P1", pattern="aligned")
    return replace(scene, mesh=mesh)


def _with_loads(scene: Scene, info: CellInfo, mesh: FiniteMesh) -> RingScene:
    fem = build_mesh(scene, info)
    disc = discretize(fem.mesh, "P1")
    weight = weight_per_area(scene, info)
    everything = nodal_forces(scene, fem, disc, info)
    supports = build_supports(scene, fem, disc)
    if supports.sliding is not None:
        raise InputError(f"{scene.source}: [support] sliding = true: rings slide along x, y or z, on no sloping line")
    supports = pin_sliding(supports, disc, everything, scene.source)
    live = everything - load_vector(disc, weight)
    ring = cKDTree(mesh.X).query(disc.nodes)[1]
    n = len(mesh.X)
    force = np.zeros((n, 3))
    force[:, : scene.d] = mesh.area[:, None] * weight
    np.add.at(force[:, : scene.d], ring, live)
    held, way = np.zeros((n, 3), bool), np.zeros((n, 3))
    mask = supports.mask | supports.pinned
    for axis in range(scene.d):
        nodes = np.flatnonzero(mask[:, axis])
        held[ring[nodes], axis] = True
        way[ring[nodes], axis] = (supports.positions - in_space_of(disc.nodes, scene.d))[nodes, axis]
    if not scene.in_space:
        held[:, 2] = held[:, 0] | held[:, 1]
    at = np.column_stack([mesh.X, np.zeros(n)]) + way
    return RingScene(scene, mesh, force, held, at, _groups(supports.held, ring), _walls(scene))


def _walls(scene: Scene) -> tuple[HalfSpace, ...]:
    """Floors and walls of a scene at the end of their moves."""
    out = []
    for item in scene.obstacle:
        m = item.normal(np.zeros((1, 3)))
        offset = float(item.support(m)[0] + m[0] @ in_3d(item.move))
        out.append(HalfSpace((float(m[0, 0]), float(m[0, 1]), float(m[0, 2])), offset, item.name))
    return tuple(out)


def _groups(supports: tuple[Held, ...], ring: np.ndarray) -> tuple[tuple[str, np.ndarray], ...]:
    """The rings of each support, each ring once."""
    groups: list[tuple[str, np.ndarray]] = []
    taken = np.zeros(0, int)
    for one in supports:
        mine = np.setdiff1d(np.unique(ring[one.nodes]), taken)
        taken = np.concatenate([taken, mine])
        groups.append((one.name, mine))
    return tuple(groups)


def or_none(value: float | Array) -> Any:
    """The number, or list of numbers, None where it is not finite: JSON has neither nan nor inf."""
    array = np.asarray(value)
    return array.tolist() if np.isfinite(array).all() else None


def summarize_rings(rings: RingScene, solution: FiniteSolution) -> dict[str, Any]:
    """The numbers of summary.json: lengths in mm, forces in N; null for forces and residual where there are none."""
    has_forces = bool(np.isfinite(solution.force).all())
    largest = float(solution.force.max(initial=0.0)) if has_forces else math.nan
    return {
        "status": solution.status,
        "message": solution.message,
        "rings": len(rings.mesh.X),
        "centres": "space" if solution.is_space else "plane",
        "mean_height_mm": solution.mean_height,
        "lowest_point_mm": float(solution.centre[:, 1].min()),
        "depth_mm": float(np.ptp(solution.centre[:, 2])),
        "potential_N_mm": solution.potential,
        "min_gap_mm": solution.min_gap_mm,
        "links": len(rings.mesh.linked),
        "links_intact": solution.links_intact,
        "kkt_residual": or_none(solution.kkt_residual),
        "way_left_mm": solution.way_left_mm,
        "contacts": int((solution.force > 1e-6 * largest).sum()) if has_forces else None,
        "largest_contact_force_N": or_none(largest),
        "total_load_N": solution.load.sum(axis=0).tolist(),
        "support_forces": [
            {
                "support": name,
                "sum_N": or_none(solution.reaction[held].sum(axis=0)),
                "points": [
                    {"at_mm": X.tolist(), "force_N": or_none(f)}
                    for X, f in zip(rings.mesh.X[held], solution.reaction[held], strict=True)
                ],
            }
            for name, held in rings.groups
        ],
        "wall_forces": [
            {"wall": wall.name, "sum_N": or_none(force)}
            for wall, force in zip(solution.walls, solution.wall_force, strict=True)
        ],
        "r1_mm": rings.mesh.cell.r1,
        "r2_mm": rings.mesh.cell.r2,
        "weave": rings.mesh.cell.weave.name,
        "iterations": solution.iterations,
        "wall_s": round(solution.wall_s, 3),
        "versions": versions(),
    }


def run_rings(
    scene_path: Path,
    law_path: Path | None,
    out: Path,
    *,
    space: bool = True,
    start: str = "slack",
    picture: bool = True,
    html: bool = False,
) -> dict[str, Any]:
    """Solve the scene in a file ring by ring, write summary.json, rings.vtu and rings.png into `out`; the summary.

    start: "disk" solves the membrane of the scene first and lets it guide the rings, see `RingScene.solve`. html: also
    rings.html, which turns in a browser. InputError in one sentence for what cannot be read, or makes no
    sense for rings; nothing is written then.
    """
    if picture:
        require("matplotlib", "plots", "rings.png", "ask for --no-picture")
    if html:
        check_page("rings.html", "leave out --html")
    scene = load_scene(scene_path)
    inputs = [scene_path, law_path]
    check_out_job(out, RECORD, inputs=inputs)
    law = default_law() if law_path is None else load_law(law_path)
    rings = ring_scene(scene, law)
    solution = rings.solve(space=space, disk=membrane(scene, law).solution if start == "disk" else None)
    summary = summarize_rings(rings, solution) | {"start": start}
    with job(out, RECORD, inputs) as folder:
        solution.write_vtu(folder / "rings.vtu")
        if picture:
            _save_picture(folder / "rings.png", solution)
        if html:
            solution.write_html(folder / "rings.html")
        write_text(folder / RECORD, json.dumps(summary, indent=2, allow_nan=False) + "\n")
    return summary


def _save_picture(path: Path, solution: FiniteSolution) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 8.0), layout="constrained")
    FigureCanvasAgg(figure)
    solution.plot(figure.subplots())
    write_whole(path, lambda temporary: figure.savefig(temporary, dpi=200))
