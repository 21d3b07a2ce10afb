"""Imports cross at faces, run downwards file by file, and cost nothing that is not asked for.

A face is the `__init__` of a package or sub-package that lists names for others. Roots are for users: few names.
"""

import ast
import re
import subprocess
import sys
from functools import cache
from graphlib import CycleError, TopologicalSorter
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
BELOW: dict[str, tuple[str, ...]] = {"rve": (), "homogenize": ("rve",), "macro_fem": ("rve", "homogenize")}
ROOT_NAMES = {"rve": 27, "homogenize": 16}
"""As many names as a root may have; more are for the face of a sub-package."""
DEEP = 100
"""Names that tests take from below faces are fewer."""
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


@cache
def face(package: str) -> dict[str, str]:
    """The names that the stub of a package or sub-package lists, and the modules that they are from."""
    stub = ROOT.joinpath(*package.split("."), "__init__.pyi")
    body = ast.parse(stub.read_text()).body if stub.is_file() else []
    lines = [node for node in body if isinstance(node, ast.ImportFrom)]
    return {str(alias.asname): f"{package}.{node.module}" for node in lines for alias in node.names}


def source_of(name: str) -> str | None:
    """The dotted module of the product that an imported name is from, looked up through faces; None for libraries."""
    module, _, last = name.rpartition(".")
    if ROOT.joinpath(*name.split(".")).with_suffix(".py").is_file():
        return name
    if module and last in face(module):
        return source_of(f"{face(module)[last]}.{last}")
    return source_of(module) if module else None


def foreign_imports(package: str, source: str) -> list[str]:
    """Names that `source`, a module of `package`, takes from a sister package other than from one of its faces.

    `rve.common` is shared by all packages.
    """
    bad = []
    for name in imported_names(source):
        module = name.rpartition(".")[0]
        top = name.split(".")[0]
        if top not in BELOW.keys() - {package} or name.startswith("rve.common."):
            continue
        if top not in BELOW[package] or (module and name.rpartition(".")[2] not in face(module)):
            bad.append(name)
    return bad


def files(package: str) -> dict[str, set[str]]:
    """Modules of a package, each with those that it imports, also inside functions and for type checkers."""
    graph: dict[str, set[str]] = {}
    for file in sorted((ROOT / package).rglob("*.py")):
        here = ".".join(file.relative_to(ROOT).with_suffix("").parts)
        sources = {source_of(name) for name in imported_names(file.read_text())}
        graph[here] = {str(name) for name in sources if name and name.startswith(f"{package}.")} - {here}
    return graph


def units(package: str) -> dict[str, set[str]]:
    """Sub-packages and top modules of a package, each with those that it imports."""
    graph: dict[str, set[str]] = {}
    for here, others in files(package).items():
        unit = here.split(".")[1]
        graph.setdefault(unit, set()).update({other.split(".")[1] for other in others} - {unit})
    return graph


@pytest.mark.parametrize("package", BELOW)
def test_imports_cross_only_at_faces(package):
    sources = sorted((ROOT / package).rglob("*.py"))
    assert sources
    bad = {str(file): names for file in sources if (names := foreign_imports(package, file.read_text()))}
    assert not bad


@pytest.mark.parametrize("package", BELOW)
def test_sub_packages_import_downwards(package):
    try:
        order = list(TopologicalSorter(units(package)).static_order())
    except CycleError as error:
        pytest.fail(f"{package}: sub-packages import each other: {' -> '.join(error.args[1])}")
    assert set(units(package)) <= set(order)


@pytest.mark.parametrize("package", BELOW)
def test_files_import_downwards(package):
    try:
        list(TopologicalSorter(files(package)).static_order())
    except CycleError as error:
        pytest.fail(f"files import each other: {' -> '.join(error.args[1])}")


def test_tests_import_faces():
    sources = [file.read_text() for file in sorted((ROOT / "tests").rglob("*.py"))]
    below = [n for text in sources for n in imported_names(text) if n.split(".")[0] in BELOW and source_of(n)]
    deep = [n for n in below if n.count(".") > 2 and n.rpartition(".")[2] not in face(n.rpartition(".")[0])]
    assert len(below) > 500
    assert len(deep) < DEEP


def test_a_circle_of_files_through_a_face_is_seen():
    assert source_of("rve.finite.FiniteMesh") == "rve.finite.solve"
    assert source_of("rve.FiniteMesh") == "rve.finite.solve"
    assert source_of("numpy.linalg.norm") is None


FACES = sorted(
    ".".join(stub.relative_to(ROOT).parent.parts)
    for package in BELOW
    for stub in (ROOT / package).rglob("__init__.pyi")
)


@pytest.mark.parametrize("package", FACES)
def test_every_public_name_is_there_and_typed(package):
    names = import_module(package)
    for name in names.__all__:
        assert getattr(names, name) is not None
    assert set(face(package)) == set(names.__all__)


@pytest.mark.parametrize("package", ROOT_NAMES)
def test_a_root_has_few_names_each_in_an_example_of_its_page(package):
    names = import_module(package).__all__
    page = (ROOT / "docs" / "reference" / "python.md").read_text()
    examples = "".join(re.findall(r"```python\n(.*?)```", page, re.DOTALL))
    assert len(names) <= ROOT_NAMES[package]
    assert not [name for name in names if not re.search(rf"\b{package}\.{name}\b", examples)]
    assert all(f"| `{face}` |" in page for face in FACES if face.startswith(f"{package}."))


@pytest.mark.parametrize("package", ROOT_NAMES)
def test_a_name_that_left_a_root_tells_its_place(package):
    """And is there."""
    (moved,) = (
        node for node in ast.walk(ast.parse((ROOT / package / "__init__.py").read_text())) if isinstance(node, ast.Dict)
    )
    for place, names in ast.literal_eval(moved).items():
        for name in names.split():
            with pytest.raises(
                ImportError, match=f"^{package}.{name} is now {place}.{name}: write from {place} import"
            ):
                getattr(import_module(package), name)
            assert getattr(import_module(place), name) is not None
    assert not hasattr(import_module(package), "nothing")


def test_imports_are_light():
    modules = "rve, rve.table, rve.cli, homogenize, homogenize.cli, macro_fem.cli"
    code = f"import sys, {modules}; print([m for m in {HEAVY!r} if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
