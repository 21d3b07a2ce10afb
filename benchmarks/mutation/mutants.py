"""Where the numerics can go wrong by one line: candidates from the syntax tree, and a sample of them.

Mistakes that people make: a sign, a factor 2, a dropped term, swapped operands, indices, arguments or axes, a missing
transpose, an index off by one, < for <=, and for or, min for max, an option that is ignored, a tolerance 1000 times as
wide, a check that never fires, a status that always reads well.
"""

from __future__ import annotations

import ast
import copy
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

OTHER = {
    *("cli", "plots", "files", "io", "report", "explain", "errors", "job"),
    *("picture", "records", "checkpoints", "ship", "comparison", "figures", "main", "init", "schema", "progress"),
    *("command", "jobs", "reading", "values", "vtu", "gmsh", "types", "versions"),
}
"""Modules with one of these words in their names read, write, draw or explain: they are no numerics."""
PAIRS = (
    *(("min", "max"), ("minimum", "maximum"), ("argmin", "argmax"), ("any", "all"), ("sin", "cos"), ("x", "y")),
    *(("floor", "ceil"), ("width", "height"), ("lower", "upper"), ("primal", "dual"), ("n_quad", "n_cells")),
)
PARTNER = {a: b for pair in PAIRS for a, b in (pair, pair[::-1])}
ORDERED = {"arctan2", "cross", "matmul", "outer", "subtract", "solve"}
"""Functions of others whose arguments can be swapped without an error."""
FAILURES = {"iterations", "stalled", "infeasible", "taut"}
LARGE = 13
"""Whole numbers from here on are sizes and limits, not indices that can be off by one."""
BINARY = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
FLIPPED = {ast.Lt: ast.Gt, ast.LtE: ast.GtE, ast.Gt: ast.Lt, ast.GtE: ast.LtE, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
EDGE = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
Signatures = dict[str, list[tuple[str, str, bool]]]
SKIPPED = (ast.Raise, ast.Assert, ast.JoinedStr, ast.Import, ast.ImportFrom, ast.arg)


@dataclass(frozen=True)
class Mutant:
    """`now` instead of `was` at [start, end) (bytes) of a file; `lines` (first, last) run it, None: at import."""

    file: str
    line: int
    was: str
    now: str
    start: int
    end: int
    lines: tuple[int, int] | None

    def applied(self, source: bytes) -> bytes:
        """The changed source."""
        return source[: self.start] + self.now.encode() + source[self.end :]


def modules(root: Path, packages: tuple[str, ...], only: str = "") -> list[str]:
    """Paths of the numerics, sorted."""
    paths = sorted(path for package in packages for path in (root / package).rglob("*.py"))
    names = [path.relative_to(root).as_posix() for path in paths if not OTHER & set(path.stem.strip("_").split("_"))]
    return [name for name in names if name.startswith(only)]


def sample(root: Path, files: list[str], n: int, seed: int) -> list[Mutant]:
    """n mutants, or as many as there are, at different lines, each module by its number of lines that can go wrong.

    The lines are taken at even distances from a random start; on a line one candidate at random.
    """
    rng = np.random.default_rng(seed)
    calls = signatures([root / file for file in files])
    lines = [found for file in files for _, found in sorted(by_line(root, file, calls).items())]
    n = min(n, len(lines))
    chosen = ((rng.random() + np.arange(n)) * len(lines) / max(n, 1)).astype(int)
    orders = ((lines[i][k] for k in rng.permutation(len(lines[i]))) for i in chosen)
    found = (next((mutant for mutant in order if compiles(root, mutant)), None) for order in orders)
    return [mutant for mutant in found if mutant]


def compiles(root: Path, mutant: Mutant) -> bool:
    """Whether Python takes the changed source without a warning."""
    with warnings.catch_warnings(action="error"):
        try:
            compile(mutant.applied((root / mutant.file).read_bytes()), mutant.file, "exec")
        except (SyntaxError, SyntaxWarning):
            return False
    return True


def by_line(root: Path, file: str, calls: Signatures) -> dict[int, list[Mutant]]:
    """All candidates of a file, by line."""
    result: dict[int, list[Mutant]] = {}
    for mutant in candidates((root / file).read_bytes(), file, calls):
        result.setdefault(mutant.line, []).append(mutant)
    return result


def signatures(paths: list[Path]) -> Signatures:
    """Parameters of every function and dataclass, by name: a call is only changed where nothing complains at once."""
    result: Signatures = {}
    for path in paths:
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.FunctionDef):
                spec = node.args
                defaults = [None] * (len(spec.args) - len(spec.defaults)) + list(spec.defaults) + list(spec.kw_defaults)
                known = zip(spec.args + spec.kwonlyargs, defaults, strict=True)
                result[node.name] = [(a.arg, _text(a.annotation), d is not None) for a, d in known if a.arg != "self"]
            elif isinstance(node, ast.ClassDef):
                fields = [item for item in node.body if isinstance(item, ast.AnnAssign)]
                result[node.name] = [(_text(f.target), _text(f.annotation), f.value is not None) for f in fields]
    return result


def candidates(source: bytes, file: str, calls: Signatures) -> Iterator[Mutant]:
    """Every mistake that can be made in a source."""
    starts = np.cumsum([0, *(len(line) for line in source.splitlines(keepends=True))])
    for node, new, parent, lines in _walk(ast.parse(source), _Place(calls)):
        start = int(starts[node.lineno - 1]) + node.col_offset
        end = int(starts[node.end_lineno - 1]) + node.end_col_offset
        now = ast.unparse(new)
        is_part = isinstance(parent, ast.expr) and not isinstance(new, ast.Constant | ast.Name | ast.Call)
        now = f"({now})" if is_part else now
        if now != ast.unparse(node):
            yield Mutant(file, node.lineno, source[start:end].decode(), now, start, end, lines)


def _text(node: ast.AST | None) -> str:
    return "" if node is None else ast.unparse(node)


@dataclass(frozen=True)
class _Place:
    """Known calls, the node above, the innermost statement's lines, the function around, and whether in an index."""

    calls: Signatures = field(repr=False)
    parent: ast.AST | None = None
    lines: tuple[int, int] | None = None
    function: ast.FunctionDef | None = None
    is_index: bool = False


def _walk(node: ast.AST, at: _Place) -> Iterator[tuple[ast.AST, ast.AST, ast.AST | None, tuple[int, int] | None]]:
    """(node, what it becomes, node above, lines) for every candidate below a node."""
    if isinstance(node, SKIPPED) or (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
        return
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):  # a docstring
        return
    lines = at.lines
    if isinstance(node, ast.stmt) and at.function:
        body = getattr(node, "body", None)
        lines = (node.lineno, body[0].lineno - 1 if isinstance(body, list) else node.end_lineno or node.lineno)
        lines = (lines[0], max(lines))
    for new in _changed(node, at):
        yield node, new, at.parent, lines
    is_index = at.is_index and isinstance(node, ast.Tuple | ast.UnaryOp)
    is_index |= isinstance(node, ast.Slice) or (isinstance(node, ast.keyword) and node.arg == "axis")
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "bases"):
            continue
        inside = isinstance(node, ast.FunctionDef) and name == "body"
        function = node if inside and isinstance(node, ast.FunctionDef) else at.function
        index = is_index or (isinstance(node, ast.Subscript) and name == "slice")
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield from _walk(child, _Place(at.calls, node, lines, function, index))


def _with(node: ast.AST, **fields: object) -> ast.AST:
    new = copy.deepcopy(node)
    for name, value in fields.items():
        setattr(new, name, value)
    return new


def _changed(node: ast.AST, at: _Place) -> Iterator[ast.AST]:
    """What one node can wrongly become."""
    match node:
        case ast.BinOp(left, op, right):
            yield from _binary(node, left, op, right)
        case ast.AugAssign(op=op) if type(op) in BINARY:
            yield _with(node, op=BINARY[type(op)]())
        case ast.UnaryOp(op=ast.USub() | ast.Not() | ast.Invert(), operand=operand):
            yield operand
        case ast.Compare(left, [op], [right]) if type(op) in FLIPPED:
            yield _with(node, ops=[FLIPPED[type(op)]()])
            if type(op) in EDGE and any(isinstance(side, ast.Constant) for side in (left, right)):
                yield _with(node, ops=[EDGE[type(op)]()])
        case ast.BoolOp(op, values):
            yield _with(node, op=ast.Or() if isinstance(op, ast.And) else ast.And())
            yield from values[:2]
        case ast.Constant(value=value):
            yield from _constant(node, value, at)
        case ast.Attribute(value, attr, ast.Load()):
            if attr == "T":
                yield value
            elif attr in PARTNER:
                yield _with(node, attr=PARTNER[attr])
        case ast.Call(func, args, keywords):
            yield from _call(node, func, args, keywords, at.calls)
        case ast.Return(value=value) if value is not None and at.function and _is(at.function.returns, "bool"):
            yield _with(node, value=ast.Constant(True))
    if isinstance(at.parent, ast.If) and node is at.parent.test and not at.parent.orelse:
        yield ast.Constant(False)
    if isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Load):
        yield from _option(node, at)


def _is(node: ast.AST | None, name: str) -> bool:
    return isinstance(node, ast.Name) and node.id == name


def _binary(node: ast.AST, left: ast.expr, op: ast.operator, right: ast.expr) -> Iterator[ast.AST]:
    if any(isinstance(s, ast.JoinedStr) or isinstance(getattr(s, "value", None), str) for s in (left, right)):
        return  # text
    if type(op) in BINARY:
        yield _with(node, op=BINARY[type(op)]())
        yield left
        if isinstance(op, ast.Add | ast.Mult):
            yield right
    elif isinstance(op, ast.MatMult):
        yield _with(node, left=right, right=left)
    elif isinstance(op, ast.BitAnd | ast.BitOr):
        yield _with(node, op=ast.BitOr() if isinstance(op, ast.BitAnd) else ast.BitAnd())
        yield left


def _constant(node: ast.AST, value: object, at: _Place) -> Iterator[ast.AST]:
    if isinstance(value, bool) and isinstance(at.parent, ast.keyword | ast.Return):
        yield ast.Constant(not value)
    elif isinstance(value, float) and value:
        factor = 2.0 if abs(value) > 1e-2 and at.function else 1e3
        yield ast.Constant(float(f"{factor * value:.6g}"))
    elif isinstance(value, int) and not isinstance(value, bool) and abs(value) < LARGE:
        yield ast.Constant(1 - value if at.is_index and value in (0, 1) else value + 1)
    elif isinstance(value, str) and value in FAILURES and isinstance(at.parent, ast.Assign | ast.keyword | ast.Return):
        yield ast.Constant("converged")
    elif isinstance(value, str) and "->" in value and len(value.split("->")[1]) > 1:
        start, end = value.split("->")
        yield ast.Constant(f"{start}->{end[:-2]}{end[-1]}{end[-2]}")


def _call(
    node: ast.AST, func: ast.expr, args: list[ast.expr], keywords: list[ast.keyword], calls: Signatures
) -> Iterator[ast.AST]:
    """Two neighbouring arguments of one kind swapped, an outer function or an option left out."""
    name = ast.unparse(func).split(".")[-1]
    known = calls.get(name, [])
    for i in range(len(args) - 1):
        is_alike = len(known) > i + 1 and known[i][1] == known[i + 1][1]
        if is_alike or name in ORDERED:
            yield _with(node, args=[*args[:i], args[i + 1], args[i], *args[i + 2 :]])
    if name in ("abs", "sqrt", "maximum", "minimum", "clip", "max", "min") and args:
        yield args[0]
    for keyword in keywords:
        if any(keyword.arg == arg and has_default for arg, _, has_default in known):
            yield _with(node, keywords=[k for k in keywords if k is not keyword])


def _option(node: ast.Name | ast.Attribute, at: _Place) -> Iterator[ast.AST]:
    """A tolerance a thousand times as wide, a parameter that is always its default, a partner's name."""
    name = node.id if isinstance(node, ast.Name) else node.attr
    if "tol" in name.lower():
        yield ast.BinOp(ast.Constant(1e3), ast.Mult(), node)
    if isinstance(node, ast.Attribute) or at.function is None:
        return
    spec = at.function.args
    named = [*spec.posonlyargs, *spec.args]
    pairs = [*zip(named[::-1], spec.defaults[::-1], strict=False), *zip(spec.kwonlyargs, spec.kw_defaults, strict=True)]
    yield from (default for arg, default in pairs if arg.arg == name and default is not None)
    names = {n.id for n in ast.walk(at.function) if isinstance(n, ast.Name)} | {a.arg for a in named}
    if name in PARTNER and (PARTNER[name] in names or name in ("min", "max", "any", "all")):
        yield ast.Name(PARTNER[name], ast.Load())
