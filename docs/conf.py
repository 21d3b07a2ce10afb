"""The documentation site: python -m sphinx -W -b html docs out/docs

Warnings are errors, so that every link between pages leads somewhere. Pages that must be complete are written from the
code as they are read: the public names (`@names PACKAGE@`), and the gallery from the scenes in examples/ (`@gallery@`).
"""

from __future__ import annotations

import importlib
import re
import shutil
import tomllib
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

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
myst_enable_extensions = ["colon_fence"]
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


def gallery() -> str:
    """A section for each scene of examples/: its picture, what it is, the file."""
    parts = []
    for path in sorted(EXAMPLES.rglob("*.toml")):
        text = path.read_text(encoding="utf-8")
        words = " ".join(line.lstrip("# ") for line in text.splitlines() if line.startswith("#"))
        name, where = path.stem.replace("_", " "), path.relative_to(HERE.parent).as_posix()
        assert tomllib.loads(text)
        parts.append(f"## {name.capitalize()}\n\n{words}\n")
        picture = EXAMPLES / "pictures" / f"{path.stem}.png"
        if picture.exists():
            shown = picture.relative_to(HERE.parent).as_posix()
            parts.append(f"```{{image}} ../{shown}\n:alt: {name}\n:width: 100%\n```\n")
        parts.append(f"```bash\npython -m macro_fem run {where} --out out\n```\n")
        parts.append(f"```{{literalinclude}} ../{where}\n:language: toml\n```\n")
    return "\n".join(parts)


def filled(app: Any, page: str, source: list[str]) -> None:
    """The text of a page with what is written from the code."""
    source[0] = re.sub(r"^@names (\w+)@$", lambda found: names(found[1]), source[0], flags=re.MULTILINE)
    source[0] = re.sub(r"^@gallery@$", lambda found: gallery(), source[0], flags=re.MULTILINE)


def notebooks_beside_pages(app: Any) -> None:
    """The notebooks of examples/ where Sphinx looks for pages."""
    place = HERE / "notebooks"
    place.mkdir(exist_ok=True)
    for path in EXAMPLES.glob("*.ipynb"):
        shutil.copyfile(path, place / path.name)


def setup(app: Any) -> None:
    app.connect("builder-inited", notebooks_beside_pages)
    app.connect("source-read", filled)
