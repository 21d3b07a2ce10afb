"""The exported user material inside CalculiX: one element, the deck of the how-to page, a strip of triangles."""

import os
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

import homogenize
from homogenize.export import umat_source
from homogenize.laws import polyhedral_law
from rve.common import Array

from .conftest import disc_grid

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif("CALCULIX" not in os.environ, reason="CALCULIX is not the folder made by .ci/calculix"),
]
HOW_TO = Path(__file__).parents[2] / "docs" / "how_to.md"
RINGS = """\
*MATERIAL, NAME=ABAQUSNL_RINGS
*USER MATERIAL, CONSTANTS=3
1., 1., {slack}
*DENSITY
{density:.15g}
*SOLID SECTION, ELSET=SHEET, MATERIAL=ABAQUSNL_RINGS
1.
"""
STEP = """\
*STEP, NLGEOM, INC=100
*STATIC
1., 1.
*CONTROLS, PARAMETERS=FIELD
1e-9, 1e-9, 0.01,,, 1e-9
*CONTROLS, PARAMETERS=TIME INCREMENTATION
8, 40, 9, 100, 20, 4,, 5
"""
PRINT = "*NODE PRINT, NSET=NALL\nU, RF\n*END STEP\n"


@pytest.fixture(scope="module")
def law():
    """The shipped law on 49 half-spaces: Newton's method of CalculiX has no line search and cycles on thousands."""
    rings = homogenize.default_law()
    S = disc_grid(4, 12)
    return polyhedral_law(S, rings.support(S), rings.stiffness, rings.cell)


@pytest.fixture(scope="module")
def solver(law, tmp_path_factory):
    """CalculiX linked with the exported material."""
    built, here = Path(os.environ["CALCULIX"]), tmp_path_factory.mktemp("ccx")
    (here / "umat.f").write_text(umat_source(law, "test"))
    for command in (
        "gfortran -O1 -std=legacy -w -c umat.f",
        f"gfortran -fopenmp -o ccx {built}/main.o umat.o {built}/ccx.a -lspooles -larpack -llapack -lblas -lpthread",
    ):
        subprocess.run(command.split(), cwd=here, check=True, capture_output=True)
    return here / "ccx"


def run(solver, deck: str, folder: Path) -> tuple[Array, Array]:
    """Displacements and internal forces (n, 3) at the end of the deck."""
    (folder / "job.inp").write_text(deck)
    done = subprocess.run([solver, "job"], cwd=folder, capture_output=True, text=True)
    assert "Job finished" in done.stdout, done.stdout[-1000:]
    rows = [line.split() for line in (folder / "job.dat").read_text().splitlines()]
    blocks = [np.array(b, float) for b in _blocks(rows)]
    return blocks[-2][:, 1:], blocks[-1][:, 1:]


def _blocks(rows):
    """Runs of rows of four numbers."""
    block = []
    for row in [*rows, ["end"]]:
        if len(row) == 4 and row[0].isdigit():
            block.append(row)
        elif row and block:
            yield block
            block = []


def mesh(X: Array, cells: Array) -> str:
    """Nodes and triangles in plane stress, counter-clockwise."""
    a, b = X[cells[:, 1]] - X[cells[:, 0]], X[cells[:, 2]] - X[cells[:, 0]]
    cells = np.where((a[:, 0] * b[:, 1] < a[:, 1] * b[:, 0])[:, None], cells[:, ::-1], cells)
    nodes = "".join(f"{i + 1}, {x:.15g}, {y:.15g}, 0.\n" for i, (x, y) in enumerate(X))
    triangles = "".join(f"{i + 1}, {', '.join(map(str, cell + 1))}\n" for i, cell in enumerate(cells))
    return f"*NODE, NSET=NALL\n{nodes}*ELEMENT, TYPE=CPS3, ELSET=SHEET\n{triangles}"


def internal_forces(law, X: Array, cells: Array, x: Array) -> Array:
    """Forces (n, 2) in N of linear triangles that are drawn from X to x (n, 2), by our own law."""
    dX, dx = (np.stack([y[cells[:, k]] - y[cells[:, 0]] for k in (1, 2)], axis=2) for y in (X, x))
    B = np.linalg.inv(dX)
    F = dx @ B
    C = np.swapaxes(F, 1, 2) @ F
    S = law.response(0.5 * (C[:, [0, 0, 1], [0, 1, 1]] - [1.0, 0.0, 1.0])).S[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    gradients = np.stack([-B.sum(axis=1), B[:, 0], B[:, 1]], axis=1)
    out = np.zeros_like(X)
    np.add.at(out, cells, 0.5 * np.abs(np.linalg.det(dX))[:, None, None] * (gradients @ np.swapaxes(F @ S, 1, 2)))
    return out


def test_one_element_under_any_deformation_and_rotation(solver, law, tmp_path):
    rng = np.random.default_rng(7)
    X, cells = np.array([[0.0, 0.0], [100.0, 0.0], [20.0, 80.0]]), np.array([[0, 1, 2]])
    for _ in range(20):
        angle = rng.uniform(-1.5, 1.5)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        F = turn @ (np.diag(rng.uniform(1.0, 1.6, 2)) + rng.uniform(-0.2, 0.2, (2, 2)))
        u = X @ F.T - X
        held = "".join(f"{i + 1}, {k + 1}, {k + 1}, {u[i, k]:.15g}\n" for i in range(3) for k in range(2))
        deck = mesh(X, cells) + RINGS.format(slack=0, density=1e-9) + STEP + "*BOUNDARY\n" + held + PRINT
        f = run(solver, deck, tmp_path)[1][:, :2]
        ours = internal_forces(law, X, cells, X + u)
        assert np.abs(ours).max() > 1.0
        assert np.abs(f - ours).max() < 1e-6 * np.abs(ours).max()


def test_the_deck_of_the_how_to_page(solver, law, tmp_path):
    deck = next(text for text in HOW_TO.read_text().split("```\n") if text.startswith("*NODE"))
    density = f"{law.cell.areal_mass_kg_per_m2 * 1e-9:.9E}"
    assert density in umat_source(law)
    _, f = run(solver, re.sub(r"(?<=\*DENSITY\n).*", density, deck), tmp_path)
    stretch = np.array([1.15, 1.2])
    E = 0.5 * (stretch**2 - 1.0)
    S = law.response(np.array([[E[0], 0.0, E[1]]])).S[0]
    assert np.allclose(f[1, :2], [500.0 * stretch[0] * S[0], -500.0 * stretch[1] * S[2]], rtol=1e-6)
