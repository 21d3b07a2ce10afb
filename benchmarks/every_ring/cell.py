"""A large mesh loaded homogeneously at its edge against the periodic cell: the sanity check of the paper."""

import numpy as np

from benchmarks.every_ring.cases import Array, Case
from benchmarks.frame import Curve, Diagram, Section, table
from benchmarks.measure import Row
from rve import Cell, FiniteMesh, solve_table

DIRECTIONS = [(0.0, beta) for beta in (90.0, 75.0, 60.0, 45.0, 30.0, 20.0, 15.0)]
DIRECTIONS += [(15.0, 60.0), (20.0, 30.0), (30.0, 70.0), (45.0, 20.0), (45.0, 75.0)]
"""alpha and beta in degrees."""
FAR = 4
"""Cells from the edge that count as away from it."""
MIDDLE, OUTER = "error of E in the middle", "error of E in cells on the edge"
AWAY = f"largest error {FAR} or more cells away"


def measure(full: bool) -> Section:
    """The section."""
    size = (12, 10) if full else (6, 4)
    cases = [edge_loaded(*direction, size) for direction in (DIRECTIONS if full else DIRECTIONS[2:3])]
    rows = [case.numbers for case in cases]
    text = (
        f"A mesh of {size[0]} x {size[1]} reference cells in the plane, r1/r2 = 10, no weight. Rings on the boundary "
        "carry the dead forces P N of a homogeneous line load, P = F S with F and S of the periodic cell under the "
        "same load direction (`rve.solve_table`). E of each reference cell follows from the centres of the rings at "
        "its four corners. The error is the largest component of the difference to the periodic cell's E."
    )
    good = [row for row in rows if row["status"] == "converged"]
    conclusion = (
        f"In the middle E is that of the periodic cell to {max(row[MIDDLE] for row in good):.1e} in the worst of "
        f"{len(good)} directions that converge (of {len(rows)}); in cells on the edge it differs by up to "
        f"{max(row[OUTER] for row in good):.1e}."
    )
    forms = {"alpha": "g", "beta": "g", MIDDLE: "decade", OUTER: "decade", AWAY: "decade"}
    curves = tuple(
        Curve(f"{row['alpha']:g}, {row['beta']:g}", tuple(1.0 + np.arange(len(case.arrays["error"]))), tuple(values))
        for row, case in zip(rows, cases, strict=True)
        if len(values := np.maximum(case.arrays["error"], 1e-12))
    )
    labels = "Error of E by distance from the edge", "row of cells from the edge", "error of E"
    diagram = Diagram("edge", *labels, curves)
    return Section("The periodic cell", text, (table("Homogeneous edge load", rows, forms),), (diagram,), conclusion)


def edge_loaded(alpha: float, beta: float, size: tuple[int, int]) -> Case:
    """A mesh of so many cells; array: the largest error of E by rows of cells from the edge."""
    cell = Cell()
    row = solve_table(cell, ([alpha], [beta]))
    mesh = FiniteMesh.rectangle(cell, *size)
    F = np.column_stack([row.x2_mm[0], row.x3_mm[0]]) / mesh.sides
    S11, S12, S22 = row.S[0]
    P = F @ np.array([[S11, S12], [S12, S22]])
    n = len(mesh.X)
    force = np.zeros((n, 3))
    force[:, :2] = edge_forces(mesh, P)
    held = np.zeros((n, 3), dtype=bool)
    held[np.linalg.norm(mesh.X - mesh.X.mean(axis=0), axis=1).argmin()] = True
    found = mesh.solve(force, held, np.column_stack([mesh.X, np.zeros(n)]), space=False)
    E = cell_strains(mesh, found.centre)
    error = np.abs(E - row.E[0]).max(axis=2)
    depth = np.minimum.outer(*(np.minimum(np.arange(k), np.arange(k)[::-1]) for k in error.shape))  # 0 on the edge
    by_row = [float(error[depth == d].max()) for d in range(int(depth.max()) + 1)]
    numbers: Row = {"alpha": alpha, "beta": beta, "status": found.status}
    numbers |= {MIDDLE: by_row[-1], AWAY: max(by_row[FAR:], default=None), OUTER: by_row[0]}
    return Case(numbers, {"error": np.array(by_row)})


def edge_forces(mesh: FiniteMesh, P: Array) -> Array:
    """Forces (n, 2) of the line load P N on the rings of class 0 on the boundary of a rectangle of whole cells."""
    low, high = mesh.X.min(axis=0), mesh.X.max(axis=0)
    force = np.zeros((len(mesh.X), 2))
    for axis in range(2):
        along, pitch = 1 - axis, mesh.sides[1 - axis]
        ends = np.isclose(mesh.X[:, along], low[along]) | np.isclose(mesh.X[:, along], high[along])
        length = np.where(ends, 0.5, 1.0) * pitch
        for value, sign in ((low[axis], -1.0), (high[axis], 1.0)):
            on = np.isclose(mesh.X[:, axis], value) & (mesh.index[:, 0] == 0)
            force[on] += sign * length[on, None] * P[:, axis]
    return force


def cell_strains(mesh: FiniteMesh, centre: Array) -> Array:
    """E (columns, rows, 3) of every reference cell from the centres of the rings at its corners."""
    corner = mesh.index[:, 0] == 0
    ij = mesh.index[corner, 1:] - mesh.index[corner, 1:].min(axis=0)
    x = np.full((*(ij.max(axis=0) + 1), 2), np.nan)
    x[ij[:, 0], ij[:, 1]] = centre[corner, :2]
    d1, d2 = np.diff(x, axis=0) / mesh.sides[0], np.diff(x, axis=1) / mesh.sides[1]
    F1, F2 = 0.5 * (d1[:, :-1] + d1[:, 1:]), 0.5 * (d2[:-1] + d2[1:])
    E11, E22 = 0.5 * ((F1**2).sum(axis=2) - 1.0), 0.5 * ((F2**2).sum(axis=2) - 1.0)
    return np.stack([E11, 0.5 * (F1 * F2).sum(axis=2), E22], axis=2)
