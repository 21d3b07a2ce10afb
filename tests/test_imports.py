"""Imports cross at the public roots, run downwards inside a package, and cost nothing that is not asked for."""

import ast
import subprocess
import sys
from graphlib import CycleError, TopologicalSorter
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
BELOW: dict[str, tuple[str, ...]] = {"rve": (), "homogenize": ("rve",), "macro_fem": ("rve", "homogenize")}
HEAVY = ("matplotlib", "pyvista", "vtk", "plotly", "clarabel", "meshio", "skfem", "pandas", "sksparse")


def imported_names(source: str) -> list[str]:
    """Dotted names that `source` imports anywhere: "module" for import, "module.name" for from-imports."""
    names: list[str] = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


def foreign_imports(package: str, source: str) -> list[str]:
    """Names that `source`, a module of `package`, takes from a sister package other than through its public root.

    `rve.common` is shared by all packages.
    """
    bad = []
    for name in imported_names(source):
        parts = name.split(".")
        if parts[0] not in BELOW.keys() - {package} or name.startswith("rve.common."):
            continue
        if parts[0] not in BELOW[package] or len(parts) > 2:
            bad.append(name)
    return bad


def units(package: str) -> dict[str, set[str]]:
    """Sub-packages and top modules of a package, each with those that it imports."""
    found: dict[str, set[str]] = {}
    for file in sorted((ROOT / package).rglob("*.py")):
        here = file.relative_to(ROOT).with_suffix("").parts[1]
        if here.startswith("__"):
            continue
        inside = [name.split(".")[1] for name in imported_names(file.read_text()) if name.startswith(f"{package}.")]
        found.setdefault(here, set()).update(set(inside) - {here})
    return found


@pytest.mark.parametrize("package", BELOW)
def test_imports_cross_only_at_the_public_roots(package):
    files = sorted((ROOT / package).rglob("*.py"))
    assert files
    bad = {str(file): names for file in files if (names := foreign_imports(package, file.read_text()))}
    assert not bad


@pytest.mark.parametrize("package", BELOW)
def test_sub_packages_import_downwards(package):
    try:
        order = list(TopologicalSorter(units(package)).static_order())
    except CycleError as error:
        pytest.fail(f"{package}: sub-packages import each other: {' -> '.join(error.args[1])}")
    assert set(units(package)) <= set(order)


@pytest.mark.parametrize("package", BELOW)
def test_every_public_name_is_there_and_typed(package):
    root = import_module(package)
    for name in root.__all__:
        assert getattr(root, name) is not None
    stub = ast.parse((ROOT / package / "__init__.pyi").read_text())
    typed = {alias.asname for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert typed == set(root.__all__)


def test_imports_are_light():
    modules = "rve, rve.table, rve.cli, homogenize, homogenize.cli, macro_fem.cli"
    code = f"import sys, {modules}; print([m for m in {HEAVY!r} if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
