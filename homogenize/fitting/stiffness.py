"""Stiffness beyond locking from the rings' own compliance.

Rings that give, or contacts of finite stiffness, make the locked strain depend on the size of the load, E = dh/dS + A
S. The compliance D = dE/dS of a row holds both: the bend of the locking surface, which has no part along S because h is
homogeneous of degree one, and A. So S:D S = S:A S, and one positive definite A with the symmetry of the weave is fitted
to these. The strength of the law keeps S:D S of every direction (`homogenize.strength`), of which
`homogenize.laws.giving` makes the law of elastic curtains.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from homogenize.laws.giving import constant_compliance, giving_law, work_along
from homogenize.laws.net import STATED_STIFFNESS
from homogenize.laws.polyhedral import PolyhedralLaw
from homogenize.laws.protocol import MembraneLaw
from rve.common.errors import InputError
from rve.common.types import Array

if TYPE_CHECKING:
    from rve import StrainTable

STATED_LOAD = 1.0
"""Size S11 + S22 in N/mm of the line load at which the compliance of elastic curtains is compared with the rows'."""


def stiffness_of(table: StrainTable) -> tuple[Array, str]:
    """Stiffness (3, 3) in tensor components, N/mm, and where it comes from: the table's compliance, or stated.

    InputError if the table has a compliance but no row with a finite positive S:D S.
    """
    if table.compliance is None:
        return STATED_STIFFNESS * np.eye(3), f"stated: {STATED_STIFFNESS:g} N/mm for every strain, not from the table"
    work = work_along(table.S, table.compliance)
    known = table.converged & table.unique & np.isfinite(work) & (work > 0.0)
    if not known.any():
        raise InputError("no row of the table has a compliance with S:D S > 0")
    A = constant_compliance(table.S[known], work[known], table.is_mirrored)
    share = work_along(table.S[known], A) / work[known]
    origin = (
        f"the rows' compliance along their own load, S:D S of the rows times {share.min():.3g} to {share.max():.3g}"
    )
    return np.asarray(np.linalg.inv(A)), origin


def stiffness_by_direction(law: MembraneLaw) -> str | None:
    """How well elastic curtains of a law meet S:D S of its rows, in words; None if it knows none."""
    giving = giving_law(law) if isinstance(law, PolyhedralLaw) else None
    if giving is None or giving.law.strength is None:
        return None
    known = giving.law.strength.stretched
    share = giving.compliance_along(known.S, STATED_LOAD) / known.compliance
    return f"elastic curtains: S:D S of the rows times {share.min():.3g} to {share.max():.3g} at {STATED_LOAD:g} N/mm"
