"""The documentation site: python -m sphinx -W -b html docs out/docs

Warnings are errors, so that every link between pages leads somewhere. Two pages show more on the site than in the
repository: each public name in the lists leads to a page of its own, and below a scene of the gallery stands its file.
"""

from __future__ import annotations

import importlib
import re
import shutil
from collections.abc import Mapping
from dataclasses import is_dataclass
from importlib import metadata
from inspect import signature
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from numpy.typing import ArrayLike
from sphinx.util.typing import stringify_annotation

from rve.common import Array
from rve.common.typed import Typed

HERE = Path(__file__).parent
EXAMPLES = HERE.parent / "examples"
PACKAGES = ("rve", "homogenize", "macro_fem")
WORDS = {stringify_annotation(kind, "smart"): word for kind, word in ((ArrayLike, "ArrayLike"), (Array, "ndarray"))}
"""Types in the words of users."""
SENTENCE_END = re.compile(r"(?<=[^\s.])(?<!\b[A-Z])\. (?=[A-Z`]|[a-z_]+:)")
"""A dot behind a word that is no initial, and before a capital letter, a name, or the explanation of one."""
NESTED = r"(?:[^\[\]]|\[(?:[^\[\]]|\[[^\[\]]*\])*\])+?"
RANGED = re.compile(rf"~?(?:typing\.)?Annotated\[({NESTED}), ~?msgspec\.Meta\([^()]*\)\]")
"""A type with a range; ranges are those of the tables of scenes."""

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


def pages_of_names(app: Any) -> None:
    """A page for every public name: its docstring, and its parameters with their types as a list."""
    place = HERE / "names"
    place.mkdir(exist_ok=True)
    for package in PACKAGES:
        for name in importlib.import_module(package).__all__:
            found = getattr(importlib.import_module(package), name)
            whole = f"{package}.{name}"
            if isinstance(found, Mapping):
                text = f"A mapping with the names {', '.join(map(str, found))}."
            else:
                kind = "autoclass" if isinstance(found, type) else "autofunction" if callable(found) else "autodata"
                is_noun = isinstance(found, type) and issubclass(found, Typed)  # of which users only give the fields
                members = "\n   :members:" if kind == "autoclass" and not is_noun else ""
                text = f"```{{eval-rst}}\n.. {kind}:: {whole}{members}\n```"
            (place / f"{whole}.md").write_text(f"# {whole}\n\n{text}\n", encoding="utf-8")


def filled(app: Any, page: str, source: list[str]) -> None:
    """The text of a page with links to names, and scene files, in it."""
    if page == "reference/python":
        listed = re.compile(r"^## (\w+)\n\nNames: .*$", re.MULTILINE)
        source[0] = listed.sub(lambda found: f"## {found[1]}\n\n{links(found[1])}", source[0])
    if page == "gallery":
        file = r"\1\n\n```{literalinclude} \2\n:language: toml\n```"
        source[0] = re.sub(r"^(\[`examples/\w+\.toml`\]\((\S+)\))$", file, source[0], flags=re.M)


def links(package: str) -> str:
    """A table of the public names of a package with the first sentence of each, and their pages in the contents."""
    names = importlib.import_module(package).__all__
    rows = "".join(f"| [{name}](../names/{package}.{name}.md) | {_first(package, name)} |\n" for name in names)
    pages = "\n".join(f"{name} <../names/{package}.{name}>" for name in names)
    return f"| name | |\n| --- | --- |\n{rows}\n```{{toctree}}\n:hidden:\n{pages}\n```\n"


def _first(package: str, name: str) -> str:
    """The first sentence of what a name is; a dot between lower-case words, of a product or "eq." say, ends none."""
    found = getattr(importlib.import_module(package), name)
    if isinstance(found, Mapping):
        return ", ".join(map(str, found))
    text = found.__doc__ or "" if callable(found) else f"{found}"
    return SENTENCE_END.split(" ".join(text.split("\n\n")[0].split()))[0].replace("|", "\\|")


def signature_of_fields(app: Any, what: str, name: str, found: Any, *rest: Any) -> tuple[str, None] | None:
    """The fields of a record as what it is made of; and the types of parameters in the words that users read."""
    known = app.env.current_document.autodoc_annotations.get(name, {})
    for key, text in known.items():
        for _ in range(3):  # ranges of tuples of tuples
            text = RANGED.sub(r"\1", text)
        for kind, word in WORDS.items():
            text = text.replace(kind, word)
        known[key] = text
    if not (isinstance(found, type) and issubclass(found, Typed) and is_dataclass(found)):
        return None
    given = signature(found.__init__)
    parameters = [one.replace(annotation=one.empty) for one in given.parameters.values() if one.name != "self"]
    return str(given.replace(parameters=parameters, return_annotation=given.empty)), None


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
    app.connect("builder-inited", pages_of_names)
    app.connect("source-read", filled)
    app.connect("autodoc-process-signature", signature_of_fields, priority=900)
