"""An independent model of a ring: a closed polygon of straight beam elements in space, by stiffness and a solve."""

import numpy as np


def local_axes(phi):
    """Unit vectors r, t, z as rows at the angles phi (m,), (m, 3, 3)."""
    zero = np.zeros_like(phi)
    r = np.stack([np.cos(phi), np.sin(phi), zero], axis=-1)
    t = np.stack([-np.sin(phi), np.cos(phi), zero], axis=-1)
    return np.stack([r, t, np.broadcast_to([0.0, 0.0, 1.0], r.shape)], axis=-2)


def balanced(phi, forces, radius):
    """The forces (m, 3) in local axes closest to the given ones that balance on a ring."""
    axes = local_axes(phi)
    arm = radius * axes[:, 0]
    unit = axes.reshape(-1, 3)
    A = np.concatenate([unit, np.cross(np.repeat(arm, 3, axis=0), unit)], axis=1).T
    f = forces.ravel()
    return (f - np.linalg.pinv(A) @ (A @ f)).reshape(-1, 3)


def _element(length, EA, EIz, EIy, GJ, GAs):
    """Stiffness (12, 12) of a Timoshenko beam along its first axis; shear bends it in both planes by 1/GAs."""
    K = np.zeros((12, 12))
    for i, k in ((0, EA / length), (3, GJ / length)):
        K[np.ix_([i, i + 6], [i, i + 6])] += k * np.array([[1.0, -1.0], [-1.0, 1.0]])
    for EI, dofs, sign in ((EIz, (1, 5, 7, 11), 1.0), (EIy, (2, 4, 8, 10), -1.0)):
        p = 12.0 * EI / (GAs * length**2) if GAs else 0.0
        a, b, L = 12.0, 6.0 * length, length**2
        block = np.array(
            [
                [a, b, -a, b],
                [b, (4.0 + p) * L, -b, (2.0 - p) * L],
                [-a, -b, a, -b],
                [b, (2.0 - p) * L, -b, (4.0 + p) * L],
            ]
        ) * (EI / (length**3 * (1.0 + p)))
        signs = np.array([1.0, sign, 1.0, sign])
        K[np.ix_(dofs, dofs)] += block * np.outer(signs, signs)
    return K


def frame_flexibility(phi, directions, radius, stiffness, count=240):
    """Flexibility (m, m) between points of a ring as in `rve.wire.kernels.flexibility`, for balanced forces.

    stiffness: E A, E I in the plane, E I out of it, G J, kappa G A (0: no shear). Nodes lie at all points phi.
    """
    angle = np.unique(np.concatenate([2.0 * np.pi * np.arange(count) / count, np.mod(phi, 2.0 * np.pi)]))
    angle = angle[np.diff(np.append(angle, 2.0 * np.pi)) > 1e-9]  # round-off on either side of 0 is one node
    n = len(angle)
    x = radius * local_axes(angle)[:, 0]
    K = np.zeros((6 * n, 6 * n))
    for i in range(n):
        j = (i + 1) % n
        along = x[j] - x[i]
        length = np.linalg.norm(along)
        e1, e3 = along / length, np.array([0.0, 0.0, 1.0])
        # beam axes: along, in-plane across (z x along), z; rotation about z bends in the plane
        R = np.kron(np.eye(4), np.stack([e1, np.cross(e3, e1), e3]))
        EA, EI_in, EI_out, GJ, GAs = stiffness
        dofs = np.concatenate([np.arange(6 * i, 6 * i + 6), np.arange(6 * j, 6 * j + 6)])
        K[np.ix_(dofs, dofs)] += R.T @ _element(length, EA, EI_in, EI_out, GJ, GAs) @ R
    rows = np.array([int(np.abs(np.angle(np.exp(1j * (angle - p)))).argmin()) for p in phi])
    load = np.zeros((6 * n, len(phi)))
    force = np.einsum("mi,mij->mj", directions, local_axes(phi))
    for m, row in enumerate(rows):
        load[6 * row : 6 * row + 3, m] += force[m]
    rigid = np.zeros((6 * n, 6))
    for i in range(n):
        rigid[6 * i : 6 * i + 3, :3] = rigid[6 * i + 3 : 6 * i + 6, 3:] = np.eye(3)
        rigid[6 * i : 6 * i + 3, 3:] = np.cross(np.eye(3), x[i]).T.T
    Q = np.linalg.qr(rigid)[0]
    load -= Q @ (Q.T @ load)  # what does not balance drops out
    u = np.linalg.solve(K + np.trace(K) / len(K) * Q @ Q.T, load)
    return load.T @ u


def random_load(seed, count=7, radius=5.0):
    """Angles (count,) and forces (count, 3) in balance on a ring of this radius."""
    rng = np.random.default_rng(seed)
    phi = rng.uniform(0.0, 2.0 * np.pi, count)
    return phi, balanced(phi, rng.normal(size=(count, 3)), radius)
