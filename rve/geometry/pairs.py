"""Pairs of rings that a weave does not list because they never meet, and the proof that they did not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rve.common.types import Array
from rve.geometry.contacts import can_touch, find_contacts
from rve.geometry.pose import Pose, pair_geometry
from rve.geometry.weave import Weave

SHELL = 4
"""Primitive cells on every side among which unlisted pairs are looked for."""


def unlisted_pairs(weave: Weave) -> Weave:
    """The weave with only the pairs that it does not list, each once, up to `SHELL` primitive cells apart."""
    listed = {tuple(pair) for pair in weave.pairs.tolist()}
    listed |= {(b, a, -i, -j) for a, b, i, j in listed}
    nx, ny = (-(-SHELL // count) for count in weave.repeat)
    found = []
    for a in range(weave.classes):
        for b in range(a, weave.classes):
            for i in range(-nx, nx + 1):
                for j in range(-ny, ny + 1):
                    is_new = (a, b, i, j) not in listed and (a < b or (i, j) > (0, 0))
                    found += [(a, b, i, j)] if is_new else []
    return replace(weave, pairs=np.array(found, dtype=int).reshape(-1, 4), linked=np.zeros(len(found), dtype=bool))


def widened(weave: Weave) -> Weave:
    """The weave with all its pairs up to `SHELL` primitive cells apart listed."""
    rest = unlisted_pairs(weave)
    return replace(
        weave, pairs=np.concatenate([weave.pairs, rest.pairs]), linked=np.concatenate([weave.linked, rest.linked])
    )


def unlisted_gap(pose: Pose, weave: Weave, wire: float) -> Array:
    """Smallest gap (n,) of unlisted pairs in r1, or a lower bound of it where their centres are too far apart."""
    rest = unlisted_pairs(weave)
    d, _, _ = pair_geometry(pose, rest)
    bound = np.sqrt((d**2).sum(axis=2)).min(axis=1, initial=np.inf) - 2.0 - 2.0 * wire
    near = np.flatnonzero(can_touch(d, 2.0 * wire).any(axis=1))
    if len(near):
        bound[near] = find_contacts(pose.take(near), rest, wire, np.inf).min_gap
    return np.asarray(bound)


def pairs_in_reach(pose: Pose, weave: Weave, wire: float, reach: float) -> NDArray[np.intp]:
    """How many listed pairs of each pose are near enough to be sampled, (n,)."""
    return np.asarray(can_touch(pair_geometry(pose, weave)[0], 2.0 * wire + reach).sum(axis=1))
