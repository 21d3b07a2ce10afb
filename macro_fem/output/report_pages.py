"""Pages of a report as PDF: their words and tables are data that report.typ sets (typst), their pictures SVG."""

import datetime
import math
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib import resources
from pathlib import Path
from tempfile import TemporaryDirectory

from macro_fem.output import plans
from macro_fem.scene.scene import Scene
from rve.common import atomic_path, checksum, json_text, require
from rve.common.optional import Figure

PAGE, GAP, HIGH = 174.0, 3.0, 88.0
"""Width of the text, between two pictures, and greatest height of one, mm."""


@dataclass(frozen=True)
class Picture:
    """A picture, `width` in mm, with the words below it."""

    draw: Callable[[float], Figure]
    width: float
    caption: str


Rows = Sequence[Sequence[Picture]]
"""Pictures side by side."""


@dataclass(frozen=True)
class PageTable:
    """Rows of texts below a head; `groups`: names over so many columns each. Columns of numbers stand at the right."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    groups: Sequence[tuple[str, int]] = ()


@dataclass(frozen=True)
class Chapter:
    """A title, paragraphs, rows of pictures, tables."""

    title: str
    text: Sequence[str] = ()
    pictures: Rows = ()
    tables: Sequence[PageTable] = ()


@dataclass(frozen=True)
class Headline:
    """What a reader decides by in a few lines, and whether it is good; None where that is not known."""

    lines: Sequence[str]
    holds: bool | None


def write_pages(
    path: str | Path, scene: Scene, headline: Headline, pictures: Rows, chapters: Sequence[Chapter],
    versions: Mapping[str, str], inputs: Iterable[Path | None] = (),
) -> None:  # fmt: skip
    """Write a report as PDF/UA, with a date of its project as PDF/A too, the same bytes for the same input.

    `pictures` are those of the first page, below the headline. InputError without typst, and if the file cannot be
    written. A letter that no font here has gives a PDF without the claim of a standard.
    """
    require("typst", "report", "a report")
    import matplotlib
    import typst

    project, day = scene.project, list[int]()
    with suppress(ValueError):
        date = datetime.date.fromisoformat(project.date)
        day = [date.year, date.month, date.day]
    files = [[one.name, checksum(one)] for one in inputs if one is not None]
    sums = [PageTable("", ("file", "SHA-256"), files)] if files else []
    told = ", ".join(f"{name} {number}" for name, number in versions.items())
    facts = {"client": project.client, "project": project.number, "author": project.author, "date": project.date}
    with TemporaryDirectory() as name:
        folder = Path(name)
        every = [*chapters, Chapter("Versions and files", [told], tables=sums)]
        data = {
            "title": project.title or f"Curtain of ring mesh: {scene.source.stem}",
            "author": [project.author] if project.author else [],
            "number": project.number,
            "date": day or None,
            "made_by": f"made by ring-mesh {versions['ring-mesh']}, {scene.source.name[:60]}",
            "project": [pair for pair in facts.items() if pair[1]],
            "lines": headline.lines,
            "tone": {None: "unknown", True: "good", False: "bad"}[headline.holds],
            "pictures": _drawn(pictures, folder, "first"),
            "sections": [
                {
                    "title": one.title,
                    "text": one.text,
                    "pictures": _drawn(one.pictures, folder, f"{number}"),
                    "tables": list(map(_set, one.tables)),
                }
                for number, one in enumerate(every)
            ],
        }
        (folder / "report.json").write_text(json_text(data), encoding="utf-8")
        shutil.copy(str(resources.files(__package__).joinpath("report.typ")), folder)
        fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
        make = partial(typst.compile, folder / "report.typ", font_paths=[fonts])
        try:
            content = make(pdf_standards=["ua-1", "a-2a"] if day else ["ua-1"])
        except typst.TypstError as error:
            if "could not be displayed" not in str(error):
                raise
            content = make()
    with atomic_path(path) as temporary:
        temporary.write_bytes(content or b"")


def _drawn(rows: Rows, folder: Path, begin: str) -> list[list[dict[str, object]]]:
    """Draw pictures into a folder, each to a file whose name begins so; what the template takes of them."""
    drawn = list[list[dict[str, object]]]()
    for k, row in enumerate(rows):
        drawn.append([])
        for m, one in enumerate(row):
            file = f"{begin}_{k}_{m}.svg"
            plans.save_drawing(folder / file, one.draw(one.width))
            drawn[-1].append({"file": file, "width": one.width, "caption": one.caption})
    return drawn


def _set(table: PageTable) -> dict[str, object]:
    """A table as the template takes it: a column whose cells are numbers stands at the right."""
    columns = zip(*table.rows, strict=True) if table.rows else [()] * len(table.head)
    align = "".join("r" if all(map(_is_number, column)) else "l" for column in columns)
    return {**vars(table), "align": list(align)}


def _is_number(text: str) -> bool:
    with suppress(ValueError):
        return math.isfinite(float(text or 0.0))
    return False
