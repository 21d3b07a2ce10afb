"""The packages meet at two doors and in what all share, and importing them brings nothing heavy."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SHARED = (
    "rve.command_line",
    "rve.errors",
    "rve.files",
    "rve.jobs",
    "rve.reading",
    "rve.rings",
    "rve.values",
    "rve.vtu",
)
"""What knows nothing of poses and contacts: ends of commands, files, checks of values, the mass of rings."""
DOORS: dict[str, tuple[str, ...]] = {
    "rve": (),
    "homogenize": ("rve.table", *SHARED),
    "macro_fem": ("homogenize.law", *SHARED),
}
HEAVY = ("matplotlib", "pyvista", "vtk", "clarabel", "meshio", "skfem", "pandas", "sksparse", "pyamg")


def foreign_imports(package: str, source: str) -> list[str]:
    """Dotted names that `source`, a module of `package`, takes from a sister package other than through its door."""
    names: list[str] = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    sisters = DOORS.keys() - {package}
    doors = tuple(f"{door}." for door in DOORS[package])
    return [name for name in names if name.split(".")[0] in sisters and not f"{name}.".startswith(doors)]


@pytest.mark.parametrize("package", DOORS)
def test_imports_cross_only_at_the_doors(package):
    files = sorted((ROOT / package).rglob("*.py"))
    assert files
    bad = {str(file): names for file in files if (names := foreign_imports(package, file.read_text()))}
    assert not bad


def test_the_gate_sees_a_forbidden_import():
    assert foreign_imports("macro_fem", "from rve.table import read_table") == ["rve.table.read_table"]
    assert foreign_imports("homogenize", "import rve.contact") == ["rve.contact"]
    assert foreign_imports("homogenize", "from rve.table import read_table") == []


@pytest.mark.parametrize(
    "module", ["rve", "rve.table", "rve.cli", "homogenize", "homogenize.law", "homogenize.cli", "macro_fem.cli"]
)
def test_import_is_light(module):
    code = f"import sys, {module}; print([m for m in {HEAVY!r} if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_a_law_runs_without_the_rings():
    code = "import sys, homogenize.law; homogenize.law.default_law(); print([m for m in sys.modules if 'rve.' in m])"
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(ast.literal_eval(run.stdout))
    assert loaded
    assert loaded <= set(SHARED)
