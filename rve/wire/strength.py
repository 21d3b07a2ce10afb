"""Strength of rings: first yield, plastic collapse, and both for a ring between two hooks.

Collapse is the largest load for which moments within yield balance it (static theorem), all six self-stresses of a ring
being free. A section yields where (M_r^2 + M_z^2)/M_p^2 + M_t^2/T_p^2 = 1; axial and shear force are left out, 1 % at
r1/r2 = 10 and less for thinner wire.
"""

from dataclasses import dataclass

import numpy as np

from rve.common import Array, InputError, NotConverged, checked
from rve.common.cell_fields import Joint
from rve.common.materials import STEEL, Material
from rve.wire.kernels import flexibility, internal_forces, self_stress
from rve.wire.section import Ring, skin_stress

BENDING, TORSION = 4.0 / 3.0, 2.0 * np.pi / 3.0 / np.sqrt(3.0)
"""Plastic moment and torque (by von Mises) of a round section over r2^3 sigma_y."""

RUPTURE = 0.30, 0.56
"""Force at which published chains of rings drawn to strings broke, over twice the area of the wire times its ultimate
stress, least and most; docs/measured/chains.md has tests, and one of thin wire that broke at less."""


@dataclass(frozen=True)
class StrengthOptions:
    """Numbers of the search for the largest stress and of the barrier method for collapse.

    sections, fibres: where the stress is computed first, sections of the ring in addition to those under the loads and
    fibres of each; half as many may miss the highest of two peaks, at an error of 6e-4. zooms, finer: how often and by
    how much the steps of the search shrink; 64 in all leave the stress within 1e-6 of a smooth peak.
    growth: factor on the sharpness of the barrier once Newton's squared decrement is below `centred`; more growth takes
    more Newton steps each time. fraction: of the way to the boundary that a step may go. steps: limit of Newton steps.
    """

    sections: int = 96
    fibres: int = 48
    zooms: int = 3
    finer: int = 4
    growth: float = 30.0
    centred: float = 1.0
    fraction: float = 0.8
    steps: int = 400


OPTIONS = StrengthOptions()


@dataclass(frozen=True)
class PulledRing:
    """A ring under two opposed forces F: F at first yield and at plastic collapse in N, opening over F in mm/N before,
    and the joint these are for, in degrees around the ring from one force; None for a welded ring. rupture_N: the band
    in which it breaks once it is drawn to a string (`RUPTURE`); None for a butted ring, which opens, and for a material
    without ultimate stress."""

    first_yield_N: float
    collapse_N: float
    opening_mm_per_N: float
    joint_deg: float | None
    rupture_N: tuple[float, float] | None = None


@checked
def pulled_ring(r1: float, r2: float, material: Material = STEEL, joint: str = "welded") -> PulledRing:
    """The ring of radius r1 (centre circle) and wire radius r2 in mm, pulled apart by two opposed forces in its plane.

    joint as for `with_rings`, its angle from one of the forces; with "butted:worst" each number is that at the angle
    worst for it, and joint_deg that of first yield. Collapse is the load at which the round ring begins to flow; wire
    that straightens and hardens carries more (docs/theory.md, 7). InputError for impossible rings and a material
    without yield stress.

    >>> ring = pulled_ring(5.0, 0.5, Material(yield_N_per_mm2=400.0, ultimate_N_per_mm2=None))
    >>> round(ring.collapse_N, 2) == round(4.0 * 4.0 / 3.0 * 0.5**3 * 400.0 / 5.0, 2)  # four hinges: 4 M_p/R
    True
    """
    stress = material.yield_N_per_mm2
    if not 0.0 < r2 < r1 < np.inf:
        raise InputError(f"r1 = {r1}, r2 = {r2}: a ring has 0 < r2 < r1, in mm")
    if stress is None:
        raise InputError(f"{material.name} has no yield stress: give one in N/mm2")
    ring = Ring(r1, r2, material.young_N_per_mm2, material.poisson)
    angles = Joint.of(joint).angles_deg
    phi, pull = np.array([[0.0, np.pi]]), np.tile([1.0, 0.0, 0.0], (1, 2, 1))
    at: list[Array | None] = [np.radians([angle]) for angle in angles] or [None]
    peaks = np.array([peak_stress(phi, pull, ring, x)[0][0] for x in at])
    loads = [plastic_collapse(phi, pull, ring, stress, x)[0][0] for x in at]
    opening = [flexibility(phi, pull, ring.curved(), x).sum() for x in at]
    worst = int(peaks.argmax())
    open_at = angles[worst] if angles else None
    band = None if angles else rupture_stress(material)
    last = None if band is None else (2.0 * np.pi * r2**2 * band[0], 2.0 * np.pi * r2**2 * band[1])
    return PulledRing(float(stress / peaks[worst]), float(min(loads)), float(max(opening)), open_at, last)


def rupture_stress(material: Material) -> tuple[float, float] | None:
    """Least and largest tension over the area of the wire, N/mm2, at which rings drawn to strings break; None if no
    ultimate stress is known."""
    ultimate = material.ultimate_N_per_mm2
    return None if ultimate is None else (RUPTURE[0] * ultimate, RUPTURE[1] * ultimate)


def peak_stress(
    phi: Array, forces: Array, ring: Ring, joint: Array | None = None, options: StrengthOptions = OPTIONS
) -> tuple[Array, Array, Array]:
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
    at = np.concatenate([checked_sections(phi, options), phi - 1e-9], axis=-1)  # N jumps at a load along the ring
    around, along = 2.0 * np.pi / options.fibres, 2.0 * np.pi / options.sections
    fibre = np.broadcast_to(around * np.arange(options.fibres), (*shape, options.fibres))
    steps = np.linspace(-1.0, 1.0, 2 * options.finer + 1)
    for zoom in range(options.zooms + 1):
        q = internal_forces(phi, forces, at, ring.curved(), joint)
        stress = skin_stress(q[..., :, None, :], fibre[..., None, :], ring.r1, ring.r2)
        flat = stress.reshape(*shape, -1)
        top = flat.argmax(axis=-1)[..., None]
        angle = np.take_along_axis(at, top // fibre.shape[-1], -1)
        skin = np.take_along_axis(fibre, top % fibre.shape[-1], -1)
        at = angle + along / options.finer**zoom * steps
        fibre = skin + around / options.finer**zoom * steps
    return np.take_along_axis(flat, top, -1)[..., 0], angle[..., 0], skin[..., 0]


def plastic_collapse(
    phi: Array,
    forces: Array,
    ring: Ring,
    yield_N_per_mm2: float,
    joint: Array | None = None,
    options: StrengthOptions = OPTIONS,
) -> tuple[Array, Array]:
    """The factors (n,) on forces (n, m, 3) at phi (n, m), local axes, in balance, at which rings become mechanisms:
    safe ones, and what they are at most.

    joint (n,): the angle at which butted rings are open, None for welded ones. Both factors differ by less than 1e-6,
    relative. NotConverged if `options.steps` steps of Newton's method do not suffice.

    >>> pull = np.array([[[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]])
    >>> factor, _ = plastic_collapse(np.array([[0.0, np.pi]]), pull, Ring(5.0, 0.5, 2e5, 0.3), 400.0)
    >>> hinges = 4.0 * 4.0 / 3.0 * 0.5**3 * 400.0 / 5.0  # four hinges: 4 M_p/R
    >>> bool(abs(factor[0] / hinges - 1.0) < 1e-6)
    True
    """
    base, free = relative_moments(phi, forces, ring, joint, options)
    factor, upper = largest_factors(base, free, tolerance=1e-6, options=options)
    lost = np.count_nonzero(np.isnan(factor))
    if lost:
        raise NotConverged(f"the plastic collapse of {lost} of {len(phi)} rings was not found in {options.steps} steps")
    return factor * yield_N_per_mm2, upper * yield_N_per_mm2


def checked_sections(phi: Array, options: StrengthOptions = OPTIONS) -> Array:
    """The angles (..., k) at which yield is checked: even ones and those of the loads phi (..., m). A moment between
    them is at most 5e-4 larger."""
    count = options.sections
    uniform = np.broadcast_to(2.0 * np.pi / count * np.arange(count), (*phi.shape[:-1], count))
    return np.concatenate([uniform, phi], axis=-1)


def relative_moments(
    phi: Array, forces: Array, ring: Ring, joint: Array | None, options: StrengthOptions = OPTIONS
) -> tuple[Array, Array]:
    """M_r, M_t, M_z over the plastic moments for unit yield stress at the `checked_sections`: (..., k, 3) by the forces
    (..., m, 3), and (n, k, 3, 6) by the self-stresses of the rings phi (n, m), of which butted rings have none."""
    at, plastic = checked_sections(phi, options), ring.r2**3 * np.array([BENDING, TORSION, BENDING])
    q = internal_forces(phi, forces, at, ring.thin(), joint)
    free = self_stress(at, ring.r1) if joint is None else np.zeros((*at.shape, 6, 0))
    return np.asarray(q[..., 3:] / plastic), np.asarray(free[..., 3:, :] / plastic[:, None])


def largest_factors(
    base: Array,
    free: Array,
    signs: Array | None = None,
    tolerance: float = 1e-4,
    options: StrengthOptions = OPTIONS,
) -> tuple[Array, Array]:
    """The largest mu (n,) with |mu base + free x| <= 1 at every section and signs (mu, x) >= 0: safe, and at most.

    base (n, k, 3), free (n, k, 3, v), signs (n, h, 1 + v), whose first column is positive. Newton's method with a
    logarithmic barrier; nan where `options.steps` steps do not suffice, most cases take 30.
    """
    J = np.moveaxis(np.concatenate([base[..., None], free], axis=3), 2, 1).copy()
    scale = np.abs(J).max(axis=(1, 2))
    scale = np.where(scale > 0.0, scale, 1.0)
    J = J / scale[:, None, None]
    H = np.zeros((len(J), 0, J.shape[3])) if signs is None else signs / scale[:, None]
    y = np.zeros((len(J), J.shape[3]))
    y[:, 0] = 0.5 / np.sqrt((J[..., 0] ** 2).sum(axis=1)).max(axis=1)
    degree = 2.0 * J.shape[2] + H.shape[1]
    sharp = degree / y[:, 0]
    go = np.arange(len(J))
    for _ in range(options.steps):
        rows = J if len(go) == len(J) else J[go]
        step, decrement = _newton(rows, H[go], y[go], sharp[go])
        y[go] += _length(rows, H[go], y[go], step, options.fraction)[:, None] * step
        centred = decrement < options.centred
        fine = degree <= 0.5 * tolerance * sharp[go] * y[go, 0]
        sharp[go] *= np.where(centred & ~fine, options.growth, 1.0)
        go = go[~(fine & (decrement < 1e-9))]
        if not len(go):
            break
    # The point is scaled out to the yield surface; its multipliers, which balance, give the upper bound.
    size = np.sqrt((_moments(J, y) ** 2).sum(axis=1))
    upper, factor = (2.0 * size / (1.0 - size**2)).sum(axis=1) / sharp, y[:, 0] / size.max(axis=1)
    factor[go] = np.nan
    return factor / scale[:, 0], np.maximum(upper, factor) / scale[:, 0]


def _moments(J: Array, y: Array) -> Array:
    """Relative moments (n, 3, k) of the unknowns y (n, p) by J (n, 3, k, p)."""
    return np.asarray(np.matmul(J.reshape(len(J), -1, J.shape[3]), y[..., None]).reshape(J.shape[:3]))


def _newton(J: Array, H: Array, y: Array, sharp: Array) -> tuple[Array, Array]:
    """Newton's step (n, p) on the barrier function and its squared decrement (n,)."""
    n, p = y.shape
    m = _moments(J, y)
    slope = 2.0 / (1.0 - (m**2).sum(axis=1))
    Jm = (m[:, 0, :, None] * J[:, 0] + m[:, 1, :, None] * J[:, 1] + m[:, 2, :, None] * J[:, 2]) * slope[..., None]
    left = H / np.matmul(H, y[..., None])
    gradient = Jm.sum(axis=1) - left.sum(axis=1)
    gradient[:, 0] -= sharp
    bent = (J * slope[:, None, :, None]).reshape(n, -1, p)
    K = np.matmul(J.reshape(n, -1, p).transpose(0, 2, 1), bent)
    K += np.matmul(Jm.transpose(0, 2, 1), Jm) + np.matmul(left.transpose(0, 2, 1), left)
    unused = np.einsum("nii->ni", K) == 0.0
    np.einsum("nii->ni", K)[...] += unused
    step = -np.linalg.solve(K, gradient[..., None])[..., 0]
    return step, -np.einsum("nv,nv->n", gradient, step)


def _length(J: Array, H: Array, y: Array, step: Array, fraction: float) -> Array:
    """Step lengths (n,), at most 1: a fraction of the way to where a section yields or a sign turns."""
    m, dm = _moments(J, y), _moments(J, step)
    a, b, room = (dm**2).sum(axis=1), (m * dm).sum(axis=1), 1.0 - (m**2).sum(axis=1)
    g, dg = np.matmul(H, y[..., None])[..., 0], np.matmul(H, step[..., None])[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        yields = room / (b + np.sqrt(b**2 + a * room))  # |m + yields dm| = 1
        turns = np.where(dg < 0.0, -g / dg, np.inf)
    return np.asarray(np.minimum(1.0, fraction * np.minimum(yields.min(axis=1), turns.min(axis=1, initial=np.inf))))
