"""Wheel and sdist hold what they must, and the packages work from the wheel alone."""

import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
DOCUMENTS = ("README.md", "CHANGELOG.md", "CITATION.cff", "theory.md", "tutorial.md", "corner_hung.toml")


@pytest.fixture(scope="module")
def dist(tmp_path_factory):
    out = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--outdir", str(out), str(ROOT)]
    subprocess.run(command, check=True, capture_output=True, cwd=out)
    return out


def names_in(dist):
    """Names of the files in wheel and sdist."""
    wheel, sdist = next(dist.glob("*.whl")), next(dist.glob("*.tar.gz"))
    with zipfile.ZipFile(wheel) as inside, tarfile.open(sdist) as packed:
        return inside.namelist(), packed.getnames()


def test_one_version_everywhere():
    version = PROJECT["version"]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
    latest = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert latest is not None
    assert latest[1] in (version, "Unreleased")


@pytest.mark.slow
def test_the_sdist_holds_the_tree_and_the_wheel_what_runs(dist):
    wheel, sdist = names_in(dist)
    for names, wanted in ((wheel, ()), (sdist, (*DOCUMENTS, "test_chain.py"))):
        for name in (*wanted, "LICENSE", "py.typed", "rings_10.json", "umat.f", "report.typ"):
            assert any(one.endswith(f"/{name}") for one in names), name
    parts = ("docs", "examples", "tests", "benchmarks", "__pycache__")
    assert not [name for name in wheel if set(parts) & set(name.split("/")) or name.endswith(DOCUMENTS)]


@pytest.mark.slow
def test_the_wheel_alone_makes_table_law_and_curtain(dist, tmp_path):
    place = tmp_path / "site"
    command = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--target", str(place)]
    subprocess.run([*command, str(next(dist.glob("*.whl")))], check=True, capture_output=True)
    environment = os.environ | {"PYTHONPATH": str(place)}

    def run(*arguments):
        command = [sys.executable, "-m", *map(str, arguments)]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    where = subprocess.run([sys.executable, "-c", "import rve; print(rve.__file__)"], env=environment, cwd=tmp_path,
                           capture_output=True, text=True, check=True)  # fmt: skip
    assert Path(where.stdout.strip()).is_relative_to(place)
    assert PROJECT["version"] in run("rve", "--version")
    run("rve", "table", "--out", "table.csv", "--alpha", "0:45:15", "--beta", "0:90:15")
    run("homogenize", "fit", "table.csv", "--out", "law.json")
    scene = ROOT / "examples" / "corner_hung.toml"
    run("macro_fem", "run", scene, "--law", "law.json", "--out", "curtain", "--no-picture")
    assert (tmp_path / "curtain" / "summary.json").exists()


def test_ci_runs_files_of_tests_that_exist():
    words = re.findall(r"tests/\S+\.py", (ROOT / ".ci/run").read_text(encoding="utf-8"))
    parts = [(*re.split("[{}]", word), "", "") for word in words]  # test_{one,two}.py
    files = [start + name + end for start, names, end, *_ in parts for name in names.split(",")]
    assert len(files) > 10
    assert [file for file in files if not (ROOT / file).exists()] == []
