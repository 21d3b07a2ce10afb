"""Every command, scene and Python block of tutorial, how-to and the page of Python runs, in the order of the page."""

import html
import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import click
import numpy as np
import pytest

import homogenize
import macro_fem
import rve
from homogenize.io import law_kinds
from tests.commands import GROUPS

DOCS = Path(__file__).resolve().parents[1] / "docs"
BLOCK = re.compile(r"^```(bash|toml|python)\n(.*?)^```", re.MULTILINE | re.DOTALL)


def blocks(page: str) -> list[tuple[str, str]]:
    """Kind and text of the code blocks of a page."""
    return BLOCK.findall((DOCS / page).read_text(encoding="utf-8"))


@pytest.mark.parametrize("page", ["../README.md", "tutorial.md", "how_to.md"])
def test_commands_of_the_page_have_the_options_that_it_gives(page):
    found = 0
    for text in (text.replace("\\\n", " ") for kind, text in blocks(page) if kind == "bash"):
        for package, name, words in re.findall(r"python -m (rve|homogenize|macro_fem) (\S+)([^\n#&|>]*)", text):
            command = GROUPS[package].commands[name]
            command.make_parser(click.Context(command, **command.context_settings)).parse_args(shlex.split(words))
            found += 1
    assert found


@pytest.mark.parametrize(
    ("page", "kinds"),
    [
        pytest.param("tutorial.md", {"bash", "toml"}, marks=pytest.mark.slow),
        pytest.param("how_to.md", {"bash", "toml"}, marks=pytest.mark.release),
        pytest.param("reference/python.md", {"python"}, marks=pytest.mark.slow),
    ],
)
def test_the_page_runs_as_it_stands(page, kinds, tmp_path):
    environment = os.environ | {"PYTHONPATH": str(DOCS.parent), "MPLBACKEND": "Agg"}
    environment.pop("CALCULIX", None)  # which takes minutes; tests of decks have it
    found = blocks(page)
    assert {kind for kind, _ in found} >= kinds
    for kind, text in found:
        if kind == "toml":
            tomllib.loads(text)
            named = re.match(r"# (\w+\.toml)\n", text)
            (tmp_path / (named[1] if named else "scene.toml")).write_text(text, encoding="utf-8")
            continue
        code = text.replace("python -m", f"{sys.executable} -m")
        run = ["bash", "-e", "-c", code] if kind == "bash" else [sys.executable, "-c", text]
        done = subprocess.run(run, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{text}\n{done.stdout}{done.stderr}"
    written = {path.name for path in tmp_path.iterdir()}
    named = set(re.findall(r"--out (\S+)", "".join(text for kind, text in found if kind == "bash")))
    assert named <= written


def anchors(page: Path) -> set[str]:
    """Anchors of the headings of a page, as GitHub and the site make them."""
    headings = re.findall(
        r"^#+ (.*)$", re.sub(r"```.*?```", "", page.read_text("utf-8"), flags=re.DOTALL), re.MULTILINE
    )
    return {re.sub(r"[^\w\- ]", "", heading).strip().lower().replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", [*DOCS.parent.glob("*.md"), *sorted(DOCS.rglob("*.md"))], ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    text = re.sub(r"```.*?```", "", page.read_text("utf-8"), flags=re.DOTALL)
    for target, anchor in re.findall(r"\]\(([^)#\s]*)(?:#([^)\s]+))?\)", text):
        if not target.startswith(("http:", "https:")):
            place = page.parent / target if target else page
            assert place.exists(), target
            assert not anchor or anchor in anchors(place), f"{target}#{anchor}"


def test_contributing_names_places_that_are_there():
    text = (DOCS.parent / "CONTRIBUTING.md").read_text("utf-8")
    for place in re.findall(r"`(\w+/[\w/]*(?:\.py)?)`", text):
        assert (DOCS.parent / place).exists(), place
    records = re.findall(r"^\| (`[A-Z].*) \| .* \| `(.*)` \|$", text, re.MULTILINE)
    assert records
    for names, place in records:
        for name in re.findall(r"`(\w+)`", names):
            assert re.search(rf"^class {name}\b", (DOCS.parent / place).read_text("utf-8"), re.MULTILINE), name
    sketch = re.search(r"```text\n(.*?)```", text, re.DOTALL)[1]
    for package, folders in re.findall(r"^(\w+) .*  {3,}(\w+(?:  \w+)*)$", sketch, re.MULTILINE):
        told = set(folders.split())
        assert told == {place.parent.name for place in (DOCS.parent / package).glob("*/__init__.py")}


def test_every_claim_of_the_theory_names_tests_that_are_there():
    evidence = DOCS / "reports" / "evidence.md"
    rows = re.findall(r"^\|[^|]*\| \[\w+\]\((\S+\.py)\) \| (.*) \|$", evidence.read_text("utf-8"), re.MULTILINE)
    assert rows
    for path, names in rows:
        source = (evidence.parent / path).read_text("utf-8")
        for name in names.split("; "):
            assert f"def test_{name.replace(' ', '_')}(" in source, f"{path}: {name}"


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_loads_nothing_from_elsewhere(tmp_path):
    words = ["-W", "--keep-going", "-q", "-D", "nb_execution_mode=off"]  # tests/test_public_api.py runs the notebooks
    command = [sys.executable, "-m", "sphinx", *words, "-b", "html", str(DOCS), str(tmp_path)]
    done = subprocess.run(command, cwd=DOCS.parent, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for page in tmp_path.rglob("*.html"):
        loaded = re.findall(r"<(?:script|img|link)[^>]*(?:src|href)=[\"'](https?:[^\"']+)", page.read_text("utf-8"))
        assert not loaded, page.name
        text = re.sub(r"<(pre|code|script|style)\b.*?</\1>", "", page.read_text("utf-8"), flags=re.DOTALL)
        raw = re.findall(r"\\[A-Za-z]+|\$\S[^$<]*\$", re.sub(r"<[^>]+>", "", text))  # TeX that was not typeset
        assert page.parent.name == "_modules" or not raw, (page.name, raw)
    listed = (tmp_path / "reference" / "python.html").read_text("utf-8")
    for package in (rve, homogenize, macro_fem):
        for name in package.__all__:
            row = rf'<td><p><a [^>]*names/{package.__name__}\.{name}\.html">.*?</td>\s*<td>(.*?)</td>'
            told = html.unescape(re.sub(r"<[^>]+>", "", re.search(row, listed, re.DOTALL)[1]).strip())
            noun = getattr(package, name)
            whole = " ".join((noun.__doc__ or "").split("\n\n")[0].split()).replace("`", "") if callable(noun) else told
            assert re.match(r"$|\.$|\. ([A-Z]|\w+:)", whole.removeprefix(told)), f"{name}: {told}"  # a whole sentence


@pytest.mark.parametrize("package", [rve, homogenize, macro_fem], ids=lambda package: package.__name__)
def test_the_page_of_python_lists_every_public_name(package):
    page = (DOCS / "reference" / "python.md").read_text(encoding="utf-8")
    told = re.search(rf"^## {package.__name__}\n\nNames: (.*)\.$", page, re.MULTILINE)[1]
    assert told == ", ".join(f"`{name}`" for name in package.__all__)


def test_the_page_of_materials_has_their_values():
    page = (DOCS / "reference" / "materials.md").read_text(encoding="utf-8")
    rows = [
        f"| {one.name} | {1e9 * one.density_kg_per_mm3:g} | {one.young_N_per_mm2:g} | {one.poisson:g} | "
        f"{one.yield_N_per_mm2:g} | {one.ultimate_N_per_mm2:g} |"
        for one in rve.MATERIALS.values()
    ]
    assert re.findall(r"^(\| (?!name).*\|) \D[^|]*\|$", page, re.MULTILINE) == rows


def test_the_numbers_of_ten_minutes_of_mechanics_are_those_of_the_default_law():
    page = (DOCS / "explanation" / "mechanics.md").read_text(encoding="utf-8")
    law, ring = homogenize.default_law(), rve.pulled_ring(5.0, 0.5)
    across = law.rows.E[law.rows.S[:, 0].argmax()]
    mass, strength = law.cell.areal_mass_kg_per_m2, 1.0 / law.strength.utilisation(np.array([[0.0, 0.0, 1.0]]))[0]
    load = (mass + 20.0) * 9.81e-3
    for told in (
        f"{law.cell.b_x_mm:.2f} mm \N{MULTIPLICATION SIGN} {law.cell.b_y_mm:.2f} mm",
        f"E11 = {across[0]:.3f} and E22 = \N{MINUS SIGN}{-across[2]:.3f}",
        f"{(1.0 + 2.0 * across[0]) ** 0.5:.2f} times as wide",
        f"{(1.0 + 2.0 * across[2]) ** 0.5:.2f} times as high",
        f"{mass:.3f} \N{MIDDLE DOT} 9.81 = {9.81 * mass:.1f} N",
        f"= {load:.3f}\\ ",
        f"bears {11.0 * load:.2f} N, and a hook each 110 mm ten times that, {110.0 * load:.1f} N",
        f"S22 = {strength:.2f} N/mm along the grain",
        f"{strength:.2f}/{load:.3f} = {strength / load:.1f}",
        f"yields at {ring.first_yield_N:.1f} N and begins to be drawn long at {ring.collapse_N:.1f} N",
    ):
        assert told in page, told


def test_the_table_of_laws_has_every_kind():
    page = (DOCS / "explanation" / "laws.md").read_text(encoding="utf-8")
    assert law_kinds().keys() <= set(re.findall(r"^\| `(\w+)`", page, re.MULTILINE))


def test_the_gallery_shows_every_scene_with_its_picture_and_its_first_words():
    page = (DOCS / "gallery.md").read_text(encoding="utf-8")
    examples = DOCS.parent / "examples"
    assert len(re.findall("^### ", page, re.MULTILINE)) == len(list(examples.rglob("*.toml")))
    for path in examples.rglob("*.toml"):
        comments = [line.lstrip("# ") for line in path.read_text(encoding="utf-8").splitlines() if line[:1] == "#"]
        assert " ".join(comments) in page, path.name
        assert f"../examples/pictures/{path.stem}.png" in page
        assert f"../{path.relative_to(DOCS.parent)}" in page
