"""First yield of a ring: the largest von Mises stress in the skin of its wire, welded or butted."""

from __future__ import annotations

import numpy as np

from rve.common import Array
from rve.ring.kernels import internal_forces
from rve.ring.section import Ring, skin_stress

SECTIONS = 96
"""Sections looked at first, besides those under the loads."""
FIBRES = 48
"""Fibres of each section looked at first; the best pair is then looked at more closely (`_ZOOMS`)."""
_ZOOMS, _FINER = 3, 4
"""How often, and by how much, the steps of the search shrink: 64 in all, for a stress within 1e-6 of a smooth peak."""
_BEFORE = 1e-9
"""N jumps at a load with a part along the ring: the section this angle before it is looked at as well."""


def peak_stress(phi: Array, forces: Array, ring: Ring, joint: Array | None = None) -> tuple[Array, Array, Array]:
    """The largest von Mises stress of rings (...) under forces (..., m, 3) at phi (..., m) in N/mm2, and the angles in
    radians of its section along the ring and of its fibre around the wire.

    joint (...): the angle at which a butted ring is open, None for a welded one. Exact but for a search whose first
    steps could rank two peaks wrongly that differ by less than 3e-3.

    >>> pull = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    >>> stress, _, _ = peak_stress(np.array([0.0, np.pi]), pull, Ring(1000.0, 1.0, 2e5, 0.3))
    >>> thin = 4.0 / np.pi * 1000.0 / np.pi  # M_z r2 / I with M_z = F R / pi
    >>> bool(abs(stress / thin - 1.0) < 2e-3)
    True
    """
    shape = phi.shape[:-1]
    uniform = np.broadcast_to(2.0 * np.pi / SECTIONS * np.arange(SECTIONS), (*shape, SECTIONS))
    at = np.concatenate([uniform, phi, phi - _BEFORE], axis=-1)
    fibre = np.broadcast_to(2.0 * np.pi / FIBRES * np.arange(FIBRES), (*shape, FIBRES))
    steps = np.linspace(-1.0, 1.0, 2 * _FINER + 1)
    for zoom in range(_ZOOMS + 1):
        q = internal_forces(phi, forces, at, ring.curved(), joint)
        stress = skin_stress(q[..., :, None, :], fibre[..., None, :], ring.r1, ring.r2)
        flat = stress.reshape(*shape, -1)
        top = flat.argmax(axis=-1)[..., None]
        angle = np.take_along_axis(at, top // fibre.shape[-1], -1)
        skin = np.take_along_axis(fibre, top % fibre.shape[-1], -1)
        at = angle + 2.0 * np.pi / SECTIONS / _FINER**zoom * steps
        fibre = skin + 2.0 * np.pi / FIBRES / _FINER**zoom * steps
    return np.take_along_axis(flat, top, -1)[..., 0], angle[..., 0], skin[..., 0]
