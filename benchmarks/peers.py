"""Other programs on what this project solves, side by side in one run: cone programs, locked cells, rings in motion.

A peer that is not installed is left out, and the page says so.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from statistics import median
from time import process_time
from typing import Any, NamedTuple

import numpy as np

from benchmarks.cone_form import ConeForm, by_clarabel, by_qoco, gradient_matrix
from benchmarks.every_ring import engine, let_go
from benchmarks.every_ring.cases import SHEETS
from benchmarks.frame import Section, table
from benchmarks.measure import Row, decade
from benchmarks.problems import square
from benchmarks.work_precision import rve
from homogenize import default_law
from macro_fem import Motion, read_scene
from macro_fem.curtain import gathered_start, make_problem, solve_problem, stabilising_tension
from macro_fem.motion.rings import MovingRings
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.solvers import PathOptions, Terms, load_scale
from macro_fem.solvers.central_path import solve_path

TIMES, GAP = 3, 1e-9
"""Runs of each program, in turn; relative gap and residuals that all solvers of cone programs are asked for."""
CELLS = 16, 32
"""Cells along a corner-hung square metre; the full report has 50 as well."""
MU, TOLERANCE = 1e-11, 1e-14
"""Complementarity of our direct solver; tolerance of SLSQP."""
PEERS = {
    "clarabel": (
        "clarabel",
        "cones of other kinds (exponential, power, semidefinite), any quadratic objective",
        "half-spaces of the law are found on the way; the answer lies inside the whole law",
    ),
    "qoco": (
        "QOCO",
        "writes C code for small programs of one pattern, for controllers",
        "the same; and a certificate where there is no admissible state",
    ),
    "scipy": (
        "SciPy SLSQP",
        "any smooth function and constraint",
        "a fixed Cauchy load, which has no potential; contacts found on the way; loads in batches; rings stay linked",
    ),
    "": ("scheme of the paper", "motion in time, damping, friction", "rigid contact, contact forces"),
    "mujoco": (
        "MuJoCo",
        "joints, motors, friction, other bodies, in real time",
        "true tori that do not overlap; energy that is accounted for",
    ),
    "newton": (
        "Newton",
        "thousands of scenes at once on graphics cards, derivatives with respect to the scene",
        "the same",
    ),
}
"""How the page calls the program of a package, what it does that ours does not, and ours that it does not."""
LEFT_OUT = """Not run: Yade and Siconos (no wheels). Of a neo-Hookean sheet the
tree has no assembly of its own beside which scikit-fem's could be put."""


class Timed(NamedTuple):
    """What a program found at last, and its median seconds."""

    found: Any
    seconds: float


def in_turn(programs: dict[Any, Callable[[], Any]]) -> dict[Any, Timed]:
    """Each program `TIMES` times, all in turn, by processor time; a `Fallen` of an engine has its own."""
    found: dict[Any, Any] = {}
    seconds: dict[Any, list[float]] = {name: [] for name in programs}
    for _ in range(TIMES):
        for name, program in programs.items():
            began = process_time()
            found[name] = program()
            own = found[name].seconds if isinstance(found[name], engine.Fallen) else process_time() - began
            seconds[name].append(own)
    return {name: Timed(found[name], median(seconds[name])) for name in programs}


def row(of: str, peer: str, ours: float, theirs: float, told: tuple[str, str, str]) -> Row:
    """A row: times, their ratio, what both found and how far apart that is."""
    both = dict(zip(("found by ours", "found by the peer", "apart"), told, strict=True))
    return {"of": of, "peer": peer, "ours, s": ours, "theirs, s": theirs, "theirs over ours": theirs / ours} | both


def is_here(package: str) -> bool:
    """Whether a peer is installed."""
    return not package or find_spec(package) is not None


def cone_programs(cells: int) -> list[Row]:
    """The program of the half-spaces at the end of a corner-hung square metre, and ours with them still to be found."""
    scene, law = read_scene(square(cells)), default_law()
    problem = make_problem(scene, law, build_mesh(scene, law.cell))
    fem, size = problem.fem, problem.mesh.size
    load = fem.gather(problem.force) + fem.force(stabilising_tension(problem) * problem.frame)
    total, start = load_scale(load, fem.disc.weight), fem.unknowns(gathered_start(problem))
    cones = solve_problem(problem).cones
    form, terms = ConeForm(fem, cones, size, gradient_matrix(fem)), Terms(walls=problem.walls)
    q = -load / total
    solve = partial(solve_path, fem, problem.law, load, start, size, terms=terms)
    programs: dict[str, Callable[[], Any]] = {
        "given": partial(solve, PathOptions(gap=GAP, cones=cones)),
        "found on the way": partial(solve, PathOptions(gap=GAP)),
    }
    peers = {"clarabel": by_clarabel, "qoco": by_qoco}
    programs |= {name: partial(call, form, q, GAP) for name, call in peers.items() if is_here(name)}
    done, rows = in_turn(programs), []
    for name in filter(done.__contains__, peers):
        x, end = done[name].found
        theirs = -float(load @ x) * size
        for which in ("given", "found on the way"):
            ours = done[which].found
            apart = f"{decade(abs(theirs - ours.primal) / (total * size), 1e-12)} of load times size"
            told = f"{ours.primal:.6f} N mm, {ours.status}, {ours.iterations} steps", f"{theirs:.6f} N mm, {end}", apart
            of = f"curtain, {fem.disc.n_cells:,} cells, {len(cones):,} half-spaces {which}"
            rows.append(row(of, titled(name), done[which].seconds, done[name].seconds, told))
    return rows


def titled(package: str) -> str:
    """How the page calls a peer, with its version."""
    return f"{PEERS[package][0]} {version(package)}" if package else PEERS[package][0]


def locked_cells() -> list[Row]:
    """Locked strains at r1/r2 = 10: six loads by the scheme of the paper and by SLSQP."""
    six, rows = rve.problem(), []
    cases: dict[tuple[str, str], Callable[[], rve.Answer]] = {("", ""): partial(rve.scheme, six, rve.PUBLISHED)}
    cases |= {("scipy", f", {start} start"): partial(rve.generic, six, TOLERANCE, start) for start in ("near", "slack")}
    for (package, start), call in cases.items():
        done = in_turn({"ours": partial(rve.direct, six, MU), "theirs": call})
        judged = [right(six, done[name].found) for name in ("ours", "theirs")]
        told = [f"{good.sum()} of {len(good)} loads, {decade(error)} off" for good, error in judged]
        both = judged[0][0] & judged[1][0] & six.unique
        away = np.abs(done["ours"].found.E - done["theirs"].found.E)[both].max()
        seconds = done["ours"].seconds, done["theirs"].seconds
        of = f"strains of a cell under {len(six.s)} loads{start}"
        rows.append(row(of, titled(package), *seconds, (*told, f"{decade(away)} of strain where both end")))
    return rows


def right(given: rve.Problem, answer: rve.Answer) -> tuple[np.ndarray, float]:
    """Which loads a method solved, near the reference where it is unique, and its largest error there."""
    error = np.where(given.unique, np.abs(answer.E - given.E).max(axis=1), 0.0)
    good = answer.good & (error < rve.FOUND)
    return good, float(error[good].max())


def rings_in_motion(k: int, count: int) -> list[Row]:
    """Every ring of a sheet of which a corner is let go, by each engine with `count` of its steps."""
    scene = let_go.motion_scene(let_go.SCENES[0], k)
    begun = MovingRings(replace(scene, motion=Motion(let_go.STEP, let_go.STEP))).solve()
    programs: dict[Any, Callable[[], Any]] = {
        (name, dt): partial(engine.fall, begun, let_go.DURATION, name, dt)
        for name, steps in engine.STEPS.items()
        for dt in steps[:count]
        if is_here(name)
    }
    done = in_turn({"ours": MovingRings(scene).solve} | programs)
    mine = np.array([frame.row for frame in done["ours"].found.frames])[:, let_go.MEAN]
    height, rows = SHEETS[0].sides(k)[1], []
    for name, dt in programs:
        fallen = done[name, dt].found
        away = np.linalg.norm(fallen.mean - mine - (fallen.mean - mine)[0], axis=1).max()
        told = (
            f"mean place falls {mine[0, 1] - mine[-1, 1]:.2f} mm",
            f"{fallen.mean[0, 1] - fallen.mean[-1, 1]:.2f} mm, least gap {fallen.least_gap:+.4f} r1",
            f"{away / height:.2%} of the height at most",
        )
        of = f"{len(begun.frames[0].rings.centre)} rings, a corner let go, {let_go.DURATION:g} s; step {dt:g} of theirs"
        rows.append(row(of, titled(name), done["ours"].seconds, fallen.seconds, told))
    return rows


def measure(full: bool) -> Section:
    """The section; `full` has larger curtains and sheets."""
    rows = [one for cells in (*CELLS, *(50,) * full) for one in cone_programs(cells)] + locked_cells()
    rows += rings_in_motion(2 if full else 1, 1 + full)
    missing = ", ".join(f"{PEERS[name][0]} (`pip install {name}`)" for name in PEERS if not is_here(name))
    left_out = f"Left out, as not installed: {missing}. " * bool(missing) + LEFT_OUT
    ratios = [one["theirs over ours"] for one in rows]
    slow, quick = (rows[ratios.index(pick(ratios))] for pick in (max, min))
    ends = [f"{one['theirs over ours']:.2f} ({one['peer']}, {one['of']})" for one in (quick, slow)]
    told = f"Their times over ours: {' to '.join(ends)}; {sum(x < 1.0 for x in ratios)} of {len(ratios)} are below 1."
    heads = "peer", "what it does that ours does not", "what ours does that it does not"
    words = [dict(zip(heads, PEERS[name], strict=True)) for name in PEERS if is_here(name)]
    forms = {"theirs over ours": ".2f", "ours, s": ".3g", "theirs, s": ".3g"}
    return Section("", TEXT, (table("", rows, forms), table("", words, {}, left_out)), conclusion=told)


TEXT = f"""Medians of {TIMES} runs, all programs of a problem in turn, processor seconds on one thread.

* **curtain**: a square metre hung by two corners, the shipped law of rings, gap {GAP:g}. Peers get the half-spaces that
  our answer ends with, and their matrices ready made. Ours gets them too (*given*), or finds them by asking the law
  (*found on the way*). Found: the potential, a constant apart. A peer does not look at the rest of the law.
* **strains**: 4-in-1, r1/r2 = 10, our direct solver with all loads in one batch. The scheme is as published; SLSQP has
  exact derivatives and the second Piola-Kirchhoff load of our answer, and starts near that or from the slack pose.
* **rings**: BDF2 steps of {1e3 * let_go.STEP:g} ms of ours, distances from where each began. {engine.TEXT}"""
