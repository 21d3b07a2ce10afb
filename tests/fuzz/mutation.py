"""Mutations of valid files: bytes, numbers in text, values and structure of JSON, each a function of a random source.

Seeds are stated by the caller, so that every input can be made again.
"""

import json
import re
from random import Random

NUMBERS = ["0", "-0", "1", "-1", "2", "1e308", "-1e308", "1e-308", "1e400", "nan", "NaN", "inf", "-Infinity", "1e9"]
NUMBERS += ["4294967295", "2147483648", "-2147483649", "9223372036854775808", "1" + "0" * 30, "1" * 5000, "0x10"]
NUMBERS += ["1_0", "100000000", "1000000000000", "true", "null", '""', "[]", "{}", "[[[[[[]]]]]]", "''", "0.1.2", ""]
WORDS = [
    b"\x00",
    b"\xff\xfe",
    b"\r",
    b"\n\n",
    b",",
    b'"',
    b"'",
    b"[",
    b"]",
    b"{",
    b"}",
    b"=",
    b"<",
    b">",
    b"$",
    b"&#0;",
]
WORDS += [
    b"[" * 3000,
    b'{"a":' * 3000,
    b"a." * 3000,
    b"," * 300,
    b"\xc3\x28",
    "é🙂\ud7ff".encode(),
    b"1 " * 500,
    b"-" * 50,
]
VALUES = [
    None,
    True,
    False,
    0,
    -1,
    1e308,
    -1e308,
    1e-320,
    float("nan"),
    float("inf"),
    10**400,
    2**63,
    "",
    "x",
    "\ud800",
]
VALUES += [[], {}, [[]], [1, [2]], [[1, 2], [3]], {"a": 1}, [None], ["1"], -5, 0.5, 1e9, 5, [0.0] * 3]
VALUES += [[[0.0] * 3] * 3]
_NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")


def mutated_bytes(content: bytes, random: Random) -> bytes:
    """One to four changes of bytes, words or numbers."""
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        content = random.choice((_flip, _cut, _truncate, _repeat, _insert, _number, _number, _number, _line))(
            content, random
        )
    return content


def _place(content: bytes, random: Random) -> int:
    return random.randrange(len(content) + 1)


def _flip(content: bytes, random: Random) -> bytes:
    out = bytearray(content)
    for _ in range(random.choice((1, 3, 20))):
        if out:
            out[random.randrange(len(out))] ^= 1 << random.randrange(8)
    return bytes(out)


def _cut(content: bytes, random: Random) -> bytes:
    start = _place(content, random)
    return content[:start] + content[start + random.choice((1, 4, 50, 1000)) :]


def _truncate(content: bytes, random: Random) -> bytes:
    return content[: _place(content, random)]


def _repeat(content: bytes, random: Random) -> bytes:
    start = _place(content, random)
    part = content[start : start + random.choice((1, 8, 100))]
    return content[:start] + part * random.choice((2, 3, 300)) + content[start:]


def _insert(content: bytes, random: Random) -> bytes:
    start = _place(content, random)
    return content[:start] + random.choice(WORDS) + content[start:]


def _number(content: bytes, random: Random) -> bytes:
    found = list(_NUMBER.finditer(content))
    if not found:
        return _insert(content, random)
    one = random.choice(found)
    return content[: one.start()] + random.choice(NUMBERS).encode() + content[one.end() :]


def _line(content: bytes, random: Random) -> bytes:
    lines = content.split(b"\n")
    at = random.randrange(len(lines))
    return b"\n".join(random.choice(([*lines[:at], *lines[at + 1 :]], [*lines[: at + 1], *lines[at:]])))


def mutated_json(content: bytes, random: Random) -> bytes:
    """One to three values replaced, keys removed, renamed or added, lists cut or lengthened; else bytes changed."""
    if random.random() < 0.2:
        return mutated_bytes(content, random)
    data = json.loads(content)
    for _ in range(random.choice((1, 1, 2, 3))):
        data = _changed(data, random)
    return json.dumps(data).encode()


def _changed(value, random: Random):
    """A copy with one change, somewhere below."""
    if isinstance(value, dict) and value and random.random() < 0.9:
        key = random.choice(list(value))
        kind = random.randrange(10)
        if kind == 0:
            return {name: one for name, one in value.items() if name != key}
        if kind == 1:
            return value | {random.choice(("", "x", "\x00", "S" * 9999)): random.choice(VALUES)}
        return value | {key: _changed(value[key], random)}
    if isinstance(value, list) and value and random.random() < 0.8:
        at = random.randrange(len(value))
        kind = random.randrange(8)
        if kind == 0:
            return value[:at] + value[at + 1 :]
        if kind == 1:
            return value[:at] + [random.choice(VALUES)] * random.choice((1, 50)) + value[at:]
        return [*value[:at], _changed(value[at], random), *value[at + 1 :]]
    if isinstance(value, int | float) and abs(value) < 1e300 and random.random() < 0.4:
        return value * random.choice((-1, 0, 1 + 1e-9, 1e-12, 1e12, 1e200, 0.5, 2)) + random.choice((0, 0, 1, -1, 1e-3))
    return random.choice(VALUES)
