"""What a section measures: a fingerprint of the numerics that its module imports, by which stale ones are known."""

import ast
import hashlib
from functools import cache
from pathlib import Path

from benchmarks.measure import ROOT

PACKAGES = ("rve", "homogenize", "macro_fem")
SHOWN = {"cli", "commands", "drawing", "drawn", "output", "plots", "progress", "report", "sentences"}
"""Rooms and modules that show answers and change none."""


@cache
def fingerprint(module: str) -> str:
    """Eight digits that change with the numerics behind `module`, not with comments, docstrings or layout."""
    seen: dict[str, str] = {}
    left = [module]
    while left:
        name = left.pop()
        if name in seen or SHOWN & set(name.split(".")):
            continue
        seen[name], imported = _read(name)
        left += imported
    inside = [seen[name] for name in sorted(seen) if seen[name] and name.split(".")[0] in PACKAGES]
    return hashlib.sha256("\n".join(inside).encode()).hexdigest()[:8]


@cache
def _read(name: str) -> tuple[str, list[str]]:
    """The bare tree of a module of this project as text, and what it imports; nothing of other modules and packages."""
    path = ROOT / Path(*name.split(".")).with_suffix(".py")
    if not path.exists() or name.split(".")[0] not in (*PACKAGES, "benchmarks"):
        return "", []
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return ast.dump(_bare(tree)), _imported(tree)


def _imported(tree: ast.Module) -> list[str]:
    """Modules that are imported anywhere; names of the public roots are looked up in their stubs."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module is not None and node.level == 0:
            names = [alias.name for alias in node.names]
            found += [node.module, *(f"{node.module}.{name}" for name in names)]
            found += [_public(node.module)[name] for name in names if name in _public(node.module)]
    return found


@cache
def _public(root: str) -> dict[str, str]:
    """The module behind each public name of a root."""
    stub = ROOT.joinpath(*root.split("."), "__init__.pyi")
    nodes = ast.walk(ast.parse(stub.read_text(encoding="utf-8"))) if stub.exists() else ()
    lines = [node for node in nodes if isinstance(node, ast.ImportFrom)]
    return {alias.asname or alias.name: f"{root}.{node.module}" for node in lines for alias in node.names}


def _bare(tree: ast.Module) -> ast.Module:
    """The tree without docstrings and other lines that are only text."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            node.body = [one for one in node.body if not _is_text(one)] or [ast.Pass()]
    return tree


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
