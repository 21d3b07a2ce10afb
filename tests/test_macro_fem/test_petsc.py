"""PETSc's factor and multigrid give the curtain of SuperLU, on one process and on two."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("mpiexec") is None, reason="no MPI here"),
]
ROOT = Path(__file__).parents[2]
CODE = """
import json
from dataclasses import replace
from homogenize import default_law
from macro_fem import Scene
from macro_fem.curtain import solve_problem
from macro_fem.fem.petsc import processes
from macro_fem.scene.mesh import build_mesh
from macro_fem.solution import make_problem
scene = Scene.rectangle(1000.0, 1000.0, cells=12).hung_by("corners", gather=0.95)
scene = replace(scene, solver=replace(scene.solver, kind={kind!r}))
law = default_law()
problem = make_problem(scene, law, build_mesh(scene, law.cell))
found = solve_problem(replace(problem, fem=replace(problem.fem, method={method!r})))
method = found.problem.fem.solver.method
told = [*processes(), found.status, method, found.mean_height(), found.primal]
open(f"{out}/{{told[0]}}.json", "w").write(json.dumps(told))
"""


def answers(out, kind, method, processes=2):
    """What each process of an MPI run answers: rank, number, status, method, mean height, potential."""
    pytest.importorskip("petsc4py")
    allow = {f"OMPI_ALLOW_RUN_AS_ROOT{more}": "1" for more in ("", "_CONFIRM")}
    allow |= {"OMPI_MCA_rmaps_base_oversubscribe": "1", "OMPI_MCA_mpi_yield_when_idle": "1"}
    environment = os.environ | allow | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    out.mkdir()
    code = CODE.format(out=out, kind=kind, method=method)
    command = ["mpiexec", "-n", str(processes), sys.executable, "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return [json.loads(path.read_text()) for path in sorted(out.iterdir())]


@pytest.mark.parametrize(
    ("kind", "method", "used"),
    [("rigid", "auto", "mumps"), ("elastic", "mumps", "mumps"), ("elastic", "multigrid", "multigrid")],
)
def test_two_processes_give_the_curtain_of_one(tmp_path, kind, method, used):
    ((*_, height, potential),) = answers(tmp_path / "one", kind, "superlu", processes=1)
    found = answers(tmp_path / "two", kind, method)
    assert sorted(rank for rank, *_ in found) == [0, 1]
    for _, number, status, its, one_height, one_potential in found:
        assert (number, status, its) == (2, "converged", used)
        assert one_height == pytest.approx(height, abs=1e-5)
        assert one_potential == pytest.approx(potential, rel=1e-8)
