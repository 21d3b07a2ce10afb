"""A law with what its rows prove of it: the rings' own law lies between an inner and an outer polyhedron.

The hull of the rows' strains is inside the rings' law, the polyhedron of their half-spaces contains it
(`homogenize.fitting.bounds`). Two assumptions remain, see docs/theory.md: every row holds the largest work of its
load, which the outer one needs, and strains between locked ones are admissible, which the inner one needs.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from homogenize.fitting.bounds import inner_law, outer_law
from homogenize.fitting.fit_law import cell_of, stiffness_of
from homogenize.fitting.row_tests import rows_from_table
from homogenize.io import DEFAULT_LAW, load_law
from homogenize.laws.geometry import highest
from homogenize.laws.polyhedral import PolyhedralLaw
from homogenize.laws.protocol import MembraneLaw
from homogenize.laws.rows import LockedRows, with_mirror
from homogenize.laws.stored import Law
from homogenize.laws.strength import Strength, strength_of_table
from rve import read_table
from rve.common import Array, InputError, checked
from rve.geometry import CellInfo


@dataclass(frozen=True, eq=False)
class LawInterval:
    """`inner` contains nothing that the rings cannot do, `outer` all that they can; `law` is to be used between them.

    rows: what all three are made of. raised: largest work by which the strain of one row exceeds that of another under
    the other's load; h of that row is raised by it, so that `outer` contains `inner`.
    source: file that it was read from, for messages.
    """

    inner: MembraneLaw
    law: MembraneLaw
    outer: MembraneLaw
    rows: LockedRows = field(repr=False)
    raised: float = 0.0
    source: str = "law"

    def width(self, S: Array) -> Array:
        """How far apart the support functions of `outer` and `inner` are at loads S (n, 3), (n,)."""
        return np.maximum(self.outer.support(S) - self.inner.support(S), 0.0)


@checked
def law_interval(
    rows: LockedRows,
    law: MembraneLaw | None = None,
    stiffness: Array | None = None,
    cell: CellInfo | None = None,
    strength: Strength | None = None,
) -> LawInterval:
    """Inner and outer law of rows (n >= 4), and between them `law`, by default the inner one.

    `strength`: of the rings, for the inner law. InputError if the rows do not bound the strain under tension.

    >>> found = read_law_interval()
    >>> bool(found.width(np.array([[0.5, 0.0, 0.5]]))[0] < 1e-3)
    True
    """
    found = replace(rows, h=np.maximum(rows.h, highest(rows.S, with_mirror(rows).E)))
    inner = replace(inner_law(found, stiffness, cell), strength=strength)
    outer = outer_law(found, stiffness, cell)
    if isinstance(law, Law):
        inner, outer = (replace(one, stiffness_is_measured=law.stiffness_is_measured) for one in (inner, outer))
    return LawInterval(inner, inner if law is None else law, outer, found, float((found.h - rows.h).max()))


def read_law_interval(path: str | Path = DEFAULT_LAW) -> LawInterval:
    """The law in a file, by default that of r1/r2 = 10, with its rows; InputError without, as for nets."""
    found = interval_of_law(load_law(path), str(path))
    if found is None:
        raise InputError(f"{path}: provenance table_rows: are missing; make the law again with homogenize fit")
    return found


def interval_or_law(path: str | Path) -> MembraneLaw | LawInterval:
    """The law in a file with what its rows prove; the law alone without rows; InputError if it cannot be read."""
    law = load_law(path)
    return interval_of_law(law, str(path)) or law


def interval_of_table(path: str | Path) -> LawInterval:
    """What the rows of a strain-load table prove; InputError if it cannot be read or its rows do not bound the strain.

    Its law is the inner one.
    """
    table = read_table(path)
    rows, stiffness = rows_from_table(table), stiffness_of(table)[0]
    return replace(law_interval(rows, None, stiffness, cell_of(table), strength_of_table(table)), source=str(path))


def interval_of_law(law: Law, source: str) -> LawInterval | None:
    """The interval of a law fitted to rows, from the file `source`; None for a law without rows or not between them."""
    if not isinstance(law, PolyhedralLaw) or law.rows is None:
        return None
    return replace(law_interval(law.rows, law, law.stiffness, law.cell, law.strength), source=source)
