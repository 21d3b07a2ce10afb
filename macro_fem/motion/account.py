"""The energy account of a step, from M a+ = f + supports + pushes - B^T (w P+) - damping M v+ times dx = x+ - x_n.

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

from dataclasses import dataclass

import numpy as np

from macro_fem.motion.scheme import Difference, Moment
from macro_fem.motion.step import Forces, Moving, Stepped
from rve.common import Array


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
    rest = rest - forces.dead - forces.live - end.pushes
    if forces.drag is not None:
        rest = rest + (forces.drag @ v[:, :, None])[:, :, 0]
    return np.where(moving.fem.held, rest, 0.0)


def next_account(
    last: Account,
    mass: Array,
    change: Difference,
    now: Moment,
    forces: Forces,
    x: Array,
    supports: Array,
    pushes: Array,
    *,
    inner: float = 0.0,
    stored: float | None = None,
    moved: float = 0.0,
    touched: float = 0.0,
) -> Account:
    """The account after a step of masses (n,) from `now` to positions x (n, d) under forces of supports and of
    contacts, `pushes` (n, d), in N.

    In N mm: inner, sum of w P+:(F+ - F_n); stored, the change of Psi of an elastic law, None of a rigid one; moved,
    pushes times the moves of obstacles along them; touched, pushes times the gaps at x_n.
    """
    dx, v, a = x - now.x, change.velocity(x), change.acceleration(x)
    live = forces.live if forces.drag is None else forces.live - (forces.drag @ v[:, :, None])[:, :, 0]
    kinetic, resist = kinetic_energy(mass, v), forces.damping * mass
    damped = 2.0 * change.h * kinetic_energy(resist, v)
    dashpot = float((resist[:, None] * v * dx).sum())
    contact = moved - float((pushes * dx).sum())
    return Account(
        kinetic=kinetic,
        potential=last.potential - float((forces.dead * dx).sum()),
        stored=last.stored + (stored or 0.0),
        work=last.work + float(((live + supports) * dx).sum()) + moved,
        lost_by_scheme=last.lost_by_scheme
        + float((mass[:, None] * a * dx).sum())
        - (kinetic - kinetic_energy(mass, now.v))
        + (dashpot - damped)
        + (contact - touched)
        + (0.0 if stored is None else inner - stored),
        lost_by_locking=last.lost_by_locking + touched + (inner if stored is None else 0.0),
        lost_by_damping=last.lost_by_damping + damped,
    )
