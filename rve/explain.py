"""What a run of rings used and left out, and why: one short table made from what the solver met."""

from typing import Any

from rve.equilibrium.interior_point import LockedStates
from rve.equilibrium.symmetry import is_symmetric, symmetry_of
from rve.geometry.cell import Cell
from rve.geometry.contacts import pairs_in_reach, unlisted_gap

SYMMETRIC = 1e-7
"""Lengths in r1 and tilts by which a symmetric locked state may miss its symmetry."""


def solver_work(states: LockedStates, cell: Cell) -> dict[str, Any]:
    """Counts of the direct solver for the locked states of a cell.

    cases; symmetric ones; retried: those that took more than one attempt in all coordinates; limits: those replaced by
    the limit from inside the tensile cone; listed: pairs of rings in the equations, of which least_near to most_near
    are near enough to touch; unlisted_gap: least gap of other pairs in r1; widened: whether such pairs overlapped.
    """
    weave, pose, good = cell.weave, states.pose, states.found.status == "converged"
    symmetry, near = symmetry_of(weave), pairs_in_reach(pose, weave, cell.wire, states.reach)
    listed = len(states.cell.weave.pairs)
    return {
        "cases": len(good),
        "symmetric": 0 if symmetry is None else int((good & is_symmetric(pose, symmetry.middle, SYMMETRIC)).sum()),
        "retried": int((states.found.attempts > 2).sum()),  # the first is in symmetric coordinates
        "limits": int((good & ~states.unique).sum()),
        "listed": listed,
        "least_near": int(near.min()),
        "most_near": int(near.max()),
        "unlisted_gap": float(unlisted_gap(pose, weave, cell.wire).min()),
        "widened": listed > len(weave.pairs),
    }


def features(provenance: dict[str, Any]) -> list[dict[str, Any]]:
    """What the run behind a table used and left out, from the table's provenance: rows of feature, used and why."""
    work = provenance["work"]
    cases, symmetric, retried, limits = (work[name] for name in ("cases", "symmetric", "retried", "limits"))
    near = f"{work['least_near']} to {work['most_near']} of {work['listed']} pairs of rings are near enough to touch"
    apart = f"{near}, others stay {work['unlisted_gap']:.2g} r1 apart"
    overlap = "rings that the weave does not list as neighbours would overlap"
    rows = [
        ("motion", False, "static load: the equations of the locked state hold no velocities"),
        ("asymmetry", symmetric < cases, f"{symmetric} of {cases} locked states are symmetric"),
        ("unlisted-pairs", work["widened"], overlap if work["widened"] else apart),
        ("attempts", retried > 0, f"{retried} of {cases} cases took more than one attempt"),
        ("limits", limits > 0, f"{limits} of {cases} cases are limits from inside the tensile cone"),
    ]
    return [dict(zip(("feature", "used", "why"), row, strict=True)) for row in rows]
