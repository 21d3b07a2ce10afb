"""docs/reference/scenes.md says of every noun of a scene what the program does: keys, defaults, ranges, words."""

import math
import re
import tomllib
from dataclasses import MISSING, fields
from pathlib import Path

import pytest

import macro_fem
import macro_fem.scene.scene  # whose import makes all kinds known
from macro_fem import Ball
from macro_fem.scene import Load, Obstacle, Shape, Support
from rve.common import typed, types_of

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "scenes.md"
NOUNS = [cls for base in (Shape, Support, Load, Obstacle, Ball) for cls in base.kinds.values()]
NOUNS += [macro_fem.Mesh, macro_fem.Loading, macro_fem.Solver, macro_fem.Start, macro_fem.Motion]
RANGE = re.compile(r"(above )?(-?[\d.e-]+),? to (-?[\d.e]+)$")
HEADERS = ("key", "noun", "---")


def rows(heading):
    """Cells of the table below a heading of the page, by first cell."""
    text = PAGE.read_text("utf-8")
    part = re.split(r"^#+ ", text.split(f"# {heading}\n", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in part.splitlines() if line[:2] == "| "]
    return {row[0].strip("` "): row[1:] for row in cells if row[0].strip("- |") and row[1:] and row[0] not in HEADERS}


def nouns():
    """The cell of keys by the name of each class."""
    headings = ("[curtain]", "[[support]]", "[[load.KIND]], [load]", "[[obstacle]], [start]", "[motion], [[body]]")
    headings += ("[mesh], [solver]",)
    return {first.split("`")[-1]: row[0] for name in headings for first, row in rows(name).items()}


def keys_of(cell):
    """Keys of a cell: whether each is required, and its default, None without one."""
    found = re.findall(r"(\*\*)?`(\w+)`(?:\*\*)?(?: = (\[[^\]]*\]|\"[^\"]*\"|[^,]+))?", cell)
    return {key: (bool(bold), tomllib.loads(f"x = {told}")["x"] if told else None) for bold, key, told in found}


def listed(value):
    """A value with lists for tuples, as TOML has it."""
    return [listed(item) for item in value] if isinstance(value, tuple) else value


@pytest.mark.parametrize("noun", NOUNS, ids=lambda noun: noun.__name__)
def test_keys_and_defaults_are_those_of_the_class(noun):
    assert getattr(macro_fem, noun.__name__) is noun
    told = keys_of(nouns()[noun.__name__])
    if issubclass(noun, Shape):
        told |= keys_of(nouns()["every shape"])
    if issubclass(noun, Support):
        told |= keys_of(nouns()["every support"])
    if issubclass(noun, Load | Obstacle):
        told |= keys_of(nouns()["every load, every obstacle"])
    true = {
        item.name: (item.default is MISSING, None if item.default is MISSING else listed(item.default))
        for item in fields(noun)
    }
    assert told == true


@pytest.mark.parametrize("noun", NOUNS, ids=lambda noun: noun.__name__)
def test_ranges_and_words_are_those_of_the_types(noun):
    said = rows("Keys")
    for key, kind in types_of(noun).items():
        if key == "history":  # pairs, which no row of ranges can tell
            continue
        if key not in said:
            assert not re.search(r"Meta\((ge|gt)=(?!1e-06|-1000000000.0|-1000000000000.0)|Literal", repr(kind)), key
            continue
        if allowed := RANGE.match(said[key][0]):
            within_range(lambda x, key=key, kind=kind: typed(x, kind, key), allowed, "int" in repr(kind))
        else:
            words = tomllib.loads(f"x = [{said[key][0]}]")["x"]
            assert [typed(word, kind, key) for word in words] == words
            told = ", ".join(str(word).lower() if isinstance(word, bool) else word for word in words)
            with pytest.raises(ValueError, match=re.escape(f"is not one of {told}")):
                typed("abracadabra", kind, key)


def within_range(check, said, is_whole):
    """The ends of a range pass a check, and what lies just outside does not."""
    low, high = float(said[2]), float(said[3])
    below, beyond = (
        (low - 1, high + 1) if is_whole else (math.nextafter(low, -math.inf), math.nextafter(high, math.inf))
    )
    number = int if is_whole else float
    check(number(high))
    for outside in ([low] if said[1] else []) + [below, beyond]:
        with pytest.raises(ValueError, match="expected "):
            check(number(outside))
    if not said[1]:
        check(number(low))
