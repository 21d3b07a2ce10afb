"""Elastic locked states under a load of stated size: equilibrium in the displaced place, not to first order in it.

Unknown are the pose q of the rings and the contact forces lam. With the flexibility C(q) between the contacts at the
pose q, and a dead second Piola-Kirchhoff load of `size` in E r1,

    f(q) + G(q)^T lam = 0,    0 <= lam  _|_  gap(q) + size C(q) lam >= 0.

Negative gaps are how far rings that keep their shape would overlap; elastic rings give way by as much. Newton's method
on a ladder of loads; each step is a linear complementarity problem, solved by changes of the set of working contacts.

Left out: a ring's flexibility is that of the round, unloaded ring, and gaps and normals are those of round rings at the
pose. Both are of the order of the overlap over r1, which is therefore limited (`LARGEST_OVERLAP`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rve.common.records import Flags, Rows
from rve.common.types import Array
from rve.equilibrium.dead_load import DeadLoad
from rve.equilibrium.elastic_rings import RingStates
from rve.equilibrium.interior_point import Equilibrium, carry_forces
from rve.equilibrium.ring_contacts import contact_ends, contact_flexibility, local_flexibility
from rve.equilibrium.system import Equations
from rve.geometry.pose import moved, strain_of
from rve.ring.section import Ring

LARGEST_OVERLAP = 0.1
"""Overlap of round rings in r1 above which their own change of shape, which is left out, matters by some 10 %."""
_STAGES = (0.125, 0.25, 0.5, 1.0)
_NEAR = 0.05
"""Gap in r1 below which contacts are in the equations."""
_STEP, _DONE, _STEPS, _CHANGES = 0.05, 1e-9, 60, 60


@dataclass(frozen=True)
class LoadedStates(Rows):
    """Elastic locked states of n cases: strain E (n, 3); overlap (n,), the largest in r1; status (n,): "converged",
    "large" where the overlap is more than LARGEST_OVERLAP, "stalled", whose E is nan; overlaps of 1.5 r2 stall."""

    E: Array
    overlap: Array
    status: NDArray[np.str_]


def loaded_states(
    equations: Equations,
    found: Equilibrium,
    rings: RingStates,
    S: Array,
    reference: tuple[float, float],
    ring: Ring,
    size: Array,
    *,
    hertz: bool = False,
) -> LoadedStates:
    """The states of converged locked states `found` under dead loads S (n, 3) in s, of `size` (n,) in E r1 per s.

    rings: their states to first order, with the joints that they are for; hertz: crossing wires give as well.
    reference: sides of the reference cell in r1.
    """
    dead = replace(equations, load=DeadLoad(reference))
    state = replace(found, lam=rings.lam)
    good, overlap = np.ones(len(S), dtype=bool), np.zeros(len(S))
    for share in _STAGES:
        go = np.flatnonzero(good)
        good[go] = False
        for _ in range(_STEPS):
            if not len(go):
                break
            part, change = _stepped(dead, state.take(go), S[go], share * size[go], (ring, rings.angle_deg[go], hertz))
            deep = -part.contacts.min_gap
            sound = np.isfinite(change) & part.contacts.links_intact & (deep > -_NEAR) & (deep < 1.5 * ring.r2)
            state = state.put(go[sound], part.take(sound))
            overlap[go[sound]] = np.maximum(deep[sound], 0.0)
            done = sound & (change < _DONE)
            good[go[done]] = True
            go = go[sound & ~done]
    E = np.where(good[:, None], strain_of(state.pose, reference), np.nan)
    status = np.where(good, np.where(overlap > LARGEST_OVERLAP, "large", "converged"), "stalled")
    return LoadedStates(E, np.where(good, overlap, np.nan), status.astype("<U16"))


def _stepped(
    dead: Equations, state: Equilibrium, S: Array, size: Array, kind: tuple[Ring, Array, bool]
) -> tuple[Equilibrium, Array]:
    """The states after one step of Newton's method, and how far each would move (n,), inf where there is no step."""
    ring, angle_deg, hertz = kind
    n = len(S)
    ends = contact_ends(dead, state, _NEAR)
    welded = np.isnan(angle_deg).all()
    joint = None if welded else ends.grain + np.radians(angle_deg)[:, None] * ends.sense
    system = dead.assemble(state.pose, state.contacts, state.lam, S)
    lam = np.where(ends.present, np.take_along_axis(state.lam.reshape(n, -1), ends.slot, axis=1), 0.0)
    gap = np.where(ends.present, np.take_along_axis(state.contacts.gap.reshape(n, -1), ends.slot, axis=1), np.inf)
    C = contact_flexibility(ends, ring, joint)
    if hertz:
        C = C + local_flexibility(ends, ring, lam, size)[:, :, None] * np.eye(C.shape[1])
    G = np.take_along_axis(system.G, ends.slot[..., None], axis=1)
    dq, forces = np.zeros(system.f.shape), np.zeros(lam.shape)
    for i in range(n):
        dq[i], forces[i] = complementary(-system.J[i], system.f[i], G[i], gap[i], size[i] * C[i], lam[i] > 0.0)
    lost = ~np.isfinite(dq).all(axis=1)
    dq[lost], forces[lost] = 0.0, 0.0
    change = np.where(lost, np.inf, np.abs(dq).max(axis=1))
    pose = moved(state.pose, np.minimum(1.0, _STEP / np.maximum(change, 1e-300))[:, None] * dq)
    spread = np.zeros((n, state.lam[0].size))
    np.put_along_axis(spread, ends.slot, forces, axis=1)
    contacts = dead.contacts(pose, 2.0 * _NEAR)
    carried = carry_forces(state.contacts, spread.reshape(state.lam.shape), contacts, np.zeros(n))
    return replace(state, pose=pose, contacts=contacts, lam=np.where(carried > 1e-15, carried, 0.0)), change


def complementary(H: Array, f: Array, G: Array, gap: Array, C: Array, working: Flags) -> tuple[Array, Array]:
    """dq (m,) and lam (c,) with H dq = f + G^T lam and 0 <= lam _|_ gap + G dq + C lam >= 0, from a guess of lam > 0.

    One contact at a time leaves or joins the working ones; nan if that does not end. Contacts with an infinite gap stay
    idle.

    >>> one = np.eye(1)
    >>> complementary(one, np.array([-2.0]), one, np.zeros(1), one, np.array([True]))
    (array([-1.]), array([1.]))
    """
    m, working = len(f), working.copy()
    for _ in range(_CHANGES):
        rows = np.flatnonzero(working)
        K = np.block([[H, -G[rows].T], [G[rows], C[np.ix_(rows, rows)]]])
        try:
            x = np.linalg.solve(K, np.concatenate([f, -gap[rows]]))
        except np.linalg.LinAlgError:
            break
        lam = np.zeros(len(gap))
        lam[rows] = x[m:]
        free = np.where(working, np.inf, gap + G @ x[:m] + C @ lam)
        if len(rows) and x[m:].min() < -1e-12 * np.abs(x[m:]).max():
            working[rows[x[m:].argmin()]] = False
        elif free.min(initial=np.inf) < -1e-12:
            working[free.argmin()] = True
        else:
            return x[:m], np.maximum(lam, 0.0)
    return np.full(m, np.nan), np.full(len(gap), np.nan)
