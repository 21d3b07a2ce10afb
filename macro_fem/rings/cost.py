"""What the rings of a scene cost, before they are made: how many there are, the memory and the time that they take.

Measured with rings of r1/r2 = 10 hung by two corners, 1,013 to 14,281 of them (`python -m benchmarks growth`): memory
goes like n log n, as the factors of a plane mesh do. Folds decide the time, which a run may exceed three times.
"""

import os
from contextlib import suppress
from dataclasses import dataclass
from math import inf, log2
from pathlib import Path

import numpy as np
import shapely

from macro_fem.scene.scene import Scene
from macro_fem.scene.shapes import MeshFile
from rve.common import digits
from rve.common.factor import linear_solver
from rve.geometry import CellInfo

GROWTH = {"superlu": (2.2e-5, 35.0, 2.1), "cholmod": (6.5e-6, 30.0, 1.75)}
"""By library for factors: GB over n log2(n) rings, a fifth above the largest measured; processor seconds of 1,000 rings
in space, and the power of n with which they grow."""
UNITS = ((86_400.0, "days"), (3_600.0, "hours"), (60.0, "minutes"), (1.0, "s"))


@dataclass(frozen=True)
class RingCost:
    """How many rings, the memory in GB and the time in s that they take."""

    rings: int
    memory_GB: float
    time_s: float

    def __str__(self) -> str:
        size, unit = next(pair for pair in UNITS if self.time_s >= pair[0] or pair[0] == 1.0)
        need = f"{digits(self.memory_GB, 2)} GB and {digits(self.time_s / size, 2)} {unit}"
        return f"{self.rings:,} rings, some {need}, with many folds up to three times as long"


def ring_cost(scene: Scene, info: CellInfo, *, space: bool = True) -> RingCost:
    """The cost of the rings of a scene, with centres in `space` or in the plane; InputError, before anything is made,
    if they do not fit into the memory of this machine, for a sheet without an outline, and for no known weave."""
    curtain, (_, at_1000, power) = scene.curtain, GROWTH[linear_solver()]
    if isinstance(curtain, MeshFile):
        scene.refuse('[curtain] shape = "file": has no outline of its own, use shape = "outline"')
    sheet = shapely.Polygon(curtain.corners(scene.mesh.cells), [np.array(hole) for hole in curtain.holes])
    count = max(2, round(info.cell().weave.classes * sheet.area / (info.b_x_mm * info.b_y_mm)))
    memory, there = memory_GB(count), machine_GB()
    if memory > there:
        most = max((n for n in np.geomspace(10, count, 200) if memory_GB(n) < there), default=10)
        scene.refuse(
            f"[curtain]: {count:,} rings need some {digits(memory)} GB of memory, where there are {digits(there)} GB; "
            f"make it smaller, of some {digits(most, 2)} rings, or take macro_fem run and then macro_fem localize"
        )
    # Time with centres in the plane over that in space.
    return RingCost(count, memory, at_1000 * (1e-3 * count) ** power * (1.0 if space else 0.2))


def memory_GB(count: float) -> float:
    """The memory in GB that so many rings take."""
    # The first is the program itself.
    return 0.1 + GROWTH[linear_solver()][0] * count * log2(count)


def machine_GB() -> float:
    """The memory in GB that this process may have, of the machine, its container and its shell; infinite if unknown."""
    limits = [inf]
    with suppress(AttributeError, ValueError, OSError):  # not on every system
        limits.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    with suppress(OSError, ValueError):  # "max" where there is no limit
        limits.append(float(Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii")))
    with suppress(ImportError):
        import resource

        soft = resource.getrlimit(resource.RLIMIT_AS)[0]
        limits += [soft] if soft != resource.RLIM_INFINITY else []
    return 1e-9 * min(limits)
