"""Natural frequencies of small motions about a curtain at rest.

    K w = omega^2 M w,   K the geometric stiffness of the line loads S,   M the masses of mesh and bars.

The locked state itself stores nothing. A curtain in its plane is asked for motions across it, one component per node.
In space w has three components and keeps to the tangent of the locked surface, S:(F^T grad w) = 0 at every point that
carries load; what an obstacle pushes stays on it, whose curvature takes from K.

Columns that hang beside each other are coupled only by line loads across: modes that share one frequency are counted
once, with their number. A mesh gives each a frequency of its own, the farther off the rougher its shape is: what a
smoother shape may explain counts to that. Left out are shapes that alternate from node to node, which are the mesh's
own (`MODES.resolved`), and those of slack parts, which nothing but inertia resists (`MODES.slack_hz`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import skfem
import skfem.models.poisson
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from macro_fem.answer import read_job
from macro_fem.curtain import CurtainSolution, forces_by
from macro_fem.fem.assembly import SparsityPattern, stiffness
from macro_fem.fem.cells import counterclockwise, mean_at_corners, recovered
from macro_fem.fem.discretization import ELEMENTS
from macro_fem.job import solve_membrane
from macro_fem.motion.stage import TONNE, masses_of, mesh_masses, pushed_points, scene_at
from macro_fem.motion_summary import ModesSummary
from macro_fem.output import plans
from macro_fem.output.images import save_picture
from macro_fem.output.pictures import Drawings, Pictures, draw_all
from macro_fem.output.sentences import loads_in_words
from macro_fem.output.space_view import add_supports
from macro_fem.scene.supports import build_supports
from macro_fem.scene.tables import Bar, Wind
from rve.common import Array, InputError, NotConverged, job, versions
from rve.common.drawing.plane import Scale
from rve.common.drawing.space import THREE_QUARTERS, add, add_length, look, new_plotter, surface
from rve.common.files import write_mesh_file
from rve.common.optional import Figure, Plotter
from rve.geometry import padded


@dataclass(frozen=True)
class ModeOptions:
    """Numbers of the search for modes."""

    carries: float = 1e-6
    """Points with a larger part of the largest line load than this carry load, and hold nodes on the locked surface."""
    shift: float = 1e-2
    """The shift is minus this part of the mean line load, times twice the area over mass and size squared: about g over
    the size of a curtain that hangs."""
    slack_hz: float = 2e-3
    """Frequencies below this part of that pendulum's are those of slack parts."""
    resolved: float = 0.9
    """Consistent over lumped kinetic energy of a shape that the mesh resolves: 1 for a smooth one, 1/4 for the
    roughest."""
    smooth: float = 2e-2
    """Up to this part of the stored energy what averaged gradients lack is the error of the mesh, which is taken
    off."""
    rounding: float = 1e-9
    """Compliance of constraints relative to the stiffness: what repeats itself stays solvable."""
    most: int = 800
    block: int = 64
    """Shapes looked at, and those whose roughness is found together."""


MODES = ModeOptions()
EXACT, DOUBT = {2: 2e-3, 3: 1e-2}, {2: 1.0, 3: 1.5}
"""How exact frequencies of smooth shapes are, in the plane and in space, where the locked surface stiffens the mesh;
the power of 1 - roughness by which others are too large. Larger values count more shapes to smoother ones."""
SQUARE = [[0, 1], [1, 2]]
"""Places in triples (11, 12, 22) of the components of their tensors."""
RECORD = "modes.json"
SHOWN, REPORTED = 0.15, 3
"""The largest displacement of a shape in pictures over the size of the curtain."""


@dataclass(frozen=True, eq=False)
class Modes:
    """Natural frequencies (k,) in Hz, ascending and distinct; multiplicity (k,), how many modes share each; shapes
    (k, n_nodes, 3), the largest displacement of each 1 mm.

    left_out: what kinds of motion are not among them.
    """

    frequencies_Hz: Array
    multiplicity: np.ndarray
    shapes: Array
    solution: CurtainSolution
    left_out: str


def find_modes(solution: CurtainSolution, number: int = 6) -> Modes:
    """The `number` lowest natural frequencies of a curtain and their shapes.

    InputError for a number that the mesh cannot tell, NotConverged for a static answer that is none.
    """
    if solution.status != "converged":
        raise NotConverged(
            f"the curtain at rest ended as {solution.status}, so that it has no modes: {solution.message}"
        )
    in_space = solution.problem.fem.d == 3
    T = solution.problem.fem.T if in_space else _across(solution)
    K, M, lumped = (sparse.csc_matrix(T.T @ sparse.kron(A, sparse.eye(3)) @ T) for A in _of_one_component(solution))
    n = M.shape[0]
    C, most = sparse.csr_matrix((0, n)), n // 2
    if in_space:
        pushed, curvature = pushed_points(solution, MODES.carries)
        K, C = sparse.csc_matrix(K - T.T @ curvature @ T), sparse.vstack([_constraints(solution, T), pushed @ T])
        many = max(0, pushed.shape[0] - len(np.unique(pushed.indices // 3)))  # rows beside each other repeat themselves
        most = (n - C.shape[0] + many) // 2
    if not 1 <= number <= most:
        raise InputError(f"number = {number}: a mesh of this size tells from 1 to {max(most, 0)} modes")
    pendulum = _pendulum(solution)
    sigma = -MODES.shift * pendulum
    inverse = LinearOperator((n, n), matvec=_solver(K - sigma * M, C), dtype=np.float64)
    asked, least, last = min(most, 3 * number + 8), MODES.slack_hz**2 * pendulum, min(most, max(MODES.most, 6 * number))
    while True:
        square, shape = eigsh(K, asked, M, sigma=sigma, OPinv=inverse, v0=np.linspace(1.0, 2.0, n), tol=1e-12)
        is_taut = square > least
        square, shape = square[is_taut], shape[:, is_taut]
        ratio = (shape * (M @ shape)).sum(axis=0) / (shape * (lumped @ shape)).sum(axis=0)
        shapes = (T @ shape).T.reshape(-1, solution.problem.disc.n_nodes, 3)
        blocks = np.split(shapes, range(MODES.block, len(shapes), MODES.block))
        rough = np.concatenate([_roughness(solution, block) for block in blocks])
        frequency = np.sqrt(square) / (2.0 * np.pi)
        groups = _distinct(frequency, rough, ratio > MODES.resolved, 3 if in_space else 2)
        if len(groups) > number or asked == last:
            break
        asked = min(last, 2 * asked)
    groups = groups[:number]
    first, multiplicity = [one[0] for one in groups], np.array([len(one) for one in groups], int)
    frequency = frequency * np.sqrt(np.where(rough < MODES.smooth, 1.0 - rough, 1.0))
    if not len(first):
        raise InputError(
            f"number = {number}: this mesh tells no mode: the {last} lowest shapes are slack or change from node to "
            "node, as of columns that hang without a line load across; use more cells"
        )
    frequency, shapes = frequency[first], shapes[first]
    shapes = shapes / np.linalg.norm(shapes, axis=2).max(axis=1)[:, None, None]
    other = "leaves the locked surface" if in_space else "stays in its plane"
    left_out = f"motion of slack parts, and motion that {other}"
    if any(wind.follows or wind.speed is not None for wind in solution.problem.scene.of(Wind)):
        left_out += "; how winds that follow or have a speed change as the curtain moves"
    if len(first) < number:
        left_out += f"; more modes than {len(first)}, which shapes on so coarse a mesh do not tell: use more cells"
    return Modes(frequency, multiplicity, shapes, solution, left_out)


def _distinct(frequency: Array, rough: Array, kept: np.ndarray, d: int) -> list[list[int]]:
    """The shapes of each distinct frequency, ascending, the smoothest first; those that are not `kept` are none.

    A rough shape counts to a smoother one whose frequency it may have: less by up to `DOUBT`, or, as line loads differ
    from cell to cell, more by up to the root of 1 - roughness.
    """
    groups: list[list[int]] = []
    known = np.maximum(1.0 - rough, 1e-9)
    best = frequency * np.where(rough < MODES.smooth, np.sqrt(known), 1.0)
    for k in sorted(np.flatnonzero(kept).tolist(), key=lambda k: float(rough[k])):
        lead = best[[one[0] for one in groups]] / frequency[k]
        far = np.abs(np.log(lead)) + np.log(known[k]) * np.where(lead < 1.0, DOUBT[d], 0.5)
        if len(groups) and far.min() <= EXACT[d]:
            groups[int(np.abs(lead - 1.0).argmin())].append(k)
        else:
            groups.append([k])
    return sorted(groups, key=lambda one: float(best[one[0]]))


def _pendulum(solution: CurtainSolution) -> float:
    """The scale of squared frequencies, 1/s2; InputError for a curtain without mass or line loads."""
    problem, S = solution.problem, solution.S
    mass, weight = masses_of(problem).sum(), problem.disc.weight
    if not mesh_masses(problem).any():
        problem.scene.refuse("[curtain] areal_mass = 0: a curtain without mass has no modes")
    carried = float(weight @ (S[:, 0] + S[:, 2])) / problem.mesh.size
    if carried <= solution.noise:
        problem.scene.refuse("[load]: no line loads hold the curtain, so that it has no modes")
    return 2.0 * carried / float(mass * problem.mesh.size)


def _roughness(solution: CurtainSolution, shapes: Array) -> Array:
    """Energy of what gradients averaged at the nodes differ by from those in the cells, over that of shapes (k, n, 3).

    Of a smooth shape it is by how much the mesh makes the square of its frequency too large, to fourth order (A. Naga,
    Z. Zhang and A. Zhou, doi 10.1137/050640588).
    """
    disc, S = solution.problem.disc, solution.problem.disc.cell_mean(solution.S)
    S = disc.cell_area[:, None, None] * S[:, SQUARE]
    slope = np.einsum("kcna,cni->ckai", shapes[:, disc.cell_dofs], disc.grad[: disc.n_cells])
    each = np.repeat(slope[:, None], 3, axis=1)
    away = mean_at_corners(disc.cell_dofs, slope, disc.cell_area)[disc.cell_dofs] - each
    middle = 0.5 * (away + np.roll(away, 1, axis=1))  # of the sides, where squares of what is linear are integrated
    lacking, stored = (np.einsum("cmkai,cij,cmkaj->k", e, S, e, optimize=True) for e in (middle, each))
    return np.asarray(lacking / stored)


def _across(solution: CurtainSolution) -> sparse.csc_matrix:
    """T (3 n_nodes, n) of motions across the plane."""
    problem = solution.problem
    scene = replace(problem.scene, solver=replace(problem.scene.solver, space=True))
    supports = build_supports(scene, problem.mesh, problem.disc)
    T = sparse.csc_matrix(sparse.eye(len(supports.mask)) if supports.bars is None else supports.bars)
    moves = ~supports.mask[:, 2] & (np.diff(T.indptr) > 0)
    return sparse.csc_matrix(sparse.kron(T[:, np.flatnonzero(moves)], [[0.0], [0.0], [1.0]]))


def _of_one_component(solution: CurtainSolution) -> tuple[sparse.spmatrix, ...]:
    """The geometric stiffness, N/mm, and consistent and lumped masses, N s2/mm, (n_nodes, n_nodes); of straight bars,
    which mix the motions of their nodes, both are consistent."""
    problem, disc = solution.problem, solution.problem.disc
    A = np.where(_carries(solution)[:, None], solution.S, 0.0)[:, SQUARE][:, None, :, None, :]
    pattern = SparsityPattern.of(disc, 1, np.ones(disc.n_nodes, bool))
    element, mass = ELEMENTS[disc.element][0](), skfem.models.poisson.mass
    own, unit = mesh_masses(problem), mass.assemble(skfem.CellBasis(problem.mesh.mesh, element))
    M, lumped = own.sum() / unit.sum() * unit, sparse.diags(own)
    for bar in problem.scene.of(Bar):
        facets = problem.mesh.edges[bar.edge]
        along = mass.assemble(skfem.FacetBasis(problem.mesh.mesh, element, facets=facets))
        along = TONNE * bar.mass / along.sum() * along
        M, lumped = M + along, lumped + (along if bar.straight else sparse.diags(along @ np.ones(len(own))))
    return stiffness(disc, pattern, A), M, lumped


def _carries(solution: CurtainSolution) -> np.ndarray:
    """Which points carry load; others have no stiffness, not that of the tension that makes slack shapes unique."""
    size = solution.S[:, 0] + solution.S[:, 2]
    return np.asarray(size > MODES.carries * size.max(initial=0.0))


def _constraints(solution: CurtainSolution, T: sparse.csc_matrix) -> sparse.csr_matrix:
    """Rows P:grad w, of line loads P = F S averaged over neighbours and summed at the nodes, on the unknowns, each of
    length 1.

    Of the points alone there are more than unknowns, and line loads that differ from cell to cell lock them.
    """
    disc, P = solution.problem.disc, solution.F @ np.where(_carries(solution)[:, None], solution.S, 0.0)[:, SQUARE]
    P = recovered(solution.problem.mesh.mesh.t.T, disc.cell_mean(P), disc.cell_area) * disc.cell_area[:, None, None]
    values = np.einsum("naB,nkB->nka", P, disc.grad[: disc.n_cells])
    values = np.repeat(values[:, None], disc.cell_dofs.shape[1], axis=1)
    row = np.broadcast_to(disc.cell_dofs[:, :, None, None], values.shape)
    column = np.broadcast_to(3 * disc.cell_dofs[:, None, :, None] + np.arange(3), values.shape)
    shape = (disc.n_nodes, 3 * disc.n_nodes)
    C = sparse.csr_matrix((values.ravel(), (row.ravel(), column.ravel())), shape=shape)
    length = sparse.linalg.norm(C, axis=1)
    which = np.flatnonzero(length > MODES.carries * length.max(initial=0.0))
    return sparse.csr_matrix(sparse.diags(1.0 / length[which]) @ C[which] @ T)


def _solver(A: sparse.spmatrix, C: sparse.spmatrix) -> Callable[[Array], Array]:
    """The function that gives u of A u + C^T y = b, C u = 0; constraints that repeat each other do no harm."""
    m = C.shape[0]
    size = float(abs(A.diagonal()).max())
    whole = sparse.bmat([[A, size * C.T], [size * C, -MODES.rounding * size * sparse.eye(m)]], format="csc") if m else A
    lu = splu(sparse.csc_matrix(whole))
    return lambda b: np.asarray(lu.solve(np.concatenate([b.ravel(), np.zeros(m)]))[: b.size])


def run_modes(
    scene_path: Path,
    law_path: Path | None,
    out: Path,
    *,
    number: int = 6,
    picture: bool = True,
    report: Path | None = None,
) -> ModesSummary:
    """Find natural frequencies of the scene in a file, write modes.json, modes.vtu and modes.png; the summary.

    Line loads are those of elastic rings where rigid ones leave them open. InputError in one sentence for what cannot
    be read or told, NotConverged where the curtain at rest is none, NotDrawn, with all else in place, for the picture.
    """
    scene, law, inputs = read_job(scene_path, law_path, out, RECORD)
    Pictures(picture, report=report, stem="modes").check(scene, inputs, in_space=True)
    found = solve_membrane(scene_at(scene, 0.0), law).loaded
    modes, problem = find_modes(found, number), found.problem
    summary = ModesSummary(
        frequencies_Hz=modes.frequencies_Hz.tolist(),
        multiplicity=modes.multiplicity.tolist(),
        left_out=modes.left_out + ("; the partial factors of [[combination]]" if scene.combination else ""),
        loads=loads_in_words(problem.scene),
        time_s=None if scene.motion is None else 0.0,
        forces_by=forces_by(found),
        cells=problem.disc.n_cells,
        notes=problem.notes,
        law=problem.law.name,
        wall_s=found.wall_s,
        versions=versions("scikit-fem", "scikit-sparse"),
    )
    with job(out, RECORD, summary, inputs) as folder:
        write_shapes(folder / "modes.vtu", modes)
    drawings: Drawings = {"modes.png": lambda path: draw_shapes(path, modes)} if picture else {}
    if report is not None:
        from macro_fem.motion_report import write_modes_report

        def draw(width: float) -> Figure:
            return plans.printed(plot_shapes(modes, REPORTED), width, width, _captions(modes)[:REPORTED])

        told = str(report.absolute())
        drawings[told] = lambda path: write_modes_report(path, scene, summary, draw, inputs)
    draw_all(out, RECORD, summary, drawings, inputs)
    return summary


def write_shapes(path: Path, modes: Modes) -> None:
    """Each shape as point data `shape_1_FREQUENCY_Hz` and so on, on the curtain at rest, as VTU."""
    import meshio

    mesh, rest = modes.solution.problem.mesh.mesh, padded(modes.solution.corners)
    names = [f"shape_{k}_{one:.5g}_Hz" for k, one in enumerate(modes.frequencies_Hz, 1)]
    fields = dict(zip(names, modes.shapes[:, : len(rest)], strict=True))
    cells = [("triangle", counterclockwise(mesh.p.T, mesh.t.T))]
    write_mesh_file(path, meshio.Mesh(rest, cells, point_data=fields))


def plot_shapes(modes: Modes, most: int) -> Plotter:
    """At most so many shapes side by side, each at `SHOWN` of the size of the curtain."""
    problem, rest = modes.solution.problem, padded(modes.solution.corners)
    cells = counterclockwise(problem.mesh.mesh.p.T, problem.mesh.mesh.t.T)
    shapes = modes.shapes[:most, : len(rest)]
    plotter, scale = new_plotter(len(shapes)), Scale("displacement over the largest", 0.0, 1.0, 1.0)
    for panel, shape in enumerate(shapes):
        plotter.subplot(0, panel)
        drawn = surface(rest + SHOWN * problem.mesh.size * shape, cells)
        drawn[scale.label] = np.linalg.norm(shape, axis=1)
        add(plotter, f"shape {panel + 1}", drawn, scale)
        add_supports(plotter, modes.solution, problem.mesh.size)
        add_length(plotter, rest, problem.mesh.size)
        look(plotter, THREE_QUARTERS)
    return plotter


def draw_shapes(path: Path, modes: Modes) -> None:
    """The shapes side by side beneath their frequencies, as PNG."""
    plotter = plot_shapes(modes, len(modes.shapes))
    save_picture(path, plotter, "natural frequencies and their shapes", _captions(modes))


def _captions(modes: Modes) -> list[str]:
    each = enumerate(zip(modes.frequencies_Hz, modes.multiplicity, strict=True), 1)
    return [f"{k}: {one:.3g} Hz{f' ({count} modes)' if count > 1 else ''}" for k, (one, count) in each]
