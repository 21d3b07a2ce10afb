"""The locked state at the end of a motion: what a static run leaves out, put back in.

`sweep` needs no inertia, damping or gyroscopic torques, for nothing moves in the end. Forced on, they carry the rings
from the slack pose into the locked one by the paper's scheme, with the ten rings' constraints eliminated or not, and
Newton's method closes the contacts, which are compliant on the way.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rve.common.types import Array
from rve.equilibrium.interior_point import DirectOptions, Equilibrium, unit_loads
from rve.equilibrium.limits import polish
from rve.equilibrium.system import Equations
from rve.geometry.pose import Pose
from rve.paper import ten_rings
from rve.paper.stewart_trinkle import StewartTrinkleOptions, solve

TERMS = ("damping", "inertia", "gyroscopic", "constraints")
"""In this order each needs those before: without damping nothing comes to rest, without inertia nothing spins on."""
_TOUCHING = 1e-4
"""Gap in r1 below which a contact that presses at the end of the motion is closed."""


def locked_by_motion(
    s: Array, equations: Equations, options: DirectOptions, motion: StewartTrinkleOptions, terms: tuple[str, ...]
) -> Equilibrium:
    """Locked states under the line loads s (n, 3) at the end of motions with these `terms` of TERMS.

    Iterations are time steps; a case that does not come to rest, or whose contacts cannot be closed, has "stalled".
    """
    unit = unit_loads(s)
    how = replace(motion, inertia=terms != ("damping",), gyroscopic="gyroscopic" in terms)
    pose, steps, at_rest = (
        _with_constraints(unit, equations, how) if "constraints" in terms else _free(unit, equations, how)
    )
    pose, lam, contacts, R = polish(pose, equations, unit, options, _TOUCHING)
    good = at_rest & (options.tolerance > R) & (contacts.min_gap > -1e-10) & contacts.links_intact
    status = np.where(good, "converged", "stalled").astype("<U16")
    return Equilibrium(pose, lam, contacts, np.where(good, R, np.nan), steps, status, np.ones(len(s), dtype=int))


def _free(
    s: Array, equations: Equations, how: StewartTrinkleOptions
) -> tuple[Pose, NDArray[np.intp], NDArray[np.bool_]]:
    """Poses, steps, and whether at rest, with the constraints eliminated."""
    rest = solve(s, equations, how)
    return rest.pose, rest.steps, rest.status == "converged"


def _with_constraints(
    s: Array, equations: Equations, how: StewartTrinkleOptions
) -> tuple[Pose, NDArray[np.intp], NDArray[np.bool_]]:
    """The same with all rings and constraints written out, one case after the other."""
    weave = equations.weave
    rest = [ten_rings.settled(load, weave, equations.wire, how) for load in s]
    poses = [ten_rings.pose_of(rings, weave, how) for rings in rest]
    pose = Pose(*(np.concatenate([getattr(one, name) for one in poses]) for name in ("lattice", "centres", "normals")))
    steps = np.array([rings.steps for rings in rest])
    return pose, steps, np.array([how.tolerance > rings.R for rings in rest])
