"""Steps of the interior-point method: Newton direction, feasible step length, forces at the new contacts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rve.common import Array, Flags, Index
from rve.geometry.contacts import CellContacts, parallel_clearance
from rve.geometry.pose import Pose
from rve.locking.system import Equations, System

LARGEST_CORRECTION = 0.1
"""Of a coordinate, in r1 or radians."""
TRIES = 16
"""Steps tried at once by cases whose first step is too long."""


def carry_forces(old: CellContacts, lam: Array, new: CellContacts, mu: Array) -> Array:
    """Forces of new contacts. Contacts that have one nearest successor each keep theirs; where minima merge, split,
    appear or vanish, the force of the pair is shared out in proportion to 1/gap. New pairs start at mu/gap.
    """
    share = np.where(new.present, 1.0 / np.maximum(new.gap, 1e-14), 0.0)
    distance = _distances(old, new)
    heir = distance.argmin(axis=2)
    slots = np.arange(distance.shape[2])[:, None]
    gives = (slots == heir[:, :, None, :]) & old.present[:, :, None, :]
    one_to_one = (gives.sum(axis=3) == new.present).all(axis=2)[..., None]
    total = lam.sum(axis=2, keepdims=True)
    shared = total * share / np.maximum(share.sum(axis=2, keepdims=True), 1e-300)
    kept = (gives * lam[:, :, None, :]).sum(axis=3)
    out = np.where(one_to_one, kept, np.where(total > 0.0, shared, mu[:, None, None] * share))
    return np.where(new.present, np.maximum(out, 1e-16), 0.0)


@np.errstate(divide="ignore", invalid="ignore", over="ignore")  # a gap may round to zero: that case takes no step
def newton_direction(
    system: System, gap: Array, lam: Array, mu: Array, present: Flags, step: Array
) -> tuple[Array, Array]:
    """Primal-dual Newton step (dq (n, m), dlam (n, c)) for r = 0, lam gap = mu, no longer than `step`.

    K dq = r + G^T (mu - lam gap)/gap with K by `_barrier_stiffness`. Where the symmetric part of K is indefinite, or
    the step too long, a multiple of the identity is added.
    """
    n, m = system.r.shape
    target = np.where(present, (mu[:, None] - lam * gap) / gap, 0.0)
    K, ratio = _barrier_stiffness(system, gap, lam, present)
    rhs = system.r + np.matmul(system.G.transpose(0, 2, 1), target[..., None])[..., 0]
    broken = ~(np.isfinite(K).all(axis=(1, 2)) & np.isfinite(rhs).all(axis=1))
    K[broken], rhs[broken] = np.eye(m), 0.0  # no step: the case stalls and is tried again from another start
    lowest = np.linalg.eigvalsh(0.5 * (K + K.transpose(0, 2, 1)))[:, 0]
    noise = 1e-16 * np.abs(K).max(axis=(1, 2))
    shift = np.where(lowest <= noise, 1.2 * np.abs(lowest) + np.maximum(1e-10, noise), 0.0)
    dq = np.zeros((n, m))
    todo = np.arange(n)
    for _ in range(14):
        shifted = K[todo] + shift[todo, None, None] * np.eye(m)
        dq[todo] = _solve(shifted, rhs[todo])
        todo = todo[np.abs(dq[todo]).max(axis=1) > step[todo]]
        if not len(todo):
            break
        first = 0.017 / step[todo] * np.linalg.norm(rhs[todo], axis=1)
        shift[todo] = np.maximum(first, 2.5 * shift[todo])
    return dq, np.where(present, target - ratio * np.matmul(system.G, dq[..., None])[..., 0], 0.0)


def _solve(K: Array, b: Array) -> Array:
    """x (n, m) of K x = b; zero, no step, where rounding leaves K singular, as it does on some processors."""
    try:
        return np.asarray(np.linalg.solve(K, b[..., None])[..., 0])
    except np.linalg.LinAlgError:
        if len(K) == 1:
            return np.zeros_like(b)
        return np.concatenate([_solve(K[i : i + 1], b[i : i + 1]) for i in range(len(K))])


def admitted_share(room: Array, change: Array) -> Array:
    """Largest share (n,), at most 1, of `change` (n, c) that takes away no more than `room` (n, c)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(change < 0.0, -room / change, 1.0).min(axis=1, initial=1.0))


def _barrier_stiffness(system: System, gap: Array, lam: Array, present: Flags) -> tuple[Array, Array]:
    """K = -J + G^T diag(lam/gap) G (n, m, m) and the ratios lam/gap (n, c), zero in empty slots."""
    ratio = np.where(present, lam / gap, 0.0)
    return -system.J + np.matmul(system.G.transpose(0, 2, 1) * ratio[:, None, :], system.G), ratio


@dataclass(frozen=True)
class Valley:
    """Where a step with second-order corrections begins: contacts, gradients G (n, c, m), gap and ratio lam/gap (n, c),
    positive stiffness K (n, m, m); count: corrections per step. In a curved valley gaps change by the square of the
    step; a correction brings them back to their linear prediction, in the metric K.
    """

    contacts: CellContacts
    G: Array
    gap: Array
    ratio: Array
    K: Array
    count: int

    @staticmethod
    @np.errstate(divide="ignore", invalid="ignore", over="ignore")
    def of(system: System, contacts: CellContacts, gap: Array, lam: Array, count: int) -> Valley:
        """The valley of these poses."""
        K, ratio = _barrier_stiffness(system, gap, lam, contacts.present.reshape(gap.shape))
        K = 0.5 * (K + K.transpose(0, 2, 1))
        K = np.where(np.isfinite(K).all(axis=(1, 2), keepdims=True), K, np.eye(K.shape[1]))
        lowest = np.linalg.eigvalsh(K)[:, 0]
        shift = np.where(lowest <= 0.0, 1.2 * np.abs(lowest) + 1e-10, 1e-14)
        return Valley(contacts, system.G, gap, ratio, K + shift[:, None, None] * np.eye(K.shape[1]), count)

    def correct(self, rows: Index, step: Array, pose: Pose, equations: Equations) -> tuple[Pose, CellContacts]:
        """Corrected poses and their contacts of these rows, whose uncorrected steps (k, m) led to `pose`."""
        contacts, G = equations.contacts(pose), self.G[rows]
        predicted = self.gap[rows] + np.matmul(G, step[..., None])[..., 0]
        for _ in range(self.count):
            distance = _distances(self.contacts.take(rows), contacts)
            reached = np.take_along_axis(contacts.gap, distance.argmin(axis=2), axis=2).reshape(predicted.shape)
            known = np.isfinite(distance.min(axis=2)).reshape(predicted.shape)
            short = np.where(known, predicted - reached, 0.0)
            push = np.matmul(G.transpose(0, 2, 1), (self.ratio[rows] * short)[..., None])[..., 0]
            back = np.clip(_solve(self.K[rows], push), -LARGEST_CORRECTION, LARGEST_CORRECTION)
            pose = equations.moved(pose, back)
            contacts = equations.contacts(pose)
        return pose, contacts


def _distances(old: CellContacts, new: CellContacts) -> Array:
    """Between the points (n, p, SLOTS, SLOTS) of new and old contacts on ring a, inf where there is none."""
    between = new.rho[:, :, :, None] - old.rho[:, :, None, :]
    distance = np.sqrt(np.einsum("npijx,npijx->npij", between, between))
    return np.where(new.present[..., None] & old.present[:, :, None, :], distance, np.inf)


def accept_step(
    pose: Pose, contacts: CellContacts, dq: Array, floor: Array, equations: Equations, valley: Valley | None
) -> tuple[Pose, CellContacts]:
    """The pose after the longest of the steps 1, 1/2, 1/4 ... of dq (n, m) that keeps gaps above `floor` (n,) and
    links intact, and its contacts. With a valley, steps are corrected."""
    first, before, bad, halved = pose, contacts, np.arange(len(dq)), 0
    while halved < 31:
        # A few cases take as long as one: they try several steps at once.
        tries = min(max(1, TRIES // len(bad)), 31 - halved) if halved else 1
        row, length = np.tile(bad, tries), np.repeat(0.5 ** np.arange(halved, halved + tries), len(bad))
        here, step = first.take(row), length[:, None] * dq[row]
        there = equations.moved(here, step)
        if valley is None:
            found = equations.contacts(there)
        else:
            there, found = valley.correct(row, step, there, equations)
        good = found.links_intact & (found.min_gap >= floor[row])
        # Shorter steps cannot carry a ring through a wire.
        long = np.flatnonzero(np.abs(step).max(axis=1) > (0.2 * equations.thinnest if valley is None else 0.0))
        if len(long):
            way = parallel_clearance(here.take(long), there.take(long), equations.weave, equations.wire)
            good[long] &= way > -equations.wire
        good = good.reshape(tries, len(bad))
        longest = good.argmax(axis=0) * len(bad) + np.arange(len(bad))
        if halved:
            there, found = pose.put(bad, there.take(longest)), contacts.put(bad, found.take(longest))
        pose, contacts, bad, halved = there, found, bad[~good.any(axis=0)], halved + tries
        if not len(bad):
            return pose, contacts
    return pose.put(bad, first.take(bad)), contacts.put(bad, before.take(bad))
