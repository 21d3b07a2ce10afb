"""The documentation site: python -m sphinx -W -b html docs out/docs

Warnings are errors, so that every link between pages leads somewhere. Two pages show more on the site than in the
repository: the lists of public names become their docstrings, and below a scene of the gallery stands its file.
"""

from __future__ import annotations

import importlib
import re
import shutil
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert

HERE = Path(__file__).parent
EXAMPLES = HERE.parent / "examples"

project = "ring-mesh"
release = metadata.version("ring-mesh")
copyright = "the ring mesh homogenization authors"

root_doc = "index"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode", "sphinx_click"]
exclude_patterns = ["_build"]
html_theme = "furo"
smartquotes = False  # quotes in tables are those of TOML
html_title = f"ring-mesh {release}"

myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence", "dollarmath"]
html_math_renderer = "mathml"
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_preserve_defaults = True


def names(package: str) -> str:
    """Directives that document every public name of a package."""
    lines = []
    for name in importlib.import_module(package).__all__:
        found = getattr(importlib.import_module(package), name)
        if isinstance(found, Mapping):
            lines.append(f"**{package}.{name}** maps names to values: {', '.join(map(str, found))}.\n")
            continue
        kind = "autoclass" if isinstance(found, type) else "autofunction" if callable(found) else "autodata"
        members = "\n   :members:" if kind == "autoclass" else ""
        lines.append(f"```{{eval-rst}}\n.. {kind}:: {package}.{name}{members}\n```\n")
    return "\n".join(lines)


def filled(app: Any, page: str, source: list[str]) -> None:
    """The text of a page with docstrings and scene files in it."""
    if page == "reference/python":
        listed = re.compile(r"^## (\w+)\n\nNames: .*$", re.MULTILINE)
        source[0] = listed.sub(lambda found: f"## {found[1]}\n\n{names(found[1])}", source[0])
    if page == "gallery":
        file = r"\1\n\n```{literalinclude} \2\n:language: toml\n```"
        source[0] = re.sub(r"^(\[`examples/\w+\.toml`\]\((\S+)\))$", file, source[0], flags=re.M)


def notebooks_beside_pages(app: Any) -> None:
    """The notebooks of examples/ where Sphinx looks for pages."""
    place = HERE / "notebooks"
    place.mkdir(exist_ok=True)
    for path in EXAMPLES.glob("*.ipynb"):
        shutil.copyfile(path, place / path.name)


def formula(writer: Any, node: Any) -> None:
    """A formula as MathML, which browsers typeset without a script."""
    is_block = isinstance(node, nodes.math_block)
    writer.body.append(convert(node.astext(), display="block" if is_block else "inline"))
    raise nodes.SkipNode


def setup(app: Any) -> None:
    app.add_html_math_renderer("mathml", (formula, None), (formula, None))
    app.connect("builder-inited", notebooks_beside_pages)
    app.connect("source-read", filled)
