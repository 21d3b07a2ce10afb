"""The wire of a ring: flexibility of a section, and the stress in its skin.

Section forces are those of the part ahead (at larger angles) on the part behind, at the centre of the wire, in axes r
(outwards), t (along the ring), z (its normal): force (V_r, N, V_z) in N, moment (M_r, M_t, M_z) in N mm; M_z > 0 bends
the ring more sharply.
"""

from dataclasses import dataclass, replace

import numpy as np

from rve.common import Array


@dataclass(frozen=True)
class Section:
    """Flexibility of one mm of wire: strain energy per length is half the square of the section forces with these.

    radius: of the centre circle, mm. bending (M_z), out_of_plane (M_r), torsion (M_t) in 1/(N mm2); axial (N), shear
    (V_r and V_z) in 1/N; coupling (N with M_z) in 1/(N mm).
    """

    radius: float
    bending: float
    out_of_plane: float
    torsion: float
    axial: float = 0.0
    shear: float = 0.0
    coupling: float = 0.0


@dataclass(frozen=True)
class Ring:
    """A ring of round wire: r1, r2 in mm, young in N/mm2, Poisson's ratio."""

    r1: float
    r2: float
    young: float
    poisson: float

    @property
    def shear_modulus(self) -> float:
        """G = E / (2 (1 + nu)), N/mm2."""
        return self.young / (2.0 * (1.0 + self.poisson))

    def thin(self) -> Section:
        """The section of thin wire: bending E I and torsion G J alone."""
        inertia = 0.25 * np.pi * self.r2**4
        bending = 1.0 / (self.young * inertia)
        return Section(self.r1, bending, bending, 1.0 / (self.shear_modulus * 2.0 * inertia))

    def straight(self) -> Section:
        """The section of a straight beam: E I, G J, E A and kappa G A, no coupling of N and M_z."""
        area = np.pi * self.r2**2
        shear = 1.0 / (shear_factor(self.poisson) * self.shear_modulus * area)
        return replace(self.thin(), axial=1.0 / (self.young * area), shear=shear)

    def curved(self) -> Section:
        """The section of the thick ring (Winkler): inner fibres are shorter than outer ones.

        In the plane 1/(E A e R) in place of 1/(E I), with e = R - r_n, the distance to the neutral fibre, and N and M_z
        coupled by 1/(E A R). Torsion and shear are those of a straight wire (docs/theory.md, 7).
        """
        straight, short = self.straight(), _short(self.r1, self.r2)
        area = np.pi * self.r2**2
        bending = 2.0 / (self.young * area * self.r1**2 * short)
        inertia = out_of_plane_inertia(self.r1, self.r2)
        coupling = 1.0 / (self.young * area * self.r1)
        return replace(straight, bending=bending, out_of_plane=1.0 / (self.young * inertia), coupling=coupling)


def _short(r1: float, r2: float) -> float:
    """1 - sqrt(1 - (r2/r1)^2) without cancellation: twice the eccentricity of the neutral fibre over r1."""
    share = (r2 / r1) ** 2
    return share / (1.0 + float(np.sqrt(1.0 - share)))


def out_of_plane_inertia(r1: float, r2: float) -> float:
    """Integral of z^2 r1/(r1 + x) over the round section, mm4; pi r2^4/4 for thin wire."""
    short = _short(r1, r2)
    return 2.0 / 3.0 * np.pi * r1**4 * short**2 * (1.5 - short)


def shear_factor(poisson: float) -> float:
    """Share of the round section that carries shear, 6 (1 + nu)/(7 + 6 nu) (Cowper, J. Appl. Mech. 33, 1966)."""
    return 6.0 * (1.0 + poisson) / (7.0 + 6.0 * poisson)


def skin_stress(forces: Array, fibre: Array, r1: float, r2: float) -> Array:
    """Von Mises stress in the skin of the wire, N/mm2, from section forces (..., 6) at the fibres (...).

    fibre: angle around the wire in radians, 0 outside, pi/2 at +z. Bending and tension as in a thick curved bar,

        sigma = N/A + M_z (r - r_n)/(A e r) - M_r z R/(I_r r),    r = R + r2 cos(fibre),    z = r2 sin(fibre),

    torsion with tau = M_t r2/J R/r. Transverse shear, of the order r2/r1 of the bending stress, is left out.

    >>> straight = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    >>> float(skin_stress(straight, np.array(0.0), 1e6, 1.0).round(4)), round(4.0 / np.pi, 4)
    (1.2732, 1.2732)
    """
    area, short = np.pi * r2**2, _short(r1, r2)
    x, z = r2 * np.cos(fibre), r2 * np.sin(fibre)
    r = r1 + x
    e = 0.5 * r1 * short
    sigma = forces[..., 1] / area + forces[..., 5] * (x + e) / (area * e * r)
    sigma = sigma - forces[..., 3] * z * r1 / (out_of_plane_inertia(r1, r2) * r)
    tau = forces[..., 4] * r1 / (0.5 * area * r2 * r)
    return np.asarray(np.sqrt(sigma**2 + 3.0 * tau**2))
