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
from macro_fem.scene.meshing.mesh import build_mesh
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
    out.mkdir()
    done = started(["-c", CODE.format(out=out, kind=kind, method=method)], processes)
    assert done.returncode == 0, done.stderr
    return [json.loads(path.read_text()) for path in sorted(out.iterdir())]


def started(arguments, processes):
    """A run of Python on some processes."""
    pytest.importorskip("petsc4py")
    allow = {f"OMPI_ALLOW_RUN_AS_ROOT{more}": "1" for more in ("", "_CONFIRM")}
    allow |= {"OMPI_MCA_rmaps_base_oversubscribe": "1", "OMPI_MCA_mpi_yield_when_idle": "1"}
    environment = os.environ | allow | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    command = ["mpiexec", "-n", str(processes), sys.executable, *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=1200, check=False)


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


SCENE = """
[curtain]
width = 1000.0
height = 1000.0
[mesh]
cells = 10
[support]
kind = "corners"
gather = 0.95
[solver]
linear_solver = "{}"
"""


def test_the_command_on_two_processes_writes_and_says_all_once(tmp_path):
    found = {}
    for method, processes in (("superlu", 1), ("mumps", 2)):
        scene = tmp_path / f"{method}.toml"
        scene.write_text(SCENE.format(method))
        out = tmp_path / method
        done = started(["-m", "macro_fem", "run", str(scene), "--out", str(out), "--no-picture"], processes)
        assert done.returncode == 0, done.stderr
        assert done.stdout.count("mean height") == 1
        found[method] = json.loads((out / "summary.json").read_text())
        assert found[method]["linear_solver"] == method
        assert {path.name for path in out.iterdir()} == {"summary.json", "support_forces.csv", "curtain.vtu"}
    assert found["mumps"]["mean_height_mm"] == pytest.approx(found["superlu"]["mean_height_mm"], abs=1e-5)


def test_bad_input_on_two_processes_is_a_sentence_with_code_2(tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE.format("abacus"))
    done = started(["-m", "macro_fem", "run", str(scene), "--out", str(tmp_path / "out"), "--no-picture"], 2)
    assert done.returncode == 2
    assert "linear_solver = 'abacus'" in done.stderr
    assert not (tmp_path / "out").exists()
