"""Two symmetries of the locked states of a weave: fewer coordinates, and contact forces that have the symmetry.

Point inversion in the centre of a ring maps each class of rings on itself, the reflection z -> -z one class on the
other. A cell with both has its second ring at c = (i a1 + j a2)/2 and mirrored normals: 5 of the 9 coordinates and half
of the pairs are left. A state that is found so must satisfy all equations and be stable against asymmetric motions.

Symmetric forces balance every ring across the plane as well, which no equation of a planar cell asks: with all
coordinates, gaps rounded to 1e-16 leave the shares of two contacts of one pair open by up to 7e-4.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rve.common import Array, Flags, Index
from rve.equilibrium.interior_point import DirectOptions, Equilibrium, solve_equilibrium, unit_loads
from rve.equilibrium.limits import SOFT, loose_motions, strain_is_unique
from rve.equilibrium.steps import carry_forces
from rve.equilibrium.system import Equations
from rve.geometry.contacts import CellContacts
from rve.geometry.pose import Pose, start_pose
from rve.geometry.weave import Weave

_INVERTED = np.array([-1.0, -1.0, -1.0])
_REFLECTED = np.array([1.0, 1.0, -1.0])
_TURNED = np.array([-1.0, -1.0, 1.0])
_ROUNDING = 1e-12
MOST_ITERATIONS = 60
"""In symmetric coordinates; 40 do for all but a few cases, which are better off with all coordinates then."""


@dataclass(frozen=True)
class Symmetry:
    """middle (i, j): the second ring is at (i a1 + j a2)/2. kept (q,): pairs to look at; source (p,): the kept pair, as
    a row of `kept`, whose image each pair is; signs (p, 3): what turns its points on ring a into those of the image;
    itself (q, 3): what turns the points on ring b of a kept pair into points on its ring a.
    """

    middle: tuple[int, int]
    kept: Index
    source: Index
    signs: Array
    itself: Array


def symmetry_of(weave: Weave) -> Symmetry | None:
    """The symmetry of a weave of two classes, None if it has none or its start pose is not symmetric."""
    if weave.classes != 2 or weave.centres == "space":
        return None
    pose = start_pose(weave, 1)
    steps = np.linalg.solve(np.stack([pose.a1[0], pose.a2[0]], axis=1), 2.0 * pose.centres[0, 1])
    middle = (round(steps[0]), round(steps[1]))
    if np.abs(steps - middle).max() > _ROUNDING or not is_symmetric(pose, middle, _ROUNDING)[0]:
        return None
    row = {tuple(pair): p for p, pair in enumerate(weave.pairs.tolist())}
    source, signs = np.arange(len(row)), np.ones((len(row), 3))
    for p, (a, b, i, j) in enumerate(weave.pairs.tolist()):
        image, sign = ((0, 1, -i - middle[0], -j - middle[1]), _INVERTED) if a != b else ((0, 0, i, j), _REFLECTED)
        first = row.get(image, p)
        if first < p:
            source[p], signs[p] = first, sign
    kept, place = np.unique(source, return_inverse=True)
    one_class = weave.pairs[kept, 0] == weave.pairs[kept, 1]
    return Symmetry(middle, kept, place, signs, np.where(one_class[:, None], _INVERTED, _TURNED))


def is_symmetric(pose: Pose, middle: tuple[int, int], tolerance: float) -> NDArray[np.bool_]:
    """Which poses have the symmetry, (n,)."""
    off = pose.centres[:, 1] - 0.5 * (middle[0] * pose.a1 + middle[1] * pose.a2)
    turn = pose.normals[:, 1] - pose.normals[:, 0] * _TURNED
    return np.asarray(np.maximum(np.abs(off).max(axis=1), np.abs(turn).max(axis=1)) <= tolerance)


def symmetric_equations(equations: Equations, symmetry: Symmetry) -> Equations:
    """The equations in the 5 symmetric coordinates, with the kept pairs only."""
    weave, kept = equations.weave, symmetry.kept
    weave = replace(weave, pairs=weave.pairs[kept], linked=weave.linked[kept])
    modes = np.zeros((9, 5))
    modes[:3, :3] = np.eye(3)
    # Turning about z by half a turn, as good as the reflection for a torus, reverses both vectors of the tangent frame.
    modes[5:7, 3:], modes[7:, 3:] = np.eye(2), -np.eye(2)
    return replace(equations, weave=weave, maps=equations.maps[kept], modes=modes, middle=symmetry.middle)


def solve_equilibrium_symmetric(s: Array, equations: Equations, options: DirectOptions) -> Equilibrium:
    """What `solve_equilibrium` finds, first tried in the symmetric coordinates of the weave. Cases that do not converge
    there, or are not confirmed, are solved with all coordinates, except loads of rank one that leave the strain free
    (`limits.with_limits`). Iterations count both, and attempts one more.
    """
    symmetry = symmetry_of(equations.weave)
    if symmetry is None:
        return solve_equilibrium(s, equations, options)
    unit = unit_loads(s)
    half = symmetric_equations(equations, symmetry)
    once = replace(options, attempts=1, max_iterations=min(MOST_ITERATIONS, options.max_iterations))
    part = solve_equilibrium(s, half, once)
    found = expand_symmetric(part, symmetry, equations, unit, options.reach)
    is_solved = is_confirmed(found, half, equations, unit, options.tolerance)
    is_slender = np.abs(unit[:, 0] * unit[:, 2] - unit[:, 1] ** 2) < 1e-12  # of rank one
    thin = np.flatnonzero(is_slender & (options.tolerance > found.R))
    is_solved[thin] |= ~strain_is_unique(equations, found.take(thin), unit[thin])
    left = np.flatnonzero(~is_solved)
    if not len(left):
        return found
    again = solve_equilibrium(s[left], equations, options)
    again = replace(again, iterations=again.iterations + found.iterations[left], attempts=again.attempts + 1)
    return found.put(left, again)


def expand_symmetric(
    found: Equilibrium, symmetry: Symmetry, equations: Equations, s: Array, reach: float
) -> Equilibrium:
    """Equilibria of the symmetric equations with the contacts and forces of all pairs, and R of all equations."""
    part = found.contacts
    lam, source = _shared_by_twins(part, found.lam, symmetry), symmetry.source
    rho = part.rho[:, source] * symmetry.signs[:, None]
    images = replace(part, present=part.present[:, source], gap=part.gap[:, source], rho=rho)
    contacts = equations.contacts(found.pose, reach)
    copies = np.bincount(source)[source]
    lam = carry_forces(images, lam[:, source] / copies[:, None], contacts, np.zeros(len(s)))
    R = equations.assemble(found.pose, contacts, lam, s).weighted_residual
    return replace(found, lam=lam, contacts=contacts, R=np.where(np.isnan(found.R), np.nan, R))


def _shared_by_twins(contacts: CellContacts, lam: Array, symmetry: Symmetry) -> Array:
    """Forces (n, q, SLOTS) with equal parts for contacts that are each other's image within one pair of rings:
    symmetric motions see only the sum of the two.
    """
    image = np.where(contacts.present[..., None], contacts.rho_b, np.inf) * symmetry.itself[:, None]
    way = contacts.rho[:, :, None] - image[:, :, :, None]  # case, pair, contact, candidate for its image
    there = contacts.present[:, :, None, :] & contacts.present[..., None]
    distance = np.where(there, np.linalg.norm(np.where(there[..., None], way, 0.0), axis=4), np.inf)
    return 0.5 * (lam + np.take_along_axis(lam, distance.argmin(axis=3), axis=2))


def is_confirmed(found: Equilibrium, symmetric: Equations, equations: Equations, s: Array, tolerance: float) -> Flags:
    """Which equilibria of the symmetric equations obey all others, too, and resist all asymmetric motions, (n,)."""
    good = (found.status == "converged") & found.contacts.links_intact & (found.contacts.min_gap > 0.0)
    good &= np.nan_to_num(found.R, nan=np.inf) < tolerance
    basis = np.linalg.qr(symmetric.motions(found.pose))[0]
    for i, stiffness, motions in loose_motions(equations, found, s):
        asymmetric = motions - basis[i] @ (basis[i].T @ motions)
        good[i] &= not np.any((stiffness < -SOFT) & (np.abs(asymmetric).max(axis=0) > 1e-6))
    return good
