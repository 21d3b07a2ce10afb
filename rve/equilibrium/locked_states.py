"""Locked states of a table: what the solver found, with the loads and the cell it belongs to."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rve.common import Array, Flags, Rows
from rve.equilibrium.interior_point import Equilibrium
from rve.geometry.cell import Cell
from rve.geometry.contacts import CellContacts, find_contacts
from rve.geometry.pose import Pose


@dataclass(frozen=True)
class LockedStates(Rows):
    """Locked states of n load cases: s (n, 3), Cauchy line loads in weave axes; unique (n,): False where the load
    leaves the strain free; cell: the mesh, whose weave lists the pairs of rings; reach: gap in r1 up to which contacts
    are listed.
    """

    found: Equilibrium
    s: Array
    unique: Flags
    cell: Cell
    reach: float

    @property
    def pose(self) -> Pose:
        """Poses in units of r1."""
        return self.found.pose

    @property
    def lam(self) -> Array:
        """Contact forces (n, p, SLOTS) in units of s r1."""
        return self.found.lam

    @property
    def contacts(self) -> CellContacts:
        """Where the forces act."""
        return self.found.contacts

    def listing(self, cell: Cell) -> LockedStates:
        """The same states for a cell whose weave lists more pairs after those of this one."""
        more = len(cell.weave.pairs) - self.lam.shape[1]
        if not more:
            return self
        lam = np.pad(self.lam, ((0, 0), (0, more), (0, 0)))
        contacts = find_contacts(self.pose, cell.weave, cell.wire, self.reach)
        return replace(self, cell=cell, found=replace(self.found, lam=lam, contacts=contacts))
