"""The jamming limit and the start pose, found again by sequential linear programming."""

import numpy as np
import pytest
from scipy.optimize import linprog

from rve.cell import find_contacts, moved, pair_maps, reduction, start_pose
from rve.contact import distance_gradient
from rve.weave import WEAVES


@pytest.mark.parametrize("name", WEAVES)
def test_start_pose_has_the_largest_clearance_and_it_is_the_jamming_limit(name):
    weave = WEAVES[name]
    maps = pair_maps(weave)
    rng = np.random.default_rng(0)
    pose = moved(start_pose(weave, 1), 0.05 * rng.uniform(-1, 1, (1, 4 * weave.classes + 1)))
    contacts = find_contacts(pose, weave, 0.0, 1.2)
    radius = 0.05
    while radius > 1e-8:
        pair = contacts.minima.pair
        G = np.einsum("mi,mij,jk->mk", distance_gradient(contacts.minima), maps[pair], reduction(pose)[0])
        m = G.shape[1]
        step = linprog(
            np.append(np.zeros(m), -1.0),
            A_ub=np.column_stack([-G, np.ones(len(G))]),
            b_ub=contacts.minima.distance,
            bounds=[(-radius, radius)] * m + [(None, None)],
        ).x[:m]
        trial = moved(pose, step[None])
        found = find_contacts(trial, weave, 0.0, 1.2)
        if found.links_intact[0] and found.min_gap[0] > contacts.min_gap[0]:
            pose, contacts, radius = trial, found, 1.3 * radius
        else:
            radius *= 0.5
    assert 2.0 / contacts.min_gap[0] == pytest.approx(weave.jamming_ratio, rel=1e-6)
    start = find_contacts(start_pose(weave, 1), weave, 0.0, 1.2)
    assert start.min_gap[0] == pytest.approx(contacts.min_gap[0], rel=1e-6)
