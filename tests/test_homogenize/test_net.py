"""The net law against its definition: two fibres, brute force over loads, and differences of its energy."""

import numpy as np
import pytest

from homogenize import diagonal_net, ring_net
from homogenize.fitting import random_loads
from homogenize.laws import ring_cell
from rve.common import WEIGHT, double_dot, eigenvalues, trace

LAWS = {"ring": ring_net(ring_cell(5.0, 0.5, 11.0, 12.646069623526)), "abstract": diagonal_net(1.0)}


@pytest.fixture(params=sorted(LAWS))
def law(request):
    return LAWS[request.param]


def test_ring_net_knows_the_chain_and_the_weight():
    law = LAWS["ring"]
    assert law.limit == pytest.approx(18.0 / np.hypot(11.0, 12.646069623526), rel=1e-14)
    assert law.cell.areal_mass_kg_per_m2 == pytest.approx(2.785, abs=5e-4)
    uniaxial = law.support(np.array([[1.0, 0.0, 0.0]]))[0]
    assert uniaxial == pytest.approx(0.5 * ((18.0 / 11.0) ** 2 - 1.0), rel=1e-13)


def test_support_is_the_maximum_over_states_of_the_net(law):
    """Brute force: every state of two taut or slack straight fibres, sampled; the maximum is reached, never passed."""
    rng = np.random.default_rng(1)
    angle = rng.uniform(0.0, 2.0 * np.pi, size=(40000, 2))
    length = law.limit * np.where(rng.uniform(size=(40000, 2)) < 0.5, 1.0, rng.uniform(size=(40000, 2)))
    ends = length[:, :, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)  # images of the two unit fibres
    F = np.swapaxes(ends, 1, 2) @ np.linalg.inv(law.directions.T)
    C = np.einsum("nki,nkj->nij", F, F)
    E = 0.5 * (C[:, [0, 0, 1], [0, 1, 1]] - [1.0, 0.0, 1.0])
    S = random_loads(200)
    work = E @ (S * WEIGHT).T
    h = law.support(S)
    assert np.all(work.max(axis=0) <= h + 1e-12)
    assert np.all(work.max(axis=0) >= h - 5e-3)
    assert np.all(law.cut(E).violation <= 1e-12)


def test_cut_beats_every_sampled_half_space(law):
    rng = np.random.default_rng(2)
    E = rng.normal(scale=0.4, size=(300, 3))
    cut = law.cut(E)
    S = random_loads(20000)
    sampled = (E @ (S * WEIGHT).T - law.support(S)).max(axis=1)
    assert np.allclose(trace(cut.S), 1.0, atol=1e-12)
    assert eigenvalues(cut.S)[0].min() > -1e-12
    assert np.allclose(double_dot(cut.S, E) - law.support(cut.S), cut.violation, atol=1e-12)
    assert np.all(cut.violation >= sampled - 1e-12)
    assert np.all(cut.violation <= sampled + 5e-3)


def test_response_is_the_gradient_of_its_energy(law):
    rng = np.random.default_rng(3)
    E = rng.normal(scale=0.4, size=(400, 3))
    answer = law.response(E)
    step = 1e-6
    for j in range(3):
        dE = step * np.eye(3)[j]
        up, down = law.response(E + dE), law.response(E - dE)
        smooth = np.all(up.C == down.C, axis=(1, 2))
        assert smooth.sum() > 390
        assert np.allclose((up.energy - down.energy) / (2 * step), WEIGHT[j] * answer.S[:, j], atol=2e-3)
        assert np.allclose(((up.S - down.S) / (2 * step))[smooth], answer.C[smooth, :, j], atol=1e-4)
    assert eigenvalues(answer.S)[0].min() > -1e-9
    fibres = law.half_spaces()
    assert np.all(answer.E_star @ (fibres.S * WEIGHT).T <= fibres.h + 1e-9)
