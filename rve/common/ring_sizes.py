"""A ring as makers write it: inner and outer diameter, wire, aspect ratio, gauge; r1 and r2 of these, and back.

Every size is linear in r1 and r2: inner = 2 (r1 - r2), outer = 2 (r1 + r2), wire = 2 r2, and AR = inner/wire is
r1 - (AR + 1) r2 = 0. Two of them that are not the same one give both radii.
"""

import re
from collections.abc import Mapping
from itertools import combinations
from typing import Annotated, Any

from msgspec import Meta

from rve.common.cell_fields import Length
from rve.common.errors import InputError, shown
from rve.common.texts import digits, numbers_of
from rve.common.typed import read_entry, refuse_unknown

RING_SIZES: dict[str, tuple[float, float]] = {
    "r1": (1.0, 0.0),
    "r2": (0.0, 1.0),
    "inner": (2.0, -2.0),
    "outer": (2.0, 2.0),
    "wire": (0.0, 2.0),
    "gauge": (0.0, 2.0),
    "ar": (1.0, -1.0),  # and AR of r2 less
}
"""Shares of r1 and r2 in each size that a user may give."""
DEFAULT_RING = {"r1": 5.0, "r2": 0.5}
"""The ring of the paper, in mm."""
SWG_MIL = [
    *(500, 464, 432, 400, 372, 348, 324, 300, 276, 252, 232, 212, 192, 176, 160, 144, 128, 116, 104, 92, 80, 72, 64),
    *(56, 48, 40, 36, 32, 28, 24, 22, 20, 18, 16.4, 14.8, 13.6, 12.4, 11.6, 10.8, 10, 9.2, 8.4, 7.6, 6.8, 6, 5.2),
    *(4.8, 4.4, 4, 3.6, 3.2, 2.8, 2.4, 2, 1.6, 1.2, 1),
]
"""Imperial standard wire gauge, 7/0 to 50, in 1/1000 inch: Order in Council of 23 August 1883, BS 3737:1964."""


def gauge_mm(text: str, where: str = "gauge") -> float:
    """Diameter in mm of wire of a trade size: American (AWG, Brown and Sharpe, ASTM B258) or imperial standard (SWG).

    >>> [round(gauge_mm(text), 3) for text in ("16 awg", "SWG 16", "4/0 AWG", "7/0 swg")]
    [1.291, 1.626, 11.684, 12.7]
    """
    parts = re.fullmatch(r"(awg|swg|)(0+|\d\d?)(/0|)(awg|swg|)", re.sub(r"\s", "", str(text)).lower())
    if parts is None or (parts[1] == "") == (parts[4] == ""):
        raise InputError(f"{where} = {shown(text)}: is no trade size; write 16 awg (1.291 mm) or 16 swg (1.626 mm)")
    zeros = int(parts[2]) if parts[3] else len(parts[2]) if int(parts[2]) == 0 else 0
    number, kind = 1 - zeros if zeros else int(parts[2]), parts[1] or parts[4]
    first, last = (-3, 40) if kind == "awg" else (-6, 50)
    if not first <= number <= last:
        raise InputError(f"{where} = {shown(text)}: {kind} has the sizes {1 - first}/0 to {last}")
    return 0.127 * 92.0 ** ((36 - number) / 39.0) if kind == "awg" else 0.0254 * SWG_MIL[number - first]


def radii_of(
    given: Mapping[str, Any], prefix: str = "", default: Mapping[str, float] | None = None
) -> tuple[float, float]:
    """r1 and r2 in mm of the sizes given by the keys of `RING_SIZES`; those with the value None count as absent.

    default: what completes r1 or r2 alone, and stands where nothing is given; `prefix` stands before keys in messages.
    InputError for sizes that are too few, contradict each other, or make no ring.

    >>> radii_of({"inner": 8.0, "wire": 1.6})
    (4.8, 0.8)
    """
    asked = {key: value for key, value in given.items() if value is not None}
    if asked.keys() <= {"r1", "r2"}:
        asked = {**(default or {}), **asked}
        if len(asked) == 2:
            return asked["r1"], asked["r2"]
    rows = {f"{prefix}{key} = {value}".removesuffix(".0"): _row(key, value, prefix) for key, value in asked.items()}
    two = [pair for pair in combinations(rows, 2) if _det(*(rows[name] for name in pair))]
    if not two:
        said = ", ".join(rows) or "no size"
        raise InputError(f"{said}: makes no ring yet; give two sizes, such as {prefix}inner and {prefix}wire in mm")
    (a, b, x), (c, d, y) = (rows[name] for name in two[0])
    det, said = _det((a, b, x), (c, d, y)), ", ".join(two[0])
    r1, r2 = (float(f"{one:.12g}") for one in ((d * x - b * y) / det, (a * y - c * x) / det))  # 4.8, not 4.7999999999
    if not 0.0 < r2 < r1:
        raise InputError(f"{said}: makes no ring; its r1 would be {r1:.4g} mm, its r2 {r2:.4g} mm")
    for third, (a, b, x) in rows.items():
        # Relative difference up to which a third size agrees with two: printed ones are rounded, as 1.29 mm of 16
        # AWG.
        if abs(a * r1 + b * r2 - x) > 1e-3 * (x or r1):
            raise InputError(f"{third}: contradicts {said}, which is {ring_words(r1, r2)}; give two sizes")
    return r1, r2


def _row(key: str, value: Any, prefix: str) -> tuple[float, float, float]:
    """a, b and c of the equation a r1 + b r2 = c that a size states; InputError for one that is out of range."""
    a, b = RING_SIZES[key]
    if key == "gauge":
        return a, b, gauge_mm(value, prefix + key)
    kind = Annotated[float, Meta(gt=0.0, le=1e4)] if key == "ar" else Length
    number: float = read_entry({prefix + key: value}, prefix + key, kind)
    return (a, -number - 1.0, 0.0) if key == "ar" else (a, b, number)


def _det(first: tuple[float, float, float], second: tuple[float, float, float]) -> float:
    """0 for two equations of which one says what the other does."""
    return first[0] * second[1] - first[1] * second[0]


def radii_in(text: str, option: str) -> tuple[float, float]:
    """r1 and r2 in mm of a text: "R1,R2" in mm, or sizes by name.

    >>> radii_in("5,0.5", "--cell"), radii_in("inner=8, wire=1.6", "--cell")
    ((5.0, 0.5), (4.8, 0.8))
    """
    if "=" not in text:
        if text.count(",") != 1:
            raise InputError(f"{option} = {shown(text)}: give R1,R2 in mm, or two sizes by name, inner=8,wire=1.6")
        r1, r2 = numbers_of(text, option, "R1,R2")
        return r1, r2
    parts = [part.partition("=") for part in text.split(",")]
    named: dict[str, Any] = {key.strip(): value.strip() for key, _, value in parts}
    refuse_unknown(named, RING_SIZES, option, "size")
    return radii_of(
        {key: value if key == "gauge" else numbers_of(value, f"{option}: {key}")[0] for key, value in named.items()},
        f"{option}: ",
    )


def ring_sizes(r1: float, r2: float) -> dict[str, float]:
    """A ring in both spellings: radii and diameters in mm, and the aspect ratio.

    >>> ring_sizes(4.5, 0.5)["aspect_ratio"]
    8.0
    """
    sizes = {"r1_mm": r1, "r2_mm": r2, "inner_mm": 2.0 * (r1 - r2), "outer_mm": 2.0 * (r1 + r2), "wire_mm": 2.0 * r2}
    return sizes | {"aspect_ratio": r1 / r2 - 1.0}


def ring_words(r1: float, r2: float) -> str:
    """Both spellings as a sentence says them.

    >>> ring_words(4.8, 0.8)
    'r1 = 4.8, r2 = 0.8 mm (inner diameter 8, outer 11.2, wire 1.6 mm, AR 5)'
    """
    big, small, inner, outer, wire, ratio = (digits(size, 4) for size in ring_sizes(r1, r2).values())
    return f"r1 = {big}, r2 = {small} mm (inner diameter {inner}, outer {outer}, wire {wire} mm, AR {ratio})"
