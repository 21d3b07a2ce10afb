"""Implicit steps in time, Euler's and BDF2 with steps of any ratio; the step of a curtain; the energies of any step.

Velocities are differences of positions and accelerations the same differences of velocities. With steps h and before it
h / w,

    beta h v+ = x+ - X,   beta h a+ = v+ - V,   beta = (1 + w) / (1 + 2 w),
    X = beta ((1 + w) x_n - w^2 / (1 + w) x_(n-1)),   V the same of velocities,

and beta = 1, X = x_n, V = v_n for Euler's. The equation of motion M a+ = f makes the step of a curtain the convex
program of the static solver with the mass term added,

    minimise  |x - x_hat|^2_M / (2 (beta h)^2) + damping and drag - f.x + stored energy   over admissible x,

x_hat = X + beta h V. Nodes of bodies with mass follow those of the curtain (`macro_fem.fem.supported`). Round obstacles
and bodies enter by tangent half-spaces, taken where the curtain would go, and found again at the answer until they no
longer turn.

With dx = x+ - x_n and M a+ = f + supports + pushes - B^T (w P+) - damping M v+ times dx,

    kinetic + potential + stored  changes by  work - lost_by_scheme - lost_by_locking - lost_by_damping,

    work     = (live loads + supports).dx + pushes along the moves of obstacles,
    locking  = sum w P+:(F+ - F_n) of the rigid law, >= 0 because F_n is admissible and P+ an outward normal at F+, and
               pushes times the gaps at x_n, >= 0 as well: tautening and touching are plastic impacts,
    damping  = h damping v+.M v+,
    scheme   = dx.M a+ - (v+.M v+ - v_n.M v_n) / 2, which is |v+ - v_n|^2_M / 2 for Euler's; of the damping what is not
               in its own loss; what pushes do because tangents of round bodies turn; and of the elastic law
               sum w P+:(F+ - F_n) - (Psi+ - Psi_n), which is >= 0.

Every term comes from its own formula, so their sum closes only as far as the step was solved.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from homogenize import MembraneLaw
from macro_fem.fem.supported import SupportedFem
from macro_fem.solvers.central_path import solve_path
from macro_fem.solvers.cones import Cones
from macro_fem.solvers.path import Inertia, PathOptions, PathResult, Terms, times
from macro_fem.solvers.walls import Walls
from rve.common import Array


@dataclass(frozen=True, eq=False)
class Moment:
    """Positions x (n, d) in mm and velocities v (n, d) in mm/s at the time t in s."""

    t: float
    x: Array
    v: Array


@dataclass(frozen=True, eq=False)
class Difference:
    """The differences of one step: h and beta h in s, X (n, d) in mm and V (n, d) in mm/s, see above."""

    h: float
    beta_h: float
    X: Array
    V: Array

    @property
    def x_hat(self) -> Array:
        """X + beta h V (n, d): where nodes would go without forces, mm."""
        return self.X + self.beta_h * self.V

    def velocity(self, x: Array) -> Array:
        """v+ (n, d) of positions x (n, d), mm/s."""
        return (x - self.X) / self.beta_h

    def acceleration(self, x: Array) -> Array:
        """a+ (n, d) of positions x (n, d), mm/s2."""
        return (x - self.x_hat) / self.beta_h**2


def difference(now: Moment, before: Moment | None, h: float) -> Difference:
    """The differences of a step h from `now`: Euler's without a moment before, else BDF2's.

    >>> start = Moment(0.0, np.zeros((1, 2)), np.ones((1, 2)))
    >>> difference(start, None, 0.5).x_hat.tolist()
    [[0.5, 0.5]]
    """
    if before is None:
        return Difference(h, h, now.x, now.v)
    w = h / (now.t - before.t)
    beta = (1.0 + w) / (1.0 + 2.0 * w)
    own, old = beta * (1.0 + w), beta * w * w / (1.0 + w)
    return Difference(h, beta * h, own * now.x - old * before.x, own * now.v - old * before.v)


def predicted(now: Moment, before: Moment | None, h: float) -> Array:
    """Positions (n, d) after a step h at the last acceleration, mm: x+ differs from them by a third power of h."""
    a = np.zeros_like(now.v) if before is None else (now.v - before.v) / (now.t - before.t)
    return now.x + h * now.v + 0.5 * h * h * a


@dataclass(frozen=True, eq=False)
class Forces:
    """What acts on the nodes (n, d) at the end of a step, N.

    dead: weight; live: other loads that do not depend on the velocity. drag: symmetric blocks C (n, d, d) in N s/mm of
    forces -C v that belong to `live`; damping (n,) or one for all: 1/s, of forces -damping M v.
    """

    dead: Array
    live: Array
    drag: Array | None = None
    damping: Array | float = 0.0

    def live_at(self, v: Array) -> Array:
        """Forces (n, d) beside the weight and damping at velocities v (n, d), N."""
        return self.live if self.drag is None else self.live - times(self.drag, v)


@dataclass(frozen=True, eq=False)
class Moving:
    """The discrete curtain that moves: masses (n,) in N s2/mm of all nodes, the law, its compliance (3, 3), its size in
    mm."""

    fem: SupportedFem
    law: MembraneLaw
    mass: Array
    compliance: Array
    size: float


Tangents = Callable[[Array], Walls]
"""Half-spaces of obstacles and bodies that touch them where they are closest to nodes at x (n, d)."""
ROUNDS, SETTLED = 8, 1e-4
"""How often tangent half-spaces are found anew at most, and reactions that may still turn, over all forces."""
GAP, FIRST_GAP = 1e-10, 1.0
"""Relative gap that a step is solved to, and that of its first state in energy scales."""


@dataclass(frozen=True, eq=False)
class Stepped:
    """The end of a step: positions x (n, d), the solver's record, its half-spaces."""

    x: Array
    result: PathResult
    walls: Walls

    @property
    def pushes(self) -> Array:
        """Forces of half-spaces on all nodes (n, d), N."""
        return self.walls.nodal(self.result.wall_forces, len(self.x))


def solve_step(
    moving: Moving, change: Difference, forces: Forces, x: Array, cones: Cones | None, tangents: Tangents
) -> Stepped:
    """The end of a step from positions x (n, d), by the half-spaces `cones` of the step before."""
    fem, inertia = moving.fem, inertia_of(moving, change, forces)
    load = fem.gather(forces.dead + forces.live)
    path = PathOptions(gap=GAP, violation=1e-9, cones=cones, drawn=False, first_gap=FIRST_GAP)
    place, walls = x, tangents(x)
    for rounds in range(1, ROUNDS + 1):
        terms = Terms(moving.compliance, walls=walls, inertia=inertia)
        result = solve_path(fem, moving.law, load, fem.unknowns(place), moving.size, path, terms)
        place = fem.positions(result.z)
        if not len(walls) or not result.converged or rounds == ROUNDS:
            break
        anew = tangents(place)
        turned = float(result.wall_forces @ np.linalg.norm(anew.normal - walls.normal, axis=1))
        turned /= float(np.abs(result.wall_forces).sum() + np.abs(load).sum() + inertia.force_scale)
        if turned < SETTLED:
            break
        walls, path = anew, replace(path, cones=result.cones)
    return Stepped(place, result, walls)


def inertia_of(moving: Moving, change: Difference, forces: Forces) -> Inertia:
    """The quadratic term of a step: W x_hat = M (X + beta h V) / (beta h)^2 + (damping M + C) X / (beta h)."""
    d, mass = change.X.shape[1], moving.mass
    m, b = mass / change.beta_h**2, 1.0 / change.beta_h
    resist = (b * forces.damping * mass)[:, None, None] * np.eye(d)
    if forces.drag is not None:
        resist = resist + b * forces.drag
    W = m[:, None, None] * np.eye(d) + resist
    aim = m[:, None] * change.x_hat + times(resist, change.X)
    x_hat: Array = np.linalg.solve(W, aim[:, :, None])[:, :, 0].astype(float)
    momentum = float((mass[:, None] * np.abs(change.V)).sum()) / change.beta_h
    return Inertia(moving.fem, W, x_hat, momentum, kinetic_energy(mass, change.V))


@dataclass(frozen=True)
class Account:
    """Energies at one moment and sums of work and losses since the start, N mm."""

    kinetic: float = 0.0
    potential: float = 0.0
    stored: float = 0.0
    work: float = 0.0
    lost_by_scheme: float = 0.0
    lost_by_locking: float = 0.0
    lost_by_damping: float = 0.0

    @property
    def balance(self) -> float:
        """Energies plus losses minus work: constant as far as the steps are solved, N mm."""
        lost = self.lost_by_scheme + self.lost_by_locking + self.lost_by_damping
        return self.kinetic + self.potential + self.stored + lost - self.work


def kinetic_energy(mass: Array, v: Array) -> float:
    """v.M v / 2 of masses (n,) and velocities (n, d), N mm."""
    return 0.5 * float((mass[:, None] * v * v).sum())


def support_forces(moving: Moving, change: Difference, forces: Forces, end: Stepped, inner: Array) -> Array:
    """Forces (n, d) of the supports on the curtain, N: what else M a+ takes, at components that no unknown moves.

    inner (n, d): B^T (w P+).
    """
    v = change.velocity(end.x)
    rest = moving.mass[:, None] * change.acceleration(end.x) + (forces.damping * moving.mass)[:, None] * v + inner
    return np.where(moving.fem.held, rest - forces.dead - forces.live_at(v) - end.pushes, 0.0)


@dataclass(frozen=True, eq=False)
class Worked:
    """Forces of supports and of contacts, `pushes` (n, d), in N, and what they and the law have done in a step, N mm.

    inner: sum of w P+:(F+ - F_n); stored: the change of Psi of an elastic law, None of a rigid one; moved: pushes times
    the moves of obstacles along them; touched: pushes times the gaps at x_n.
    """

    supports: Array
    pushes: Array
    inner: float = 0.0
    stored: float | None = None
    moved: float = 0.0
    touched: float = 0.0


def rebound(mass: Array, change: Difference, forces: Forces, x: Array, worked: Worked) -> float:
    """What contacts and a rigid law would do in one more such step at the last velocities, N mm: about 0 where what
    touches or is taut stays so, positive where it leaves while it is still pushed."""
    v = change.velocity(x)
    push = worked.pushes
    if worked.stored is None:
        push = mass[:, None] * (change.acceleration(x) + np.reshape(forces.damping, (-1, 1)) * v) - worked.supports
        push = push - forces.dead - forces.live_at(v)
    return change.h * float((push * v).sum()) - worked.moved


def next_account(
    last: Account, mass: Array, change: Difference, now: Moment, forces: Forces, x: Array, worked: Worked
) -> Account:
    """The account after a step of masses (n,) from `now` to positions x (n, d)."""
    dx, v, a = x - now.x, change.velocity(x), change.acceleration(x)
    kinetic, resist = kinetic_energy(mass, v), forces.damping * mass
    damped = 2.0 * change.h * kinetic_energy(resist, v)
    dashpot = float((resist[:, None] * v * dx).sum())
    contact = worked.moved - float((worked.pushes * dx).sum())
    return Account(
        kinetic=kinetic,
        potential=last.potential - float((forces.dead * dx).sum()),
        stored=last.stored + (worked.stored or 0.0),
        work=last.work + float(((forces.live_at(v) + worked.supports) * dx).sum()) + worked.moved,
        lost_by_scheme=last.lost_by_scheme
        + float((mass[:, None] * a * dx).sum())
        - (kinetic - kinetic_energy(mass, now.v))
        + (dashpot - damped)
        + (contact - worked.touched)
        + (0.0 if worked.stored is None else worked.inner - worked.stored),
        lost_by_locking=last.lost_by_locking + worked.touched + (worked.inner if worked.stored is None else 0.0),
        lost_by_damping=last.lost_by_damping + damped,
    )
