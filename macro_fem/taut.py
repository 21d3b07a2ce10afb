"""Curtains whose supports are as far apart as the mesh can stretch: no state has room, the pull has no upper limit.

There the dual problem has no solution: ever larger multipliers come ever closer, and an interior point that must keep
away from the law's boundary has no place to be. So the rings are let give a little: the law is met by F / (1 + g), that
is, the curtain x / (1 + g) hangs from supports which are drawn together by as much. Its answer times 1 + g meets the
supports and leaves the law by g; its dual vectors, with the supports where they are, still bound the potential of the
curtain that gives nothing: -sum w c |y1| + sum w P:F_0 holds for any of them.
"""

from __future__ import annotations

from dataclasses import replace

from homogenize.law import Array, MembraneLaw
from macro_fem.fem import SupportedFem
from macro_fem.rigid import RigidOptions, RigidResult, solve_rigid

ROOM = 1e-4
"""Below this relative slack of the roomiest state that a solver met, failing to converge is taken for tautness."""
GIVES = (1e-5, 1e-4)
"""By how much rings may give, tried in turn: the answer is off by its square root, multipliers are its inverse."""
GAP = 1e-5
"""What double precision leaves of the gap beside multipliers that are so large."""
MESSAGE = (
    "the supports are as far apart as the mesh can stretch, within {percent:g} %: no state has room to spare and the "
    "pull at the supports no upper limit. This answer lets the rings give {percent:g} % beyond locking; move the "
    "supports together for one that does not"
)


def is_taut(result: RigidResult) -> bool:
    """Whether a solver ended without an answer, and without a certificate that there is none, for lack of room."""
    return result.status in ("stalled", "iterations") and result.room < ROOM


def solve_taut(
    fem: SupportedFem, law: MembraneLaw, load: Array, start: Array, size: float, options: RigidOptions
) -> RigidResult | None:
    """The answer with rings that give, its status "taut", and a bound for rings that do not; None if that fails too."""
    for give in GIVES:
        nearer = replace(fem, x_held=fem.x_held / (1.0 + give))
        loose = replace(options, gap=max(GAP, options.gap))
        result = solve_rigid(nearer, law, load, start / (1.0 + give), size, loose)
        if result.converged:
            held = nearer.gradient(0.0 * result.z)
            pull = float((fem.weight * (result.P * held).sum(axis=(1, 2))).sum())
            return replace(
                result,
                status="taut",
                message=MESSAGE.format(percent=100.0 * give),
                z=(1.0 + give) * result.z,
                primal=(1.0 + give) * result.primal,
                dual=result.dual + give * pull,
            )
    return None
