"""The door to `macro_fem`: what a membrane law is, and how to get one.

Symmetric 2 x 2 tensors are triples (11, 12, 22) of tensor components on the last axis, the leading axis is the point:
S:E = S11 E11 + 2 S12 E12 + S22 E22. Line loads and stiffnesses are in N/mm, strains have no unit.

>>> import numpy as np
>>> law = default_law()
>>> law.cut(np.array([[0.8, 0.0, -0.4]])).violation > 0  # stretched further along x than the rings allow
array([ True])
"""

from __future__ import annotations

from homogenize.io import default_law, load_law, save_law
from homogenize.net import NetLaw, diagonal_net, ring_net
from homogenize.protocol import Array, CellInfo, Cut, HalfSpaces, InputError, MembraneLaw, Response
from rve.files import write_text, write_whole

__all__ = [
    "Array",
    "CellInfo",
    "Cut",
    "HalfSpaces",
    "InputError",
    "MembraneLaw",
    "NetLaw",
    "Response",
    "default_law",
    "diagonal_net",
    "load_law",
    "ring_net",
    "save_law",
    "write_text",
    "write_whole",
]
