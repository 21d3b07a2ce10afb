"""Laws that the curtain's tests share."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from homogenize import fit
from homogenize.laws import Cut, HalfSpaces
from rve import read_table
from rve.geometry import CellInfo
from tests.test_macro_fem.sheets import sheet

TABLE = Path(__file__).parents[1] / "test_homogenize" / "data" / "table190.csv"
WEIGHT = np.array([1.0, 2.0, 1.0])
RINGS = CellInfo(5.0, 0.5, 11.0, 12.646069623526, 2.785)
STRETCH_X = 17.42005 / 11.0
SHRINK_Y = 4.25798 / 12.646069623526


@dataclass(frozen=True, eq=False)
class VertexLaw:
    """The outer polyhedron of a few locked strains: h(S) is the largest S:E over them, for a fan of loads S."""

    vertices: np.ndarray
    S: np.ndarray
    name: str = "vertices"
    cell: CellInfo | None = RINGS

    @property
    def h(self):
        return self.support(self.S)

    def support(self, S):
        return ((S * WEIGHT) @ self.vertices.T).max(axis=1)

    def half_spaces(self):
        few = np.linspace(0, len(self.S) - 1, 7).astype(int)
        return HalfSpaces(self.S[few], self.h[few])

    def facets(self):
        return HalfSpaces(self.S, self.h)

    def elastic(self):
        return self

    def cut(self, E):
        violation = (E * WEIGHT) @ self.S.T - self.h
        worst = violation.argmax(axis=1)
        return Cut(self.S[worst], self.h[worst], violation[np.arange(len(E)), worst])

    @property
    def compliance(self):
        return np.eye(3)

    def response(self, E):
        raise NotImplementedError

    def to_dict(self) -> dict:
        return {}


def fan(n_alpha: int = 12, n_beta: int = 9) -> np.ndarray:
    """Unit-trace tensile loads over all directions and ratios."""
    alpha = np.pi * np.arange(n_alpha) / n_alpha
    share = np.linspace(0.0, 0.5, n_beta)
    a, s = (x.ravel() for x in np.meshgrid(alpha, share, indexing="ij"))
    c2, s2 = np.cos(2 * a), np.sin(2 * a)
    half = 0.5 * (1.0 - 2.0 * s)
    return np.unique(np.round(np.stack([0.5 + half * c2, half * s2, 0.5 - half * c2], axis=-1), 15), axis=0)


@pytest.fixture(scope="session")
def ring_like():
    """Three locked states of the rings: the reference, the equibiaxial and the uniaxial one along x."""
    stretches = np.array([[1.0, 1.0], [13.1163049 / 11.0, 11.2301635 / 12.646069623526], [STRETCH_X, SHRINK_Y]])
    E = 0.5 * (stretches**2 - 1.0)
    return VertexLaw(np.column_stack([E[:, 0], np.zeros(3), E[:, 1]]), fan())


@pytest.fixture
def scene_tables():
    """Tables of a small scene; a test changes what it is about."""

    def make(hang="y", width=100.0, height=100.0, areal_mass=2.785, mesh=(), support=(), load=(), solver=()):
        held = dict(support) or {"kind": "top"}
        return sheet(width, height, 6, held, mesh, load, solver, weave_angle=hang, areal_mass=areal_mass)

    return make


@pytest.fixture(scope="session")
def fitted_law():
    """The law that `rve table` and `homogenize fit` make with their own defaults.

    That `rve table` makes this table is tested in tests/test_homogenize/test_table.py.
    """
    return fit(replace(read_table(TABLE), compliance=None, strength=None)).law
