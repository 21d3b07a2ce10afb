"""What a membrane law is: the records it answers with and the protocol it follows.

Symmetric 2 x 2 tensors are triples (11, 12, 22) of tensor components on the last axis, the leading axis is the point:
S:E = S11 E11 + 2 S12 E12 + S22 E22. Line loads and stiffnesses are in N/mm, strains have no unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rve.common import Array, ByValue, InputError, Rows, checked, shown
from rve.common.records import floats
from rve.common.tensor import WEIGHT, eigenvalues, trace
from rve.geometry import CellInfo

ROUNDING = 1e-12
"""A trace that differs from 1 by less is left as it is, so that half-spaces which are made again are the same."""


def check_finite(values: Array, what: str = "strains") -> None:
    """InputError for `values` that are no rows, and one that names the first row that is not finite."""
    if np.ndim(values) != 2:
        raise InputError(f"{what} are of the shape {np.shape(values)}, not (n, 3): one row of 11, 12, 22 for each")
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        raise InputError(f"{what} are finite numbers, row {bad[0]} of {len(values)} is {values[bad[0]].tolist()}")


@dataclass(frozen=True, eq=False)
class HalfSpaces(ByValue):
    """Half-spaces S_i:E <= h_i with S_i positive semidefinite; S_i of another trace than 1 and h_i are divided by it.

    S (m, 3) in the order 11, 12, 22; h (m,); extra (m,) or (m, k): by how much each is widened per unit of tau
    (`homogenize.laws.giving`, `homogenize.laws.plastic`), or None. InputError for other shapes, numbers that are not
    finite, and what pushes.

    >>> HalfSpaces(np.array([[2.0, 0.0, 2.0]]), np.array([0.4])).h
    array([0.1])
    """

    S: Array
    h: Array
    extra: Array | None = None

    def __post_init__(self) -> None:
        """Check, and divide by the trace."""
        S, h = floats(self.S, "S"), floats(self.h, "h")
        of_any = S.ndim == 2 and S.shape[1] == 3 and len(S) > 0 and h.shape == (len(S),)
        if not of_any or not np.isfinite(S).all() or not np.isfinite(h).all():
            what = "half-spaces are finite triples S with one finite h each"
            raise InputError(f"{what}, S (m, 3) and h (m,), got S {S.shape} and h {h.shape}")
        size = trace(S)
        bad = np.flatnonzero(~(size > 1e-6) | (eigenvalues(S)[0] < -1e-9 * size))
        if len(bad):
            raise InputError(f"half-space {bad[0]}, S = {S[bad[0]].tolist()}, is not tensile")
        size = np.where(np.abs(size - 1.0) < ROUNDING, 1.0, size)
        object.__setattr__(self, "S", S / size[:, None])
        object.__setattr__(self, "h", h / size)
        object.__setattr__(self, "extra", None if self.extra is None else (self.extra.T / size).T)


@dataclass(frozen=True, eq=False)
class Cut(Rows):
    """For each strain the half-space that it violates most: S (n, 3) of unit trace, h (n,), violation S:E - h (n,).

    extra (n,) or (n, k): see `HalfSpaces`.
    """

    S: Array
    h: Array
    violation: Array
    extra: Array | None = None


@dataclass(frozen=True, eq=False)
class Response(ByValue):
    """Elastic answer beyond locking: energy (n,), S = dPsi/dE (n, 3), C (n, 3, 3), closest locked strain E_star (n, 3).

    The tangent maps tensor components to tensor components, S = C dE with dE the triple (dE11, dE12, dE22); the factor
    2 of the shear product is inside C.
    """

    energy: Array
    S: Array
    C: Array
    E_star: Array


class MembraneLaw(Protocol):
    """A tensile, convex membrane law: the set K+ of admissible strains and the elasticity beyond it."""

    @property
    def name(self) -> str: ...

    @property
    def cell(self) -> CellInfo | None: ...

    @property
    def compliance(self) -> Array:
        """The metric of the response, E - E_star = compliance S: (3, 3) in tensor components, mm/N; 0: none."""

    def support(self, S: Array) -> Array:
        """h(S) = max S:E over K+ for S (n, 3) positive semidefinite, (n,)."""

    def half_spaces(self) -> HalfSpaces:
        """A few half-spaces that contain K+ and bound it under tension: where a cutting-plane method starts."""

    def cut(self, E: Array) -> Cut:
        """The half-space each E (n, 3) violates most; violation <= 0 means that E is admissible."""

    def response(self, E: Array) -> Response:
        """Energy, stress and tangent of the elastic law at E (n, 3)."""

    def elastic(self) -> MembraneLaw:
        """The law of elastic curtains: K+ with a compliance behind it, by direction where the law knows it."""


def check_law(law: MembraneLaw) -> None:
    """InputError, which names the law, for half-spaces that are none or leave strains open, and for a compliance that
    is none: an own law is tested where it is taken.

    With I + 2E positive semidefinite, half-spaces of unit trace leave some strain if each h is above that of E = -I/2,
    and a bounded set of them if the sum of S is positive definite.
    """
    where = f"law {law.name!r}: half_spaces:"
    try:
        start = law.half_spaces()
    except InputError as error:
        raise InputError(f"{where} {error}") from error
    if not isinstance(start, HalfSpaces):
        raise InputError(f"{where} returns {shown(start)}, not homogenize.laws.HalfSpaces(S, h)")
    if start.h.min() <= -0.5:
        raise InputError(f"{where} h = {start.h.min():g}: leaves no strain, it must be above -0.5 for S of unit trace")
    if eigenvalues(start.S.mean(axis=0))[0] <= 1e-14:
        raise InputError(f"{where} leave the strain open in one direction: give one that is tensile in it too")
    C = floats(law.compliance, f"law {law.name!r}: compliance")
    P, most = C / WEIGHT if C.shape == (3, 3) else np.full((3, 3), np.nan), 1e-6 * np.abs(C).max(initial=0.0)
    if not np.isfinite(P).all() or np.abs(P - P.T).max() > most or np.linalg.eigvalsh(P + P.T)[0] < -most:
        what = "is no (3, 3) whose column of 12, halved, leaves it symmetric and without negative eigenvalues"
        raise InputError(f"law {law.name!r}: compliance = {shown(C.tolist())}: {what}")


@checked
def elastic_law(law: MembraneLaw) -> MembraneLaw:
    """The law of an elastic curtain: with the compliance of its rings by direction if it has their strength, else with
    a constant one."""
    return law.elastic()
