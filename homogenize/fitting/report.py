"""How wrong a law can be: bounds without any reference, rows left out, the worst direction by name."""

import time
from collections.abc import Callable

import numpy as np

from homogenize.directions import folds_of
from homogenize.fitting.bounds import bounds_of
from homogenize.fitting.row_tests import Normality
from homogenize.laws.protocol import MembraneLaw
from homogenize.laws.report import ErrorReport, Misfit
from homogenize.laws.rows import LockedRows
from rve.common import Array, InputError, tell
from rve.common.tensor import from_disc


def misfit_of(S: Array, error: Array) -> Misfit:
    """Summary of errors (n,) at loads S (n, 3)."""
    size = np.abs(error)
    worst = int(np.argmax(size))
    s11, s12, s22 = (float(x) for x in S[worst])
    return Misfit(len(S), float(size[worst]), float(size.mean()), (s11, s12, s22))


def random_loads(count: int = 1000, seed: int = 2026) -> Array:
    """Tensile loads of unit trace, uniform over the disc of (S11 - S22, 2 S12), every tenth of rank one, (count, 3)."""
    rng = np.random.default_rng(seed)
    radius = np.sqrt(rng.uniform(size=count))
    radius[::10] = 1.0
    angle = rng.uniform(0.0, 2.0 * np.pi, size=count)
    return from_disc(radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def error_report(
    law: MembraneLaw, rows: LockedRows, found: Normality, refit: Callable[[LockedRows], MembraneLaw] | None
) -> ErrorReport:
    """The report of a law fitted to `rows`; `refit` fits the same kind to fewer rows, None skips that part."""
    bounds = bounds_of(rows)
    S = random_loads()
    lower, upper, h = bounds.lower(S), bounds.upper(S), law.support(S)
    return ErrorReport(
        law.name,
        found.sentence(),
        misfit_of(rows.S, law.support(rows.S) - rows.h),
        None if refit is None else held_out_misfit(rows, refit),
        misfit_of(S, upper - lower),
        float(np.maximum(lower - h, 0.0).max()),
        float(np.maximum(h - upper, 0.0).max()),
        int((~rows.unique).sum()),
        rows.dropped,
    )


def held_out_misfit(rows: LockedRows, refit: Callable[[LockedRows], MembraneLaw]) -> Misfit | None:
    """The error at every row inside the hull, left out once, with its neighbours kept; None with too few rows."""
    S, error = [], []
    begun = time.monotonic()
    folds = folds_of(rows.S, rows.is_mirrored)
    for number, (out, keep) in enumerate(folds):
        tell(f"error of the law at rows left out, {number + 1} of {len(folds)}", number, len(folds), begun)
        try:
            law = refit(rows.take(keep))
        except InputError:
            return None
        S.append(rows.S[out])
        error.append(law.support(rows.S[out]) - rows.h[out])
    return misfit_of(np.concatenate(S), np.concatenate(error)) if folds else None
