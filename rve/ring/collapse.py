"""Plastic collapse of rings: the largest load for which moments within yield balance it (static theorem).

A section yields where (M_r^2 + M_z^2)/M_p^2 + M_t^2/T_p^2 = 1, with M_p = 4/3 r2^3 sigma_y and
T_p = 2 pi/3 r2^3 sigma_y/sqrt(3). Axial and shear force are left out: they lower the load by about (N/N_p)^2, 1 % at
r1/r2 = 10 and less for thinner wire. The six self-stresses of each ring are free. Maximising the load is a cone program
in a few unknowns, solved by Newton's method with a logarithmic barrier for all rings at once. With its round yield
surface replaced by planes it is the linear program of plastic hinges (tests/test_rve/test_ring_collapse.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rve.common.errors import NotConverged
from rve.common.types import Array
from rve.ring.kernels import internal_forces, opened_forces, self_stress
from rve.ring.section import Ring, Section

BENDING = 4.0 / 3.0
"""Plastic moment of a round section over r2^3 sigma_y."""
TORSION = 2.0 * np.pi / 3.0 / np.sqrt(3.0)
"""Plastic torque of a round section over r2^3 sigma_y, by von Mises."""
SECTIONS = 120
"""Sections at which yield is checked, besides those under the loads: a moment between them is at most 4e-4 larger."""
_GROWTH = 10.0
"""Factor on the barrier's sharpness once Newton's decrement is below `_CENTRED`; larger ones take more steps each."""
_CENTRED = 0.1


@dataclass(frozen=True)
class Limits:
    """The largest factors (n,) on loads: `factor` is safe, the exact one is at most `upper`."""

    factor: Array
    upper: Array


def plastic_collapse(
    phi: Array,
    forces: Array,
    ring: Ring,
    yield_N_per_mm2: float,
    *,
    joint: Array | None = None,
    tolerance: float = 1e-6,
) -> Limits:
    """The factors (n,) on forces (n, m, 3) at phi (n, m), local axes, in balance, at which rings become mechanisms.

    joint (n,): the angle at which butted rings are open, None for welded ones. `factor` and `upper` of the result
    differ by less than `tolerance`, relative. NotConverged if the program is not solved.

    >>> pull = np.array([[[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]])
    >>> found = plastic_collapse(np.array([[0.0, np.pi]]), pull, Ring(5.0, 0.5, 2e5, 0.3), 400.0)
    >>> hinges = 4.0 * 4.0 / 3.0 * 0.5**3 * 400.0 / 5.0  # four hinges: 4 M_p/R
    >>> bool(abs(found.factor[0] / hinges - 1.0) < 1e-6)
    True
    """
    at = checked_sections(phi)
    section = ring.thin()
    if joint is None:
        q, free = internal_forces(phi, forces, at, section), relative_moments(self_stress(at, ring.r1), ring.r2)
    else:
        q, free = opened_forces(phi, forces, at, joint, section), np.zeros((*at.shape, 3, 0))
    base = relative_moments(q[..., None], ring.r2)[..., 0]
    found = largest_factors(base, free, tolerance=tolerance)
    return Limits(found.factor * yield_N_per_mm2, found.upper * yield_N_per_mm2)


def checked_sections(phi: Array) -> Array:
    """The angles (..., k) at which yield is checked: SECTIONS of them and those of the loads phi (..., m)."""
    uniform = np.broadcast_to(2.0 * np.pi / SECTIONS * np.arange(SECTIONS), (*phi.shape[:-1], SECTIONS))
    return np.concatenate([uniform, phi], axis=-1)


def unit_moments(phi: Array, directions: Array, at: Array, section: Section, r2: float) -> Array:
    """Relative moments (n, k, 3, m) at the sections at (n, k) by unit forces along directions (n, m, 3) at phi (n, m)."""
    m = phi.shape[1]
    q = np.stack(
        [internal_forces(phi[:, [j]], directions[:, [j]], at, section) for j in range(m)], axis=-1
    )
    return relative_moments(q, r2)


def relative_moments(q: Array, r2: float) -> Array:
    """M_r, M_t, M_z of section forces (..., 6, v) over the plastic moments for unit yield stress, (..., 3, v)."""
    plastic = r2**3 * np.array([BENDING, TORSION, BENDING])
    return np.asarray(q[..., 3:, :] / plastic[:, None])


def largest_factors(
    base: Array, free: Array, signs: Array | None = None, tolerance: float = 1e-4, steps: int = 400
) -> Limits:
    """The largest mu (n,) with |mu base + free x| <= 1 at every section and signs (mu, x) >= 0.

    base (n, k, 3), free (n, k, 3, v), signs (n, h, 1 + v), whose first column is positive. NotConverged after too many
    `steps`.
    """
    J = np.concatenate([base[..., None], free], axis=3)
    scale = np.abs(J).max(axis=(1, 2))
    scale = np.where(scale > 0.0, scale, 1.0)
    J = J / scale[:, None, None]
    H = np.zeros((len(J), 0, J.shape[3])) if signs is None else signs / scale[:, None]
    y = np.zeros((len(J), J.shape[3]))
    y[:, 0] = 0.5 / np.sqrt((J[..., 0] ** 2).sum(axis=2)).max(axis=1)
    degree = 2.0 * J.shape[1] + H.shape[1]
    sharp = degree / y[:, 0]
    go = np.arange(len(J))
    for _ in range(steps):
        step, decrement = _newton(J[go], H[go], y[go], sharp[go])
        y[go] += _length(J[go], H[go], y[go], step, sharp[go])[:, None] * step
        centred = decrement < _CENTRED
        fine = degree <= 0.5 * tolerance * sharp[go] * y[go, 0]
        sharp[go] *= np.where(centred & ~fine, _GROWTH, 1.0)
        go = go[~(fine & (decrement < 1e-9))]
        if not len(go):
            return _bounds(J, H, y, sharp, scale[:, 0])
    raise NotConverged(f"the plastic collapse of {len(go)} of {len(J)} cases was not found in {steps} Newton steps")


def _newton(J: Array, H: Array, y: Array, sharp: Array) -> tuple[Array, Array]:
    """Newton's step (n, 1 + v) on the barrier function and its squared decrement (n,)."""
    m = np.einsum("nkcv,nv->nkc", J, y)
    room = 1.0 - (m**2).sum(axis=2)
    Jm = np.einsum("nkcv,nkc->nkv", J, m) * (2.0 / room)[..., None]
    left = H / np.einsum("nhv,nv->nh", H, y)[..., None]
    gradient = Jm.sum(axis=1) - left.sum(axis=1)
    gradient[:, 0] -= sharp
    rows = np.concatenate([(J * np.sqrt(2.0 / room)[..., None, None]).reshape(len(J), -1, J.shape[3]), Jm, left], axis=1)
    K = np.matmul(rows.transpose(0, 2, 1), rows)
    unused = np.einsum("nii->ni", K) == 0.0
    np.einsum("nii->ni", K)[...] += unused
    step = -np.linalg.solve(K, gradient[..., None])[..., 0]
    return step, -np.einsum("nv,nv->n", gradient, step)


def _length(J: Array, H: Array, y: Array, step: Array, sharp: Array) -> Array:
    """Step lengths (n,): halved until the barrier function falls."""
    size = np.ones(len(y))
    start = _barrier(J, H, y, sharp)
    for _ in range(40):
        worse = ~(_barrier(J, H, y + size[:, None] * step, sharp) <= start + 1e-12 * np.abs(start))
        if not worse.any():
            break
        size[worse] *= 0.5
    return size


def _barrier(J: Array, H: Array, y: Array, sharp: Array) -> Array:
    """- sharp mu - sum log(1 - |m|^2) - sum log(signs y), (n,); inf outside."""
    room = 1.0 - (np.einsum("nkcv,nv->nkc", J, y) ** 2).sum(axis=2)
    left = np.einsum("nhv,nv->nh", H, y)
    inside = (room > 0.0).all(axis=1) & (left > 0.0).all(axis=1)
    value = -sharp * y[:, 0] - np.log(np.where(room > 0.0, room, 1.0)).sum(axis=1)
    value -= np.log(np.where(left > 0.0, left, 1.0)).sum(axis=1)
    return np.where(inside, value, np.inf)


def _bounds(J: Array, H: Array, y: Array, sharp: Array, scale: Array) -> Limits:
    """The answer scaled out to the yield surface, and the bound of the multipliers on it, which balance here."""
    m = np.einsum("nkcv,nv->nkc", J, y)
    size = np.sqrt((m**2).sum(axis=2))
    upper = (2.0 * size / (1.0 - size**2)).sum(axis=1) / sharp
    factor = y[:, 0] / size.max(axis=1)
    return Limits(factor / scale, np.maximum(upper, factor) / scale)
