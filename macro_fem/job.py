"""Solving a scene, from Python and from files."""

import time
from collections.abc import Callable
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, overload

from homogenize import LawInterval, MembraneLaw, default_law, read_law_interval
from homogenize.fitting import interval_or_law
from macro_fem.answer import RECORD, Solution, read_job
from macro_fem.bounds.interval import CurtainBounds, admissible_problem, levels
from macro_fem.bounds.limit import limit_levels
from macro_fem.curtain import CurtainSolution, make_problem, solve_problem
from macro_fem.demand import OnDemand, solve_on_demand
from macro_fem.judged import Rupture, find_rupture
from macro_fem.membrane import MembraneSolution
from macro_fem.output.pictures import Pictures, draw_all
from macro_fem.ring_summary import EveryRingSummary
from macro_fem.rings import Comparison, EveryRing, EveryRingSolution, in_material, ring_scene
from macro_fem.scene.checks import check_bounds, check_scene, check_sizes
from macro_fem.scene.loads import meet
from macro_fem.scene.meshing.mesh import CurtainMesh, build_mesh, columns
from macro_fem.scene.moving import scaled
from macro_fem.scene.reading import load_scene
from macro_fem.scene.scene import Scene
from macro_fem.scene.shapes import MeshFile
from macro_fem.scene.tables import FACTORED, Combination, Load
from macro_fem.solvers.status import COLLAPSED
from macro_fem.summary import CurtainSummary
from rve import Cell
from rve.common import InputError, NotConverged, Progress, check_out_job, checked, heard_by, noted_if_stopped, part_of

Who = MembraneLaw | LawInterval | OnDemand | EveryRing | None
"""Who answers: a law, the interval of laws of a table, a law asked of the rings on the way, or every ring; None for the
law of rings with r1 = 5 mm and r2 = 0.5 mm."""


@overload
def solve(
    scene: Scene, who: EveryRing, *, progress: Callable[[Progress], object] | None = None
) -> EveryRingSolution | Any:
    """The answer of every ring; of one in motion that type does not tell."""


@overload
def solve(
    scene: Scene,
    who: MembraneLaw | LawInterval | OnDemand | None = None,
    *,
    progress: Callable[[Progress], object] | None = None,
) -> MembraneSolution | Any:
    """The answer of a law; of one in motion that type does not tell."""


@checked
def solve(scene: Scene, who: Who = None, *, progress: Callable[[Progress], object] | None = None) -> Solution:
    """The answer to a scene, a `MotionSolution` to one with [motion].

    Whether a scene moves is no part of its type: `isinstance(answer, MotionSolution)` tells type checkers which it is.

    progress: is called, as `print` would be, with a `Progress`: what is being done, and where it can be counted how far
    it is, with the time used and left.

    A law gives the curtain as a membrane. Bounds of a scene that asks for them hold for the law, or for its rings if it
    is an interval; the curtain is then that of the upper bound, by the inner law.

    An answer that has not converged has a status that says why. InputError if the scene is contradictory or its
    supports are out of reach.

    >>> from macro_fem import Mesh, Rectangle, Top
    >>> scene = Scene(Rectangle(100.0, 100.0), [Top()], Mesh(cells=4))
    >>> print(solve(scene).status)
    converged
    """
    with heard_by(progress) if progress else nullcontext():
        return _solve(scene, who)


def _solve(scene: Scene, who: Who) -> Solution:
    check_scene(scene)
    if scene.motion is not None:
        from macro_fem.motion.solution import solve_motion

        if isinstance(who, OnDemand):
            scene.refuse("[motion]: a curtain in motion takes a law or EveryRing(), not OnDemand(cell)")
        law = who.law if isinstance(who, LawInterval) else who
        return solve_motion(scene, default_law() if law is None else law)
    if isinstance(who, EveryRing):
        return solve_every_ring(scene, who)
    begun, count = time.monotonic(), len(scene.combination)
    answer, others = _solve_alone(scene, who), []
    for number, one in enumerate(scene.combination, 1):
        with part_of(f"combination {one.name}, {number} of {count}", number, count + 1, begun):
            others.append((one, _solve_alone(combined(scene, one), who)))
    with part_of("forces on a coarser mesh"):
        return replace(answer, combinations=tuple(others), coarser=_coarser(answer, who))


def _solve_alone(scene: Scene, who: MembraneLaw | LawInterval | OnDemand | None) -> MembraneSolution:
    """The answer to a scene without its combinations."""
    check_scene(scene)
    return _on_demand(scene, who) if isinstance(who, OnDemand) else solve_membrane(scene, who)


def _coarser(answer: MembraneSolution, who: Who) -> CurtainSolution | None:
    """The curtain on cells twice as large, where balance leaves forces of a row of hooks open, to compare them; None
    where there is no need, or no such mesh has a node for each."""
    scene, cells = answer.scene, answer.scene.mesh.cells
    half = replace(scene, mesh=replace(scene.mesh, cells=max(1, cells // 2)))
    if (
        isinstance(who, OnDemand | EveryRing)
        or scene.solver.is_bounded
        or answer.limits
        or isinstance(scene.curtain, MeshFile)
    ):
        return None
    if not answer.are_hooks_open or columns(half) > 0.7 * columns(scene):
        return None
    try:
        found = solve_membrane(half, who)
    except InputError:  # finer hooks than cells
        return None
    return found.loaded if found.status == "converged" else None


def combined(scene: Scene, combination: Combination) -> Scene:
    """The scene with each load times its factor."""
    items = tuple(
        scaled(item, combination.factor(item.kind), FACTORED) if isinstance(item, Load) else item
        for item in scene.items
    )
    return replace(scene, items=items, combination=(), weight=combination.weight)


def solve_membrane(scene: Scene, law: MembraneLaw | LawInterval | None = None) -> MembraneSolution:
    """`solve` by a law."""
    if not (isinstance(law, LawInterval | None) or hasattr(law, "support")):
        raise InputError(f"solve takes a law, OnDemand(cell) or EveryRing(cell), not a {type(law).__name__}")
    if law is None:
        law = read_law_interval() if scene.solver.is_bounded else default_law()
    scene, law = meet(scene, law)
    inner, law, outer = (law.inner, law.law, law.outer) if isinstance(law, LawInterval) else (law, law, None)
    check_sizes(scene, None if law.cell is None else law.cell.r1_mm)
    if scene.solver.is_plastic:
        return _solve_plastic(scene, law)
    if not scene.solver.is_bounded:
        return MembraneSolution(scene, tuple(_steps(scene, law, scene.load.steps)))
    steps = _steps(scene, inner, scene.load.steps)
    if steps[-1].status != "converged":
        scene.refuse(f"[solver] bounds: need a converged curtain: {steps[-1].message}")
    bounds = tuple(levels(steps[-1], outer))
    return MembraneSolution(scene, (*steps[:-1], bounds[-1].solution), bounds)


def _solve_plastic(scene: Scene, law: MembraneLaw) -> MembraneSolution:
    """The curtain whose rings flow, its limit, and the curtain whose rings do not; that one alone where the loads are
    beyond the limit of rings that never become strings."""
    still = replace(scene, solver=replace(scene.solver, kind="auto", bounds=False, adapt=0, strings=False))
    pose, mesh, rigid = (
        admissible_problem if scene.solver.is_bounded else make_problem,
        build_mesh(scene, law.cell),
        None,
    )
    # With strings, meshes are refined where bounds of the potential differ, which tell the work of a curtain beyond.
    once = replace(scene, solver=replace(scene.solver, adapt=scene.solver.adapt * (not scene.solver.strings)))
    limits = tuple(limit_levels(pose(once, law, mesh)))
    with suppress(InputError):  # supports out of reach of rings that lock
        rigid = MembraneSolution(still, tuple(_steps(still, law, scene.load.steps)))
    if scene.solver.strings or not limits[-1].is_passed:
        steps = _steps(scene, law, scene.load.steps, limits[-1].problem.mesh)
    elif rigid is None:
        scene.refuse(f"[load]: {COLLAPSED}; limit_factor = {limits[-1].factor:.4g}")
    else:
        steps = [replace(rigid.loaded, stop="collapsed")]
    bounds: tuple[CurtainBounds, ...] = ()
    if scene.solver.is_bounded and scene.solver.strings and steps[-1].status == "converged":
        bounds = tuple(levels(steps[-1]))
        steps = [*steps[:-1], bounds[-1].solution]
    rupture: Rupture | str | None = None
    if scene.solver.strings:
        try:
            rupture = find_rupture(steps[-1]) or "it takes live loads, and a [material] with ultimate"
        except (InputError, NotConverged) as error:
            rupture = str(error)
    return MembraneSolution(scene, tuple(steps), bounds, limits=limits, rigid=rigid, rupture=rupture)


def solve_every_ring(scene: Scene, who: EveryRing) -> EveryRingSolution:
    """`solve` with every ring as a rigid body, from the start that is asked for."""
    if scene.combination:
        scene.refuse("[combination]: is for a curtain by a law; every ring bears its loads")
    rings = ring_scene(scene, who.rings)
    disk = None
    if who.start == "disk":
        if isinstance(who.rings, Cell):
            raise InputError('start = "disk": needs the law that guides the rings: EveryRing(law, start="disk")')
        disk = solve_membrane(scene, who.rings).solution
    found = rings.solve(space=who.space, disk=disk)
    return EveryRingSolution(rings, found, who.start, disk)


def _on_demand(scene: Scene, who: OnDemand) -> MembraneSolution:
    """The curtain by a law that is asked of the rings; earlier load steps by the law found at full load."""
    if scene.solver.is_plastic:
        scene.refuse(
            "[solver] kind = 'plastic': needs a law, by --law, with the strength of its rings (rve table --rings)"
        )
    check_sizes(scene, who.cell.r1)
    who = replace(who, cell=in_material(scene, who.cell))
    bounded = replace(scene, solver=replace(scene.solver, bounds=True))
    try:
        check_bounds(bounded, "--cell asks the rings where bounds of the curtain differ, which")
    except InputError as error:
        error.add_note("make their table by rve table --rings, fit a law, and give it by --law")
        raise
    note = "give --cache FOLDER to keep the tables of the rings"
    if who.cache is not None:
        note = f"tables of the rings are kept in {who.cache}, and the same command goes on from there"
    with noted_if_stopped(note):
        found = solve_on_demand(bounded, who)
        early = _steps(bounded, found.rings.law.inner, scene.load.steps - 1)
    return MembraneSolution(bounded, (*early, found.level.solution), (found.level,), found)


def _steps(scene: Scene, law: MembraneLaw, last: int, mesh: CurtainMesh | None = None) -> list[CurtainSolution]:
    """The curtain at load steps 1 to `last`, each from the one before; for bounds it obeys the law everywhere."""
    mesh, count = build_mesh(scene, law.cell) if mesh is None else mesh, scene.load.steps
    pose = admissible_problem if scene.solver.is_bounded else make_problem
    steps: list[CurtainSolution] = []
    for step in range(1, last + 1):
        work = f"{mesh.mesh.t.shape[1]} cells, load step {step} of {count}"
        with part_of(work):
            solution = solve_problem(pose(scene, law, mesh, step / count), steps[-1] if steps else None)
        if solution.status == "infeasible":
            at = f" at {step / count:.3g} of the prescribed moves" if count > 1 else ""
            table = "obstacle" if solution.stop == "blocked" else "support"
            scene.refuse(f"[{table}]: {solution.message}{at}")
        steps.append(solution)
    return steps


def run_scene(
    scene_path: Path,
    law_path: Path | None,
    out: Path,
    *,
    on_demand: OnDemand | None = None,
    limit: bool = False,
    **files: Any,
) -> CurtainSummary:
    """Solve the scene in a file by a law, or by rings `on_demand`, write its files into `out`; the summary.

    limit: rings flow, whatever the scene says. `files`: `picture`, `animation` and `html` as of `Solution.save`, and
    paths of a `report` (PDF) and of the outline as `dxf`. InputError, before anything is solved or written, for a
    scene that cannot be read or is contradictory, and for pictures and files that cannot be made; later, if there is
    no solution. NotDrawn, when all else is in place, for pictures and a report that fail.
    """
    wanted, scene = Pictures(**files), load_scene(scene_path)
    scene = with_flow(scene) if limit else scene
    known = on_demand.known if on_demand and isinstance(on_demand.known, Path) else None
    inputs = [scene_path, law_path, known, scene.sheet_file]
    check_out_job(out, RECORD, inputs=inputs)
    wanted.check(scene, inputs)
    law = None if law_path is None else interval_or_law(law_path)
    with noted_if_stopped(f"what was in {out} before is unchanged"):
        found = solve(scene, law if on_demand is None else on_demand)
        found.save(out, picture=False, inputs=inputs)
    if wanted.dxf is not None:
        found.write_dxf(wanted.dxf)
    drawings = found.drawings(wanted)
    if wanted.report is not None:
        drawings[str(wanted.report.absolute())] = lambda path: found.write_report(path, inputs)
    draw_all(out, RECORD, found.summary, drawings, inputs)
    return found.summary


def with_flow(scene: Scene) -> Scene:
    """The scene with rings that flow."""
    return replace(scene, solver=replace(scene.solver, kind="plastic"))


def run_rings(
    scene_path: Path, law_path: Path | None, out: Path, *, picture: bool = True, html: bool = False, **how: Any
) -> EveryRingSummary:
    """Solve the scene in a file ring by ring, write its files into `out`; the summary. how: space and start of
    `EveryRing`. InputError, and nothing written, for what cannot be read, or makes no sense for rings."""
    Pictures(picture, html=html, stem="rings").check()
    scene, law, inputs = read_job(scene_path, law_path, out)
    answer = solve_every_ring(scene, EveryRing(law, **how))
    answer.save(out, picture=picture, html=html, inputs=inputs)
    return answer.summary


@checked
def compare(
    scene: Scene, law: MembraneLaw | None = None, *, space: bool = True, start: Literal["slack", "disk"] = "slack"
) -> Comparison:
    """The membrane on the mesh of the scene, and its rings from a start "slack" or "disk", see `EveryRing`.

    InputError for scenes that one of both cannot be.
    """
    rings = solve_every_ring(scene, EveryRing(law, space, start))
    disk = rings.disk or solve_membrane(scene, default_law() if law is None else law).solution
    return Comparison(disk, rings)
