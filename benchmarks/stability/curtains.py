"""Curtains of extreme shape, mesh, support, load and stiffness, with the condition numbers of their last matrices."""

import tempfile
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse.linalg import splu

from benchmarks.problems import square
from benchmarks.report.measure import Row, at_most, count_of
from benchmarks.report.records import Section, table
from homogenize.io import default_law
from homogenize.laws.polyhedral import PolyhedralLaw
from homogenize.laws.protocol import MembraneLaw
from macro_fem.curtain import solve_problem
from macro_fem.fem.assembly import stiffness
from macro_fem.fem.supported import SupportedFem
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.schema import Scene, read_scene
from macro_fem.solution import CurtainSolution, make_problem
from rve.common.errors import InputError

BLOCK = 256
STIFFNESSES = tuple(10.0**e for e in range(0, 10))
HOLES = [[[20.0, 20.0], [40.0, 20.0], [30.0, 45.0]], [[60.0, 50.0], [80.0, 50.0], [80.0, 80.0], [60.0, 80.0]]]
STATUS, HEIGHT = "status or message", "mean height, mm"
FORMS = {"unbalanced": "at_most 1e-12", "gap / (load times size)": "at_most 1e-12", HEIGHT: ".5g"}


@dataclass(frozen=True, eq=False)
class Watched(SupportedFem):
    """A supported discretisation that keeps the tangent of its last factorisation in `seen`."""

    seen: list[Any] = field(default_factory=list)

    def factorize(self, tangent: Any, nodal: Any = None) -> Any:
        """The factor; the tangent is kept."""
        self.seen[:] = [tangent]
        return super().factorize(tangent, nodal)


def condition_numbers(fem: Watched) -> tuple[float, float]:
    """One-norm condition numbers of the last matrix, and of the same scaled to unit diagonal."""
    if not fem.seen or fem.tie is not None:
        return np.nan, np.nan
    A = fem.pattern.full(stiffness(fem.disc, fem.pattern, fem.seen[0])).tocsc()
    scale = 1.0 / np.sqrt(A.diagonal())
    scaled = A.multiply(scale[:, None]).multiply(scale[None, :]).tocsc()
    return _condition(A), _condition(scaled)


def _condition(A: Any) -> float:
    try:
        factor = splu(A)
    except RuntimeError:  # exactly singular
        return np.inf
    with np.errstate(all="ignore"):
        return float(np.abs(A).sum(axis=0).max()) * _inverse_norm(factor, A.shape[0])


def _inverse_norm(factor: Any, n: int) -> float:
    """The one-norm of the inverse, exact: the usual estimate is random in its last digit."""
    largest = 0.0
    for first in range(0, n, BLOCK):
        columns = np.zeros((n, min(BLOCK, n - first)))
        columns[first : first + BLOCK] = np.eye(columns.shape[1])
        largest = max(largest, float(np.abs(factor.solve(columns)).sum(axis=0).max()))
    return largest


def scene(curtain: dict[str, Any] | None = None, kind: str = "rigid", cells: int = 12, **more: Any) -> Scene:
    """A square of 100 mm, or another shape, with these keys of [curtain]; hung by both top corners unless `more` tables
    say otherwise.
    """
    tables = square(cells, {"kind": "corners", "gather": 0.9}, 100.0, solver={"kind": kind})
    whole = curtain if curtain and "shape" in curtain else tables["curtain"] | (curtain or {})
    source = more.pop("source", "scene")
    return read_scene(tables | {"curtain": whole} | more, source)


def solved(given: Scene, law: MembraneLaw) -> tuple[CurtainSolution, Watched]:
    """The curtain and what was factorised last."""
    problem = make_problem(given, law, build_mesh(given, law.cell))
    parts = {f.name: getattr(problem.fem, f.name) for f in fields(SupportedFem)}
    fem = Watched(**parts)
    return solve_problem(replace(problem, fem=fem)), fem


def row(name: str, given: Scene, law: MembraneLaw) -> Row:
    """One curtain: its answer, or the sentence that says why there is none."""
    row: Row = {"curtain": name, "solver": given.solver.kind}
    try:
        found, fem = solved(given, law)
    except InputError as error:
        return row | {STATUS: str(error)}
    raw, scaled = condition_numbers(fem)
    load = float(np.abs(found.problem.force).sum()) * found.problem.mesh.size
    is_answer = found.status == "converged"
    gap = (found.primal - found.dual) / load if load > 0.0 and is_answer else None
    return row | {
        STATUS: found.status if is_answer else f"{found.status}: {found.message}",
        "cells": found.problem.disc.n_cells,
        "iterations": found.iterations,
        "unbalanced": found.residual if is_answer else None,
        "gap / (load times size)": gap if gap is None else max(0.0, gap),
        HEIGHT: found.mean_height() if is_answer else None,
        "condition, 1e": _exponent(raw),
        "of the scaled matrix, 1e": _exponent(scaled),
    }


def _exponent(x: float) -> str:
    """The nearest power of ten; numbers beyond 1e17 are round-off."""
    if not np.isfinite(x):
        return "-"
    return str(round(np.log10(x))) if x < 1e17 else "> 17"


def sliver_mesh(folder: Path, ratio: float) -> str:
    """A mesh file of triangles `ratio` times as wide as high, 8 by 8 of them in a rectangle; its name."""
    import meshio
    import skfem

    mesh = skfem.MeshTri.init_tensor(np.linspace(0.0, 100.0, 9), np.linspace(0.0, 100.0 / ratio, 9))
    path = folder / f"slivers_{ratio:.0f}.vtu"
    meshio.Mesh(np.column_stack([mesh.p.T, np.zeros(mesh.p.shape[1])]), [("triangle", mesh.oriented().t.T)]).write(path)
    return path.name


def shapes(kind: str, folder: Path) -> dict[str, Scene]:
    """Every extreme of shape, support and load by name, for one kind of solver."""
    top: dict[str, Any] = {"support": {"kind": "top"}}
    still = {"gravity": 0.0}
    scenes = {
        "ribbon 1 : 1000, hanging": scene({"width": 1.0, "height": 1000.0}, kind, 1, **top),
        "ribbon 1000 : 1, held along its top": scene({"width": 1000.0, "height": 1.0}, kind, 400, **top),
        "one cell": scene(kind=kind, cells=1),
        "gathered to 2 %": scene(kind=kind, support={"kind": "top", "gather": 0.02}),
        "no gravity, no load": scene(kind=kind, load=still),
        "no gravity, drawn by supports": scene(kind=kind, load=still, support={"kind": "corners", "gather": 1.3}),
        "two holes": scene({"holes": HOLES}, kind),
    }
    for gather in (1.5, 1.58, 1.6, 3.0):
        support = {"kind": "corners", "gather": gather}
        scenes[f"corners drawn apart to {gather:g}"] = scene(kind=kind, support=support)
    for force in (1e-6, 1.0, 1e6):
        pull = {"gravity": 9.81, "point": [{"at": [50.0, 0.0], "force": [0.0, -force]}]}
        scenes[f"a point load of {force:g} N"] = scene(kind=kind, load=pull)
    for ratio in (10.0, 1000.0):
        file = {"shape": "file", "file": sliver_mesh(folder, ratio)}
        scenes[f"triangles {ratio:g} : 1"] = scene(file, kind, source=folder / "scene.toml", mesh={}, **top)
    return scenes


def stiffness_rows(law: PolyhedralLaw) -> list[Row]:
    """One elastic curtain over nine decades of stiffness in N/mm, and the rigid one, which is its limit."""
    laws = {size: replace(law, stiffness=size * np.eye(3)) for size in STIFFNESSES}
    rows = [row(f"rings of {size:.0e} N/mm", scene(kind="elastic"), stiff) for size, stiff in laws.items()]
    return [*rows, row("ideal locking", scene(), law)]


def measure(full: bool) -> Section:
    """All extremes by both solvers, and nine decades of stiffness."""
    law = default_law()
    if not isinstance(law, PolyhedralLaw):
        raise TypeError(f"the default law is {law.name}, not polyhedral")
    with tempfile.TemporaryDirectory() as folder:
        kinds = [shapes(kind, Path(folder)) for kind in ("rigid", "elastic")]
        rows = [row(name, given, law) for scenes in kinds for name, given in scenes.items()]
        for one in rows:
            one[STATUS] = one[STATUS].replace(f"{folder}/", "")
    springs = stiffness_rows(law)
    text = (
        "A square of 100 mm of the default rings (r1/r2 = 10) hung by two corners at 90 % of its width, 12 cells "
        "wide, unless the row says otherwise. `rigid` is ideal locking, `elastic` the elastic law at 1000 N/mm. "
        "Condition numbers are in the one-norm, of the last matrix that the interior-point iteration has factorised, "
        "and of the same scaled to unit diagonal. Close to a rigid answer the tangents of taut and slack cells differ "
        "by 16 orders of magnitude. A scene has one material; stiffness is varied from run to run."
    )
    tables = (table("Extremes", rows, FORMS), table("Nine decades of stiffness", springs, FORMS))
    return Section("Curtains: shape, mesh, load, stiffness", text, tables, (), conclusion(rows, springs))


def conclusion(rows: list[Row], springs: list[Row]) -> str:
    """What the numbers say."""
    rest = [f"{row['curtain']} ({row['solver']})" for row in rows if row[STATUS] != "converged"]
    off = abs((springs[-2].get(HEIGHT) or 0.0) - (springs[-1].get(HEIGHT) or 0.0))
    return (
        f"{count_of([row[STATUS] == 'converged' for row in rows])} extreme curtains converge; the others end with a "
        f"message: {'; '.join(rest) or 'none'}. {count_of([row[STATUS] == 'converged' for row in springs[:-1]])} "
        f"stiffnesses converge, and the mean height of the stiffest is within {at_most(off, 1e-6)} mm of ideal locking."
    )
