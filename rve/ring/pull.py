"""One ring between two hooks: the tensile test of a single ring."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rve.common import Array, InputError
from rve.common.materials import STEEL, Material
from rve.common.rings import Joint
from rve.ring.collapse import plastic_collapse
from rve.ring.kernels import flexibility
from rve.ring.section import Ring
from rve.ring.stress import peak_stress


@dataclass(frozen=True)
class PulledRing:
    """A ring under two opposed forces F: F at first yield and at plastic collapse in N, opening over F in mm/N before,
    and the joint these are for, in degrees around the ring from one force; None for a welded ring."""

    first_yield_N: float
    collapse_N: float
    opening_mm_per_N: float
    joint_deg: float | None


def pulled_ring(r1: float, r2: float, material: Material = STEEL, joint: str = "welded") -> PulledRing:
    """The ring of radius r1 (centre circle) and wire radius r2 in mm, pulled apart by two opposed forces in its plane.

    joint as for `RingOptions`, its angle counted from one of the forces; with "butted:worst" each number is that at its
    own worst angle, and joint_deg that of first yield. Wire that straightens, and hardens, bears more: collapse is the
    load at which the round ring begins to flow (docs/theory.md, 7). InputError for impossible rings and a material
    without yield stress.

    >>> found = pulled_ring(5.0, 0.5, Material(yield_N_per_mm2=400.0, ultimate_N_per_mm2=None))
    >>> round(found.collapse_N, 2) == round(4.0 * 4.0 / 3.0 * 0.5**3 * 400.0 / 5.0, 2)  # four hinges: 4 M_p/R
    True
    """
    stress = material.yield_N_per_mm2
    if stress is None:
        raise InputError(f"{material.name} has no yield stress: give one in N/mm2")
    ring = Ring(r1, r2, material.young_N_per_mm2, material.poisson)
    angles = Joint.of(joint).angles_deg
    phi, pull = np.array([[0.0, np.pi]]), np.tile([1.0, 0.0, 0.0], (1, 2, 1))
    at: list[Array | None] = [np.radians([angle]) for angle in angles] or [None]
    peaks = np.array([peak_stress(phi, pull, ring, x)[0][0] for x in at])
    loads = [plastic_collapse(phi, pull, ring, stress, joint=x)[0][0] for x in at]
    opening = [flexibility(phi, pull, ring.curved(), x).sum() for x in at]
    worst = int(peaks.argmax())
    open_at = angles[worst] if angles else None
    return PulledRing(float(stress / peaks[worst]), float(min(loads)), float(max(opening)), open_at)
