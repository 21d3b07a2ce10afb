"""The springs that pull a cell to a strain: their forces are derivatives of the energy that they claim to have."""

import numpy as np
import pytest

from rve import WEAVES
from rve.geometry import FOUR_IN_ONE, SIX_IN_ONE, green_lagrange, moved, reduction, start_pose, supercell
from rve.placed.poses import Spring, split_response

SPRING = Spring((2.2, 2.5), fold=0.1, weak=0.3)
CASES = 5


def tensors(triples):
    return np.stack([np.stack([triples[:, 0], triples[:, 1]], 1), np.stack([triples[:, 1], triples[:, 2]], 1)], 1)


def split_energy(D, fold):
    values = np.linalg.eigvalsh(tensors(D))
    return 0.5 * (np.where(values > 0.0, fold, 1.0) * values**2).sum(axis=1)


def energy(pose, rows):
    """The potential of the module's header, written out plainly."""
    n, k = pose.normals.shape[:2]
    F = np.stack([pose.a1 / SPRING.sides[0], pose.a2 / SPRING.sides[1]], axis=2)
    total = split_energy(green_lagrange(F) - rows[:, :3], SPRING.fold)
    shares, normals = rows[:, 3 : 3 * k].reshape(n, k - 1, 3), rows[:, 3 * k :].reshape(n, k, 3)
    place = shares[..., :1] * pose.a1[:, None] + shares[..., 1:2] * pose.a2[:, None]
    place = np.concatenate([place, shares[..., 2:]], axis=2)[..., : pose.centres.shape[2]]
    off = ((pose.centres[:, 1:] - place) ** 2).sum(axis=(1, 2)) + ((pose.normals - normals) ** 2).sum(axis=(1, 2))
    return total + 0.5 * SPRING.weak * off


WOVEN = [FOUR_IN_ONE, SIX_IN_ONE, supercell(FOUR_IN_ONE, 2, 1), WEAVES["kings-4-in-1"]]


@pytest.mark.parametrize("weave", WOVEN, ids=lambda w: w.name)
def test_force_and_stiffness_are_derivatives_of_the_energy(weave):
    rng, k, h = np.random.default_rng(3), weave.classes, 1e-4
    m = weave.coordinates
    pose = moved(start_pose(weave, CASES), rng.uniform(-0.2, 0.2, (CASES, m)))
    normals = rng.normal(size=(CASES, k, 3))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    parts = (rng.uniform(-0.3, 0.3, (CASES, 3)), rng.uniform(0.0, 1.0, (CASES, 3 * (k - 1))), normals)
    rows = np.concatenate([part.reshape(CASES, -1) for part in parts], axis=1)
    f, J = SPRING(pose, reduction(pose), rows)
    step = h * np.eye(m)

    def at(v):
        return energy(moved(pose, np.tile(v, (CASES, 1))), rows)

    for a in range(m):
        np.testing.assert_allclose(f[:, a], -(at(step[a]) - at(-step[a])) / (2.0 * h), atol=1e-7)
        for b in range(m):
            second = at(step[a] + step[b]) - at(step[a] - step[b]) - at(step[b] - step[a]) + at(-step[a] - step[b])
            np.testing.assert_allclose(J[:, a, b], -second / (4.0 * h * h), atol=2e-6)


@pytest.mark.parametrize("fold", [1.0, 1e-2])
def test_split_response_of_tensors_with_equal_or_vanishing_principal_values(fold):
    D = np.array([[0.3, 0.0, 0.3], [-0.2, 0.0, -0.2], [0.0, 0.0, 0.0], [0.0, 0.1, 0.0]])
    gradient, H = split_response(D, fold)
    np.testing.assert_allclose(gradient[0], fold * D[0], atol=1e-15)
    np.testing.assert_allclose(gradient[1], D[1], atol=1e-15)
    np.testing.assert_allclose(gradient[2], 0.0, atol=1e-15)
    # 0.1 (e1 e2 + e2 e1) has the principal values 0.1, -0.1: half the shear weighs `fold`, half 1.
    np.testing.assert_allclose(gradient[3], [0.05 * (fold - 1.0), 0.05 * (fold + 1.0), 0.05 * (fold - 1.0)], atol=1e-15)
    np.testing.assert_allclose(H[1] @ [0.1, 0.2, 0.3], [0.1, 0.2, 0.3], atol=1e-15)
