"""Answers for the command line: the strain under a load direction and the support at a load, as plain dictionaries."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from homogenize.io import LawFile, read_law_file
from homogenize.protocol import Array, InputError
from homogenize.report import is_sampled
from homogenize.strain import locked_strain
from homogenize.tensor import double_dot, eigenvalues, trace

ROUNDING = 1e-12


def strain_answer(path: str | Path, alpha_deg: float, beta_deg: float) -> dict[str, Any]:
    """E of the law under the Cauchy load direction, with S of unit trace, h, and what to beware of.

    `unique` is false where another strain carries the same load, `extrapolated` true where the table has no load around
    this one. InputError if the load is not tensile or no strain is found.
    """
    file = read_law_file(path)
    if not (np.isfinite(alpha_deg) and np.isfinite(beta_deg)):
        raise InputError(f"--alpha {alpha_deg} --beta {beta_deg}: angles are finite numbers of degrees")
    if not 0.0 <= beta_deg <= 90.0:
        raise InputError(
            f"--beta {beta_deg}: rings cannot push; both line loads are tensile for beta from 0 to 90 degrees"
        )
    found = locked_strain(file.law, np.array([alpha_deg]), np.array([beta_deg]))
    if found.status[0] != "converged":
        raise InputError(
            f"{path}: no strain of this law carries --alpha {alpha_deg} --beta {beta_deg}: the direction is missed "
            f"by {found.residual[0]:.1e}; try a neighbouring angle"
        )
    E, S = found.E[0], found.S[0]
    return {
        "alpha_deg": alpha_deg,
        "beta_deg": beta_deg,
        **{f"E{name}": float(x) for name, x in zip(("11", "12", "22"), E, strict=True)},
        **{f"S{name}": float(x) for name, x in zip(("11", "12", "22"), S, strict=True)},
        "h": float(double_dot(S, E)),
        "unique": bool(found.unique[0]),
        "extrapolated": extrapolates(file, S),
    }


def support_answer(path: str | Path, S: Array) -> dict[str, Any]:
    """h of the law at the load S (3,); InputError if S is not tensile."""
    file = read_law_file(path)
    size = float(trace(S))
    if not size > 0.0 or float(eigenvalues(S)[0]) < -ROUNDING * size:
        raise InputError(f"--S {S[0]},{S[1]},{S[2]}: not tensile; a principal line load is negative or all are zero")
    return {"h": float(file.law.support(S[None])[0]), "extrapolated": extrapolates(file, S)}


def extrapolates(file: LawFile, S: Array) -> bool:
    """Whether the table behind the law has no loads around S (3,); false for a law without a table."""
    polygon = file.provenance.get("sampled_loads")
    return polygon is not None and not bool(is_sampled(np.array(polygon, float), S[None])[0])
