"""The mutation sample: which mistakes it makes, where, and what it says of tests that notice, sleep through or hang."""

import shutil

import pytest

from benchmarks.machine import ROOT
from benchmarks.mutation.mutants import candidates, compiles, modules, sample, signatures

PACKAGES = ("rve", "homogenize", "macro_fem")
SOURCE = '''
"""Not a - b."""
LIMIT = 1e-6

def f(a: int, b: int, tolerance: float = 1e-9, *, deep: bool = True) -> bool:
    """Nor here: a - b."""
    if a < 0.0:
        raise ValueError(f"{a - b}")
    c = a[0] + 2.0 * b[-1].T
    c += np.minimum(a, b) if a and not b else np.einsum("ij,jk->ik", a, b)
    return g(a, b, tolerance=tolerance) > tolerance

def g(a: int, b: int, tolerance: float = 1.0) -> float:
    status = "stalled"
    return -a @ b
'''


def changes(source=SOURCE, tmp=None):
    return {(m.was, m.now.strip("()")) for m in candidates(source.encode(), "f.py", signatures([tmp]) if tmp else {})}


def test_the_mistakes_that_people_make(tmp_path):
    path = tmp_path / "f.py"
    path.write_text(SOURCE)
    assert changes(tmp=path) >= {
        ("1e-6", "0.001"),  # a tolerance 1000 times as wide
        ("a < 0.0", "a > 0.0"),
        ("a < 0.0", "a <= 0.0"),
        ("a < 0.0", "False"),  # a check that never fires
        ("a[0] + 2.0 * b[-1].T", "a[0] - 2.0 * b[-1].T"),
        ("a[0] + 2.0 * b[-1].T", "a[0]"),  # a dropped term
        ("2.0", "4.0"),
        ("0", "1"),
        ("b[-1].T", "b[-1]"),
        ("np.minimum", "np.maximum"),
        ("a and not b", "a or not b"),
        ("not b", "b"),
        ('"ij,jk->ik"', "'ij,jk->ki'"),
        ("tolerance", "1000.0 * tolerance"),
        ("tolerance", "1e-09"),  # an option that is ignored
        ("g(a, b, tolerance=tolerance)", "g(a, b"),
        ("g(a, b, tolerance=tolerance)", "g(b, a, tolerance=tolerance"),
        ("return g(a, b, tolerance=tolerance) > tolerance", "return True"),  # a status that always reads well
        ('"stalled"', "'converged'"),
        ("-a @ b", "b @ -a"),
    }


def test_words_are_left_alone():
    assert not changes('"""a - b"""\ndef f(a: int = 20) -> list[1]:\n    """a - b"""\n    raise Oops(f"{1 - a}")\n')


def test_the_sample_is_the_seed_s_and_even_over_the_modules():
    files = modules(ROOT, PACKAGES)
    some = {"macro_fem/solvers/central_path.py", "rve/equilibrium/interior_point.py", "homogenize/laws/projection.py"}
    assert some < set(files)
    assert not {"macro_fem/cli.py", "rve/study/figures.py", "rve/localization/files.py"} & set(files)
    few = [name for name in files if name.startswith(("macro_fem/solvers/soc", "macro_fem/solvers/central_path"))]
    drawn = sample(ROOT, few, 20, seed=3)
    assert drawn == sample(ROOT, few, 20, seed=3) != sample(ROOT, few, 20, seed=4)
    assert len({(m.file, m.line) for m in drawn}) == 20
    assert {m.file for m in drawn} == set(few)
    assert all(compiles(ROOT, m) for m in drawn)
    assert all(m.applied((ROOT / m.file).read_bytes()) != (ROOT / m.file).read_bytes() for m in drawn)


@pytest.mark.slow
def test_each_verdict(tmp_path, monkeypatch):
    """A small tree: one line is guarded, one is not, one is never run, and one hangs when it is wrong."""
    pytest.importorskip("coverage")
    from benchmarks.mutation import __main__ as tool

    tree = tmp_path / "tree"
    shutil.copytree(ROOT / "benchmarks", tree / "benchmarks", ignore=shutil.ignore_patterns("__pycache__"))
    (tree / "rve").mkdir()
    (tree / "tests").mkdir()
    (tree / "pyproject.toml").write_text('[tool.pytest.ini_options]\npythonpath = ["."]\n')
    (tree / "rve" / "__init__.py").touch()
    source = "def area(a, b):\n    return a * b\ndef rounded(a):\n    return a + 1e-12\ndef unused(a):\n    return -a\n"
    source += "def count(n):\n    k = 0\n    while k < n:\n        k += 1\n    return k\n"
    (tree / "rve" / "sums.py").write_text(source)
    tests = "import pytest\nfrom rve import sums\n\n"
    tests += "@pytest.fixture(scope='module')\ndef four():\n    return sums.count(4)\n\n"
    tests += "def test_area(): assert sums.area(2, 3) == 6\ndef test_four(four): assert four == 4\n"
    tests += "def test_again(four): assert sums.rounded(four) > 3\n"
    (tree / "tests" / "test_sums.py").write_text(tests)
    monkeypatch.setattr(tool, "GRACE", 2.0)
    record = tool.record_of(tree, None)
    assert not record["failed"]
    wrong = {(m.was, m.now): m for m in candidates(source.encode(), "rve/sums.py", {})}
    judged = {key: tool.verdict(tree, mutant, record) for key, mutant in wrong.items() if key in EXPECTED}
    assert {key: (v.state, v.by.split("::")[-1].split(" ", 1)[-1]) for key, v in judged.items()} == EXPECTED
    assert (tree / "rve" / "sums.py").read_text() == source
    assert judged["k += 1", "k -= 1"].tests == 2  # the fixture is run once, for both


EXPECTED = {
    ("a * b", "a / b"): ("killed", "test_area"),
    ("a + 1e-12", "a"): ("survived", ""),
    ("-a", "a"): ("not covered", ""),
    ("k += 1", "k -= 1"): ("killed", "(time limit)"),
}
