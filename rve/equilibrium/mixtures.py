"""Mixtures of two or three locked states that do the same work under the load of their mixed strain."""

from itertools import combinations

import numpy as np

from rve.common import Array
from rve.common.tensor import WEIGHT
from rve.equilibrium.dead_load import LoadedCell
from rve.equilibrium.largest_work import GAIN

MOVED = 1e-6
"""Strain by which states must differ to be two."""
SHARE_STEPS = 30
"""Steps of Newton's method for the shares of given strains."""
PART = 1e-7
"""Change of shares by which their derivatives are taken as differences."""


def best_mixture(s: Array, E: Array, mesh: LoadedCell, detours: int = 0) -> tuple[list[int], Array]:
    """Up to three of the strains E (m, 3), the largest share first, whose mixture of equal works under its S is nearest
    to the answer of the Cauchy load s (3,), and S (3,): where no other does more work under S, it is the answer among
    mixtures.

    Descent: the state of most work under S joins the mixture, or replaces some of it, as long as that lowers its gain,
    and so many times in a row where it does not.
    """
    chosen, answer, visited, waited = list[int](), (list[int](), s), set[frozenset[int]](), 0
    least, rival = np.inf, int(np.argmax((s * WEIGHT) @ E.T))
    while True:
        best = np.inf if detours else least - GAIN
        for some in [kept for size in range(3) for kept in combinations(chosen, size)]:
            members = [rival, *some]
            w = None if frozenset(members) in visited else equal_shares(s, E[members], mesh)
            if w is None:
                continue
            S = mesh.conjugate((w @ E[members])[None], s[None])[0]
            works = E @ (S * WEIGHT)
            gain = float(works.max() - w @ works[members])
            if gain < best:
                best, mixture, ahead, load = gain, [members[k] for k in np.argsort(-w)], int(works.argmax()), S
        is_lower = best < least - GAIN
        waited = 0 if is_lower else waited + 1
        if waited > detours or not np.isfinite(best):
            return answer
        visited.add(frozenset(mixture))
        if is_lower:
            least, answer = best, (mixture, load)
        chosen, rival = mixture, ahead


def equal_shares(s: Array, E: Array, mesh: LoadedCell) -> Array | None:
    """Positive shares (k,) of the strains E (k, 3) that all do the same work under the S of their mixture and the
    Cauchy load s (3,), by Newton's method; None where there are none, and for strains that are the same."""
    k = len(E)
    w, loads = np.full(k, 1.0 / k), np.tile(s, (k, 1))
    if k == 1 or any(np.abs(a - b).max() < MOVED for a, b in combinations(E, 2)):
        return w if k == 1 else None
    for _ in range(SHARE_STEPS):
        near = w + PART * np.column_stack([-np.sign(np.arange(k)), np.eye(k)[:, 1:]])
        short = (mesh.conjugate(near @ E, loads) * WEIGHT) @ (E[1:] - E[0]).T
        step = np.linalg.lstsq((short[1:] - short[0]).T / PART, -short[0], rcond=None)[0]
        step = np.append(-step.sum(), step)
        if np.abs(step).max() < 1e-12:
            return w
        w = w + min(1.0, 0.9 / max((-step / w).max(), 1e-300)) * step
        if w.min() < 1e-6:
            break
    return None
