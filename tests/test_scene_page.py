"""docs/reference/scenes.md says of every key of a scene what the program does: name, default, range, words."""

import math
import re
import tomllib
from dataclasses import MISSING, fields
from pathlib import Path

import pytest

from macro_fem import read_scene
from macro_fem.scene import obstacles, tables
from rve.common.errors import InputError

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "scenes.md"
RECORDS = {"[curtain]": tables.Curtain, "[mesh]": tables.Mesh, "[load]": tables.Load, "[solver]": tables.Solver}
RECORDS |= {f'kind = "{kind}"': record for kind, record in tables.SUPPORTS.items()}
RECORDS |= {f'obstacle kind = "{kind}"': record for kind, record in obstacles.OBSTACLES.items()}
RECORDS |= {f"[[load.{kind}]]": record for kind, record in tables.LIVE_LOADS.items()}
RECORDS |= {"[start]": obstacles.Start}
CASES = [pytest.param(heading, record, id=heading) for heading, record in RECORDS.items()]
# A value of each type of the page that holds the number x.
HOLDING = {
    "number": lambda x: x,
    "whole number": int,
    "number or vector": lambda x: x,
    "vector": lambda x: [x, 0.5],
    "direction": lambda x: [x, 0.5, 1.0],
    "place": lambda x: [x, 0.5],
    "point in space": lambda x: [x, 0.5, 1.0],
    "lengths": lambda x: [x, 0.5, 1.0],
    "points": lambda x: [[x, 0.5], [1.0, 0.0], [2.0, 3.0]],
    "plan points": lambda x: [[x, 0.5], [1.0, 0.0]],
    "two points": lambda x: [[x, 0.5, 1.0], [1.0, 0.0, 2.0]],
    "polygons": lambda x: [[[x, 0.5], [1.0, 0.0], [2.0, 3.0]]],
}
RANGE = re.compile(r"(above )?(-?[\d.e-]+),? to (-?[\d.e]+)$")


def rows(heading):
    """Cells of the table below a heading of the page, by key."""
    text = PAGE.read_text("utf-8")
    part = re.split(r"^#+ ", text.split(f"# {heading}\n", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in part.splitlines() if line[:3] == "| `"]
    return {row[0].strip("` "): row[1:] for row in cells}


def listed(value):
    """A value with lists for tuples, as TOML has it."""
    return [listed(item) for item in value] if isinstance(value, tuple) else value


@pytest.mark.parametrize(("heading", "record"), CASES)
def test_keys_and_defaults_are_those_of_the_record(heading, record):
    found = rows(heading)
    of_record = {
        item.name: item.default for item in fields(record) if record is not tables.Load or "check" in item.metadata
    }
    assert found.keys() == of_record.keys()
    for key, default in of_record.items():
        told = found[key][1]
        if default is MISSING or default is None:
            assert told == ("required" if default is MISSING else "-"), key
        else:
            assert tomllib.loads(f"x = {told}")["x"] == listed(default), key


@pytest.mark.parametrize(("heading", "record"), CASES)
def test_ranges_and_words_are_those_of_the_checks(heading, record):
    checks = {item.name: item.metadata["check"] for item in fields(record) if "check" in item.metadata}
    for key, (kind, _, allowed, _) in rows(heading).items():
        kind = kind.split(",")[0]
        if kind == "word":
            words = tomllib.loads(f"x = [{allowed}]")["x"]
            assert [checks[key](word) for word in words] == words
            with pytest.raises(ValueError, match=re.escape(f"is not one of {', '.join(words)}")):
                checks[key]("abracadabra")
        elif allowed:
            within_range(checks[key], HOLDING[kind], RANGE.match(allowed), kind == "whole number")
        else:
            assert kind in ("text", "edge", "true or false"), key


def within_range(check, holding, said, is_whole):
    """The ends of a range pass a check, and what lies just outside does not."""
    low, high = float(said[2]), float(said[3])
    below, beyond = (
        (low - 1, high + 1) if is_whole else (math.nextafter(low, -math.inf), math.nextafter(high, math.inf))
    )
    check(holding(high))
    for outside in ([low] if said[1] else []) + [below, beyond]:
        with pytest.raises(ValueError, match=r"must be|is not|is neither|has a component|\[material\]|no line"):
            check(holding(outside))
    if not said[1]:
        check(holding(low))


def scene(**material):
    return read_scene({"curtain": {"width": 1.0, "height": 1.0}, "support": {"kind": "top"}, "material": material})


def test_the_keys_of_material_are_those_that_are_read():
    found = rows("[material]")
    with pytest.raises(InputError, match="known are ") as error:
        scene(density_kg=1.0)
    known = set(str(error.value).split("known are ")[1].split(", "))
    assert found.keys() == known - {"poisson"}  # which a law of rings refuses
    for key, (kind, default, allowed, _) in found.items():
        assert default == "-"
        if kind != "text":
            within_range(lambda x, key=key: checked_material(key, x), float, RANGE.match(allowed), False)


def checked_material(key, x):
    try:
        scene(**{key: x})
    except InputError as error:
        raise ValueError(str(error)) from error


def test_the_drawings_are_those_of_the_script():
    from docs import drawings

    written = {path.stem for path in (PAGE.parents[1] / "drawings").glob("*.svg")}
    assert written == set(drawings.DRAWINGS)
    pages = "".join(path.read_text("utf-8") for path in PAGE.parents[1].rglob("*.md"))
    assert not {name for name in written if f"drawings/{name}.svg" not in pages}
