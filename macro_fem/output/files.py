"""What summary.json says of a solved curtain, with bounds and interval, and curtain.vtu."""

from collections.abc import Sequence
from dataclasses import asdict, fields, replace
from typing import Any

import numpy as np

from homogenize.laws import PlasticLaw
from macro_fem.bounds.interval import CurtainBounds
from macro_fem.bounds.limit import CurtainLimit
from macro_fem.curtain import CurtainProblem, CurtainSolution, CurtainState, forces_by, forces_note, wind_drags
from macro_fem.fem.cells import counterclockwise
from macro_fem.judged import (
    Rupture,
    collapse_at_points,
    judge_line_loads,
    judge_strength,
    links,
    string_stress,
    support_forces,
    utilisation,
)
from macro_fem.scene.loads import PER_MM2, areal_mass
from macro_fem.scene.tables import Bar, Load
from macro_fem.summary import (
    Bounds,
    BoundsOfPotential,
    CurtainNumbers,
    Feature,
    Limit,
    RingSizes,
    Utilisation,
    WeaveOfLaw,
)
from rve.common import Array, digits, versions
from rve.common.factor import linear_solver
from rve.geometry import CellInfo, padded

COARSE_POINTS = (
    "the interval begins at 0, as cells at held or loaded points reach beyond a disk of {:.3g} mm, one cell of the "
    "weave, and limit_factor falls with refinement there: take more cells"
)


def summarize(solution: CurtainSolution) -> CurtainNumbers:
    """The numbers of a solution: lengths in mm, forces in N, line loads in N per mm of reference length, heights along
    y, potentials -sum force . displacement in N mm."""
    problem = solution.problem
    disc = problem.disc
    area, x, in_space = disc.cell_area, solution.x, problem.fem.d == 3
    parts = np.bincount(solution.state(), weights=area, minlength=3) / area.sum()
    per_area, sag = areal_mass(problem.scene, problem.law.cell), solution.sag()
    found = CurtainNumbers(
        status=solution.status,
        message=solution.message,
        notes=problem.notes,
        mean_height_mm=solution.mean_height(),
        lowest_point_mm=float(x[:, 1].min()),
        lowest_point_at_mm=x[x[:, 1].argmin()].tolist() if in_space else None,
        out_of_plane_mm=float(np.abs(x[:, 2]).max()) if in_space else None,
        mean_sag_mm=sag and sag[0],
        largest_sag_mm=sag and sag[1],
        centre_of_gravity_mm=solution.area_mean(solution.x).tolist() if in_space else None,
        lean_mm=solution.lean(),
        max_displacement_mm=float(np.linalg.norm(solution.displacement, axis=1).max()),
        **judge_line_loads(solution).parts(),
        **judge_strength(solution).parts(),
        weakest=None,
        weakest_factor=None,
        weakest_place=None,
        total_load_N=problem.force.sum(axis=0).tolist(),
        support_forces=support_forces(solution),
        forces_by=forces_by(solution),
        support_forces_note=forces_note(solution),
        single_forces_note=None,
        potential_primal_N_mm=solution.primal,
        potential_dual_N_mm=solution.dual,
        relative_gap=solution.relative_gap,
        residual=solution.residual,
        stretch_beyond_locking=solution.stretch_excess,
        iterations=solution.iterations,
        cells=disc.n_cells,
        dofs=int(problem.fem.n),
        element=disc.element,
        pattern=problem.mesh.pattern,
        linear_solver=linear_solver(),
        law=problem.law.name,
        **weave_of(problem.law.cell, problem.scene.curtain.weave_angle).parts(),
        wind=wind_drags(solution) or None,
        areal_mass_kg_per_m2=per_area,
        mass_kg=per_area * PER_MM2 * float(area.sum()),
        taut_area_fraction=float(parts[2]),
        wrinkled_area_fraction=float(parts[1]),
        slack_area_fraction=float(parts[0]),
        wall_s=solution.wall_s,
        versions=versions("scikit-fem", "scikit-sparse"),
    )
    return with_weakest(found)


def with_weakest(found: CurtainNumbers) -> CurtainNumbers:
    """The numbers with what gives first, of what is known and loaded."""
    least = next(iter(links(found, found.support_forces)), None)
    if least is None:
        return found
    return replace(found, weakest=least.name, weakest_factor=least.factor, weakest_place=least.place)


def with_limit(
    numbers: CurtainNumbers,
    limit: CurtainLimit,
    solution: CurtainSolution,
    rigid: CurtainSolution | None,
    rupture: Rupture | str | None,
) -> CurtainNumbers:
    """The numbers of a curtain whose rings flow, with its limit and where strings break or why that is not known;
    utilisation, first yield and collapse of the worst cell are those of the curtain that is `rigid`, None where there
    is none."""
    law, beyond, notes = limit.problem.plastic_law.own, solution.stretch_beyond_locking, list[str]()
    assert isinstance(law, PlasticLaw)
    # Ratio of the hull of collapse loads to the safe set from which it is told.
    if law.difference > 1.01:
        notes.append(f"the set of line loads is safe, and up to {digits(law.difference)} times less than rows bear")
    if limit.status != "converged":
        notes.append(f"the solver of the limit ended as {limit.status}: the interval is as wide as it is known")
    most = float(beyond.max())
    # Stretch beyond locking with which rings count as strings: those of three-ring chains break at some 0.57.
    if most > 0.5 and law.strings is None:
        asked = "of which the law knows nothing without [solver] strings = true"
        notes.append(f"{digits(100.0 * most)} % beyond locking rings are strings, {asked}")
    if isinstance(rupture, str):
        notes.append(f"where strings break is not known: {rupture}")
    is_loaded, points = np.isfinite(limit.factor), None if rigid is None else collapse_at_points(rigid)
    weight, flows = solution.problem.disc.weight, beyond > 1e-6  # the solver leaves some 1e-8
    parts = Limit(
        limit_factor=limit.factor if is_loaded else None,
        limit_interval=[limit.lower, limit.upper] if is_loaded else None,
        limit_of_points=points,
        limit_note="; ".join(notes) or None,
        plastic_area_share=float(weight @ flows / weight.sum()),
        largest_plastic_strain=most,
        largest_plastic_strain_at_mm=solution.problem.disc.points[beyond.argmax()].tolist(),
        plastic_work_N_mm=solution.plastic_work,
        strings_stress_N_per_mm2=string_stress(solution),
    )
    if isinstance(rupture, Rupture):
        parts = replace(parts, **vars(rupture))
    none = dict.fromkeys(one.name for one in fields(Utilisation))
    judged = none if rigid is None else judge_strength(rigid).parts()
    too_low = None if not limit.is_coarse else COARSE_POINTS.format(limit.problem.disk_of_cell)
    return with_weakest(replace(numbers, **(judged | {"utilisation_too_low": too_low}), **parts.parts()))


def weave_of(cell: CellInfo | None, hang_deg: float) -> WeaveOfLaw:
    """Radii, weave and reference cell of a law, without areal mass and material, which a scene may replace."""
    if cell is None:
        return WeaveOfLaw(hang_deg=hang_deg, rings=None, weave=None, grain=None, reference_cell=None)
    drawing = None if cell.drawing is None else asdict(cell.drawing)
    sides = {"b_x_mm": cell.b_x_mm, "b_y_mm": cell.b_y_mm}
    sizes = RingSizes(r1_mm=cell.r1_mm, r2_mm=cell.r2_mm, **sides, drawing=drawing)
    named = {"weave": cell.weave, "grain": cell.grain, "reference_cell": cell.reference}
    return WeaveOfLaw(hang_deg=hang_deg, rings=sizes, **named)


def is_mean_height(problem: CurtainProblem) -> bool:
    """Whether the potential tells the mean height: of rigid rings, with the curtain's own weight as the only load."""
    x, y, z = problem.scene.load.acceleration
    is_down = x == z == 0.0 and y < 0.0 and not problem.scene.solver.is_plastic
    return is_down and not problem.scene.of(Load) and bool(np.abs(problem.force).sum() > 0.0)


def bounds_summary(bounds: CurtainBounds) -> BoundsOfPotential:
    """Bounds of the potential of the continuous curtain, N mm, and of the mean height where weight is the only load."""
    solution, problem = bounds.solution, bounds.solution.problem
    total, mean = float(np.abs(problem.force).sum()), solution.mean_height()
    return BoundsOfPotential(
        status=bounds.status,
        cells=problem.disc.n_cells,
        upper_N_mm=bounds.upper,
        lower_N_mm=bounds.lower,
        gap_N_mm=bounds.gap,
        gap_over_load_times_height=bounds.gap / (total * problem.mesh.height) if total > 0.0 else 0.0,
        part_of_gap_due_to_points_N_mm=bounds.points,
        wall_s=solution.wall_s + bounds.wall_s,
        mean_height_mm=[mean - bounds.gap / total, mean] if is_mean_height(problem) else None,
    )


def interval_summary(levels: Sequence[CurtainBounds]) -> Bounds:
    """Bounds of each level; the interval of the mean height, mm, or of the potential, N mm, by the last one, and its
    parts; that of the law is None where the law has no rows: then the interval is that of the law, not of the rings."""
    last, lines = levels[-1], tuple(bounds_summary(level) for level in levels)
    problem, law = last.solution.problem, last.law_part
    mesh = last.gap - (law or 0.0)
    if not is_mean_height(problem):
        ends = [last.lower, last.upper]
        work = last.solution.plastic_work
        return Bounds(
            bounds=lines[-1],
            levels=lines,
            potential_interval_N_mm=ends,
            plastic_work_interval_N_mm=None if work is None else [max(0.0, work - last.gap), work],
            law_part_N_mm=law,
            mesh_part_N_mm=mesh,
        )
    total = float(np.abs(problem.force).sum())
    return Bounds(
        bounds=lines[-1],
        levels=lines,
        mean_height_interval_mm=lines[-1].mean_height_mm,
        law_part_mm=None if law is None else law / total,
        mesh_part_mm=mesh / total,
    )


def features(solution: CurtainSolution, *, bounds: bool) -> tuple[Feature, ...]:
    """What was used and why; `bounds`: whether the curtain was bounded."""
    problem, settling = solution.problem, solution.settling
    scene = problem.scene
    ties = ["a bar keeps an edge straight"] * any(bar.straight for bar in scene.of(Bar))
    ties += ["an edge slides on a sloping line"] * any(held.slide is not None for held in problem.supports.held)
    flat = "all loads and supports lie in the plane, and so does the answer"
    rows = [("third-coordinate", bool(scene.space_reason), scene.space_reason or flat)]
    rows.append(("ties", bool(ties), " and ".join(ties) or "no straight bar and no sloping line"))
    if len(problem.walls):
        rows.append(("half-spaces-on-nodes", True, f"{len(problem.walls)} linear cones keep obstacles clear"))
    if settling is not None:
        still = f"forces of {settling.misfit:.1e} of the load still turn"
        rows.append(("rounds", True, f"{settling.rounds} convex solves: bodies or wind on the present shape; {still}"))
    if solution.second_step is not None:
        rows.append(("elastic-forces", *solution.second_step))
    asked = "[solver] bounds or adapt, or rings on demand" if scene.solver.is_bounded else "not asked for"
    rows.append(("bounds", bounds, f"{asked}: a second, equilibrated solution and an error map"))
    return tuple(Feature(feature=name, used=used, why=why) for name, used, why in rows)


def collection(entries: Sequence[tuple[float, int, str]]) -> str:
    """The text of a PVD file that lists times, numbers of parts and names of files."""
    lines = [f'    <DataSet timestep="{t:.9g}" part="{part}" file="{name}"/>' for t, part, name in entries]
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>\n'
    return head + "\n".join(lines) + "\n  </Collection>\n</VTKFile>\n"


def curtain_mesh(solution: CurtainState, extra: dict[str, Array] | None = None) -> Any:
    """The curtain for meshio: displacement, forces of supports, strain, stress, line loads, taut or slack per cell.

    Points are those of the reference state, to be warped by `displacement_mm`; `direction_1` is a direction in the
    deformed state; `extra` holds more cell data (n_cells, ...), such as an error map.
    """
    import meshio

    problem, mesh, disc = solution.problem, solution.problem.mesh.mesh, solution.problem.disc
    values, direction = solution.principal()
    used = utilisation(solution)
    flow = (
        solution.stretch_beyond_locking if isinstance(solution, CurtainSolution) and solution.tau is not None else None
    )
    data = {
        "E_11_12_22": disc.cell_mean(solution.E),
        "S_11_12_22_N_per_mm": disc.cell_mean(solution.S),
        "line_load_1_N_per_mm": values[:, 0],
        "line_load_2_N_per_mm": values[:, 1],
        "direction_1": padded(np.einsum("cij,cj->ci", disc.cell_mean(solution.F), direction)),
        "state_0_slack_1_wrinkled_2_taut": solution.state(),
        **({} if used is None else {"utilisation": used}),
        **({} if flow is None else {"plastic_strain": disc.cell_mean(flow)}),
        **(extra or {}),
    }
    point_data = {
        "displacement_mm": padded(solution.corners) - padded(mesh.p.T),
        "support_force_N": padded(corner_forces(problem, solution.reactions)),
    }
    if solution.obstacles:
        point_data["obstacle_force_N"] = padded(corner_forces(problem, solution.pushed.sum(axis=0)))
    cells = [("triangle", counterclockwise(mesh.p.T, mesh.t.T))]
    each = {name: [np.asarray(values, dtype=float)] for name, values in data.items()}
    return meshio.Mesh(padded(mesh.p.T), cells, point_data, each)


def corner_forces(problem: CurtainProblem, forces: Array) -> Array:
    """Nodal forces (n_nodes, d) at the corners of the mesh (n_corners, d); that of a middle is shared by both ends."""
    mesh = problem.mesh.mesh
    result = forces[: mesh.p.shape[1]].copy()
    if problem.disc.element == "P2":  # whose further nodes are the middles of facets
        for ends in mesh.facets:
            np.add.at(result, ends, 0.5 * forces[mesh.p.shape[1] :])
    return result
