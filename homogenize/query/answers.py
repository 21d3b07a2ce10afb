"""Answers for the command line: the strain under a load direction and the support at a load, as plain dictionaries."""

from dataclasses import asdict
from pathlib import Path

import numpy as np

from homogenize.directions import beyond, hull_of, limits_of
from homogenize.io import load_law
from homogenize.laws.plastic import limit_surface
from homogenize.laws.polyhedral import PolyhedralLaw
from homogenize.laws.rows import LockedRows, with_mirror
from homogenize.laws.stored import Law
from homogenize.laws.strength import MAKE_AGAIN
from homogenize.query.strain import locked_strain
from rve.common import Array, InputError, JsonObject
from rve.common.tensor import double_dot, eigenvalues, trace
from rve.geometry import cauchy_of
from rve.locking import string_states
from rve.wire import rupture_stress

ROUNDING = 1e-12


def strain_answer(path: str | Path, alpha_deg: float, beta_deg: float) -> JsonObject:
    """E of the law under the Cauchy load direction, its bounds, S of unit trace, h, and two warnings.

    E11_min ... E22_max bound the strain at which the rings lock, as the rows of the table prove; None if the law file
    has no rows. A row's own load is answered with the row. `unique` is false where another strain carries the same load
    or the bounds are too wide to tell, `extrapolated` true where the table has no load around this one. InputError if
    the load is not tensile or no strain is found.
    """
    law = load_law(path)
    told = f"--alpha {alpha_deg} --beta {beta_deg}"
    if not (np.isfinite(alpha_deg) and 0.0 <= beta_deg <= 90.0):
        raise InputError(f"{told}: angles are finite, and beta is from 0 to 90 degrees, as rings cannot push")
    found = locked_strain(law, np.array([alpha_deg]), np.array([beta_deg]), law.rows)
    if found.status[0] != "converged":
        raise InputError(
            f"{path}: no strain of this law carries {told}: the direction is missed by {found.residual[0]:.1e}; "
            "try a neighbouring angle"
        )
    E, S = found.E[0], found.S[0]
    return {
        "alpha_deg": alpha_deg,
        "beta_deg": beta_deg,
        **components("E{}", E),
        **components("E{}_min", found.E_min[0]),
        **components("E{}_max", found.E_max[0]),
        **components("S{}", S),
        "h": float(double_dot(S, E)),
        "unique": bool(found.unique[0]),
        "extrapolated": extrapolates(law.rows, S),
    }


def components(key: str, values: Array) -> dict[str, float]:
    """Named components of a triple (3,)."""
    return {key.format(name): float(x) for name, x in zip(("11", "12", "22"), values, strict=True)}


def support_answer(path: str | Path, S: Array, strings: bool = False) -> JsonObject:
    """h of the law at the load S (3,), with `strings` also that of its rings drawn to strings; InputError if S is not
    tensile, or the rings are not known."""
    law, size = load_law(path), check_tensile(S)
    found = {"h": float(law.support(S[None])[0]), "extrapolated": extrapolates(law.rows, S / size)}
    if not strings:
        return found
    if law.cell is None:
        raise InputError(f"{path}: --strings: the law does not tell its rings; fit it with --cell R1,R2[,WEAVE]")
    return found | string_states(law.cell.cell(), S[None], law.cell.sides_mm).row(0)


def strength_answer(path: str | Path, S: Array, yield_N_per_mm2: float | None = None) -> JsonObject:
    """The line loads S (3,) of unit trace times which the rings of a law first yield and collapse, leave the convex
    set inside of the collapse loads and their hull, with the largest ratio of both over all directions, and the band in
    which they break once they are drawn to strings.

    InputError if the law has no strength, S is not tensile, or no yield stress is known.
    """
    law = load_law(path)
    strength = law.strength
    if strength is None:
        again = "only a law of rings has one" if law.cell is None else MAKE_AGAIN
        raise InputError(f"{path}: holds no strength; {again}")
    unit = S[None] / check_tensile(S)
    try:
        stress = strength.yield_stress(yield_N_per_mm2)
        used = [f(unit, stress)[0] for f in (strength.utilisation, strength.collapse_utilisation)]
        compliance = float(strength.compliance_along(unit)[0])
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    limits: dict[str, float | None] = dict.fromkeys(("safe_N_per_mm", "hull_N_per_mm", "hull_over_safe_max"))
    if isinstance(law, PolyhedralLaw):
        surface = limit_surface(law)
        safe, hull = (stress * float(one[0]) for one in surface.loads(unit))
        limits = dict(zip(limits, (safe, hull, surface.difference), strict=True))
    return {
        **components("S{}", unit[0]),
        "yield_N_per_mm2": stress,
        "first_yield_N_per_mm": float(1.0 / used[0]),
        "collapse_N_per_mm": float(1.0 / used[1]),
        **limits,
        "strings_break_N_per_mm": _strings_break(law, unit),
        "compliance_mm_per_N": compliance,
        "error_between_rows": None if strength.error is None else asdict(strength.error),
        "material": strength.material.name,
        "joint": strength.joint,
        "extrapolated": bool(strength.extrapolates(unit)[0]),
    }


def _strings_break(law: Law, unit: Array) -> tuple[float, float] | None:
    """The band of line loads in N/mm, `unit` times which rings drawn to strings break; None for butted rings, which
    open, and where weave or ultimate stress is not known."""
    info, known = law.cell, law.strength
    if info is None or info.pattern is None or known is None or known.joint != "welded":
        return None
    band = rupture_stress(known.material)
    if band is None:
        return None
    stress = float(string_states(info.cell(), unit, info.sides_mm).stress[0])
    return band[0] / stress, band[1] / stress


def check_tensile(S: Array) -> float:
    """S11 + S22 of a load S (3,); InputError unless both principal values are 0 or more, and one is more."""
    size = float(trace(S))
    if not size > 0.0 or float(eigenvalues(S)[0]) < -ROUNDING * size:
        raise InputError(f"--S {S[0]},{S[1]},{S[2]}: not tensile; a principal line load is negative or all are zero")
    return size


def extrapolates(rows: LockedRows | None, S: Array) -> bool:
    """Whether a table of these rows has no loads around S (3,) of unit trace; false without a table. InputError for
    rows of which no law is fitted."""
    if rows is None:
        return False
    hull_of(rows.S, rows.is_mirrored)
    both = with_mirror(rows)
    return bool(beyond(limits_of(both.S, cauchy_of(both.S, both.E)), S[None])[0])
