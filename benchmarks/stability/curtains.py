"""Curtains of extreme shape, mesh, support, load and stiffness, with the condition numbers of their last matrices."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse.linalg import splu

from benchmarks.pages.measuring import at_most
from benchmarks.pages.model import Column, Section, Table, Value
from homogenize.law import InputError, MembraneLaw, default_law
from homogenize.polyhedral import PolyhedralLaw
from macro_fem.assembly import stiffness
from macro_fem.fem import SupportedFem
from macro_fem.mesh import build_mesh
from macro_fem.scene import Scene, read_scene
from macro_fem.solution import CurtainSolution, make_problem
from macro_fem.solvers import solve_problem

BLOCK = 256
STIFFNESSES = tuple(10.0**e for e in range(0, 10))
HOLES = [[[20.0, 20.0], [40.0, 20.0], [30.0, 45.0]], [[60.0, 50.0], [80.0, 50.0], [80.0, 80.0], [60.0, 80.0]]]
COLUMNS = (
    Column("curtain"),
    Column("solver"),
    Column("status, or what is said"),
    Column("cells"),
    Column("iterations"),
    Column("unbalanced"),
    Column("gap / (load times size)"),
    Column("mean height, mm", ".5g"),
    Column("condition, 1e"),
    Column("of the scaled matrix, 1e"),
)


@dataclass(frozen=True, eq=False)
class Watched(SupportedFem):
    """A supported discretisation that keeps the tangent of its last factorisation in `seen`."""

    seen: list[Any] = field(default_factory=list)

    def factorize(self, tangent: Any) -> Any:
        """The factor; the tangent is kept."""
        self.seen[:] = [tangent]
        return super().factorize(tangent)


def condition_numbers(fem: Watched) -> tuple[float, float]:
    """One-norm condition numbers of the last matrix as it is, and with its rows and columns scaled to unit "
    "diagonal."""
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
    """The one-norm of the inverse, column by column: the usual estimate is random in its last digit."""
    largest = 0.0
    for first in range(0, n, BLOCK):
        columns = np.zeros((n, min(BLOCK, n - first)))
        columns[first : first + BLOCK] = np.eye(columns.shape[1])
        largest = max(largest, float(np.abs(factor.solve(columns)).sum(axis=0).max()))
    return largest


def scene(curtain: dict[str, Any], kind: str = "rigid", cells: int = 12, **more: Any) -> Scene:
    """A scene with these tables; the support is both top corners unless said otherwise."""
    tables: dict[str, Any] = {
        "curtain": curtain,
        "mesh": {"cells": cells},
        "support": {"kind": "corners", "gather": 0.9},
        "solver": {"kind": kind},
    }
    source = more.pop("source", "scene")
    return read_scene(tables | more, source)


def solved(given: Scene, law: MembraneLaw) -> tuple[CurtainSolution, Watched]:
    """The curtain and what was factorised last."""
    problem = make_problem(given, law, build_mesh(given, law.cell))
    parts = {f.name: getattr(problem.fem, f.name) for f in fields(SupportedFem)}
    fem = Watched(**parts)
    return solve_problem(replace(problem, fem=fem)), fem


def row(name: str, given: Scene, law: MembraneLaw) -> tuple[Value, ...]:
    """One curtain: its answer, or the sentence that says why there is none."""
    try:
        found, fem = solved(given, law)
    except InputError as error:
        return (name, given.solver.kind, str(error), None, None, "-", "-", None, "-", "-")
    raw, scaled = condition_numbers(fem)
    load = float(np.abs(found.problem.force).sum()) * found.problem.mesh.size
    gap = (found.primal - found.dual) / load if load > 0.0 else np.nan
    is_answer = found.status == "converged"
    return (
        name,
        given.solver.kind,
        found.status if is_answer else f"{found.status}: {found.message}",
        found.problem.disc.n_cells,
        found.iterations,
        at_most(max(found.residual, 1e-12)) if is_answer else "-",
        at_most(max(gap, 1e-12)) if is_answer else "-",
        found.mean_height() if is_answer else None,
        _exponent(raw),
        _exponent(scaled),
    )


def _exponent(x: float) -> str:
    """The nearest power of ten; beyond 1e17 it is noise."""
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


def shapes(kind: str, folder: Path) -> list[tuple[str, Scene]]:
    """Name and scene of every extreme of shape, support and load, for one kind of solver."""
    square = {"width": 100.0, "height": 100.0}
    top: dict[str, Any] = {"support": {"kind": "top"}}
    still = {"gravity": 0.0}
    rows = [
        ("ribbon 1 : 1000, hanging", scene({"width": 1.0, "height": 1000.0}, kind, 1, **top)),
        ("ribbon 1000 : 1, held along its top", scene({"width": 1000.0, "height": 1.0}, kind, 400, **top)),
        ("one cell", scene(square, kind, 1)),
        ("gathered to 2 %", scene(square, kind, support={"kind": "top", "gather": 0.02})),
        ("no gravity, nothing pulls", scene(square, kind, load=still)),
        ("no gravity, drawn by supports", scene(square, kind, load=still, support={"kind": "corners", "gather": 1.3})),
        ("two holes", scene(square | {"holes": HOLES}, kind)),
    ]
    for gather in (1.5, 1.58, 1.6, 3.0):
        rows.append(
            (f"corners drawn apart to {gather:g}", scene(square, kind, support={"kind": "corners", "gather": gather}))
        )
    for force in (1e-6, 1.0, 1e6):
        pull = {"gravity": 9.81, "point": [{"at": [50.0, 0.0], "force": [0.0, -force]}]}
        rows.append((f"a point load of {force:g} N", scene(square, kind, load=pull)))
    for ratio in (10.0, 1000.0):
        one = {"shape": "file", "file": sliver_mesh(folder, ratio)}
        rows.append((f"triangles {ratio:g} : 1", scene(one, kind, source=folder / "scene.toml", mesh={}, **top)))
    return rows


def stiff(law: PolyhedralLaw, size: float) -> PolyhedralLaw:
    """The law with rings of another stiffness, N/mm."""
    return replace(law, stiffness=size * np.eye(3))


def stiffness_rows(law: PolyhedralLaw) -> list[tuple[Value, ...]]:
    """One elastic curtain over nine decades of stiffness, and the rigid one that it tends to."""
    given = scene({"width": 100.0, "height": 100.0}, "newton")
    rows = [row(f"rings of {size:.0e} N/mm", given, stiff(law, size)) for size in STIFFNESSES]
    return [*rows, row("ideal locking", scene({"width": 100.0, "height": 100.0}, "rigid"), law)]


def measure(full: bool) -> Section:
    """All extremes by both solvers, and nine decades of stiffness."""
    law = default_law()
    if not isinstance(law, PolyhedralLaw):
        raise TypeError(f"the default law is {law.name}, not polyhedral")
    with tempfile.TemporaryDirectory() as folder:
        pairs = [one for kind in ("rigid", "newton") for one in shapes(kind, Path(folder))]
        rows = [tuple(_without(folder, cell) for cell in row(name, given, law)) for name, given in pairs]
    springs = stiffness_rows(law)
    return Section(
        "curtains",
        "Curtains: shape, mesh, load, stiffness",
        "A square of 100 mm of the default rings (r1/r2 = 10) hung by two corners at 90 % of its width, 12 cells "
        "wide, unless "
        "said otherwise. `rigid` is ideal locking, `newton` the elastic law at 1000 N/mm. Condition numbers are "
        "in the "
        "one-norm, of the last matrix that the interior-point iteration has factorised, as it is and scaled to unit "
        "diagonal. Close to a rigid answer taut and slack places differ by 16 orders. A scene has one material; "
        "stiffness is varied from run to run.",
        (Table("Extremes", COLUMNS, tuple(rows)), Table("Nine decades of stiffness", COLUMNS, tuple(springs))),
        conclusion=conclusion(rows, springs),
    )


def _without(folder: str, cell: Value) -> Value:
    return cell.replace(f"{folder}/", "") if isinstance(cell, str) else cell


def conclusion(rows: list[tuple[Value, ...]], springs: list[tuple[Value, ...]]) -> str:
    """What the numbers say."""
    good = [r for r in rows if r[2] == "converged"]
    rest = [f"{r[0]} ({r[1]})" for r in rows if r[2] != "converged"]
    soft = [r for r in springs[:-1] if r[2] == "converged"]
    heights = [float(r[7] or 0.0) for r in (springs[-2], springs[-1])]
    off = abs(heights[0] - heights[1])
    return (
        f"{len(good)} of {len(rows)} extreme curtains converge; the others end in a sentence: "
        f"{'; '.join(rest) or 'none'}. "
        f"{len(soft)} of {len(springs) - 1} stiffnesses converge, and the stiffest hangs within "
        f"{at_most(max(off, 1e-6))} mm of "
        "ideal locking."
    )
