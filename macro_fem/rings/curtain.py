"""What `localize` needs of a solved curtain: the fields of its cells, and the rings that its summary names.

Both come from an answer in memory, or from the files of `macro_fem run`.
"""

from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta

from macro_fem.fem.cells import recovered, signed_areas
from macro_fem.scene.meshing.mesh_files import read_mesh_file
from rve.common import (
    Array,
    Index,
    InputError,
    JsonObject,
    Rows,
    Typed,
    check_belongs,
    read_json_object,
    read_typed,
    types_of,
)
from rve.common.arguments import checked
from rve.common.materials import Material
from rve.common.records import ByValue
from rve.common.texts import read_as
from rve.finite import cell_of_sides
from rve.geometry import CellInfo, read_cell_info

SIDES = ("r1_mm", "r2_mm", "b_x_mm", "b_y_mm")


@dataclass(frozen=True)
class Told(Typed):
    """What the summary of a curtain says: status of its solver, angle from the vertical to the weave's y axis, radii
    and reference cell of its rings, None for a law without rings, their material if it is known, and its supports."""

    hang_deg: Annotated[float, Meta(ge=-360.0, le=360.0)]
    rings: JsonObject | None = None
    material: Material | None = None
    weave: str | None = None
    grain: Literal["y", "x"] = "y"
    reference_cell: Literal["side-by-side", "locked"] = "side-by-side"
    status: str = "unknown"
    support_forces: tuple[JsonObject, ...] = ()

    @property
    def at_support(self) -> dict[str, str | float] | None:
        """The support whose rings take most, and the force in N on one of them; None if the summary does not tell."""
        told: list[dict[str, str | float]] = [
            {"support": f"support {number} ({one.get('support')})", "force_N": float(force)}
            for number, one in enumerate(self.support_forces, 1)
            if isinstance(force := one.get("largest_force_per_ring_N"), int | float)
        ]
        return max(told, key=lambda one: float(one["force_N"]), default=None)

    def info(self, source: str) -> CellInfo:
        """The rings and their reference cell; InputError, which begins with `source`, where the summary does not tell
        them. Summaries before version 0.3 name no weave: it is that of the sides of the reference cell."""
        rings = self.rings or {}
        if missing := [key for key in SIDES if rings.get(key) is None]:
            raise InputError(
                f"{source}: does not tell {', '.join(missing)} of the rings; solve the curtain with a law that was "
                "fitted to a table of rings"
            )
        told = rings | {"weave": self.weave, "grain": self.grain, "reference": self.reference_cell}
        info = replace(read_cell_info(told, f"{source}: rings"), material=self.material)
        if self.weave is not None:
            return info
        try:
            cell = cell_of_sides(info.r1_mm, info.r2_mm, info.sides_mm)
        except InputError as error:
            raise InputError(f"{source}: rings: {error}; run the curtain again") from error
        return replace(info, weave=cell.weave.name, grain=cell.grain)


def read_told(summary: Mapping[str, Any], source: str) -> Told:
    """What a summary tells of its curtain; InputError, which begins with `source`, for what does not fit."""
    return read_typed(Told, {key: summary[key] for key in types_of(Told) if summary.get(key) is not None}, f"{source}:")


@dataclass(frozen=True, eq=False)
class Curtain(ByValue):
    """A solved curtain in its own axes, with what its summary tells; source: where it comes from.

    X (p, 2), x (p, d): corners before and after, mm, d = 2 in the plane and 3 in space; triangles (t, 3) of corner
    numbers; per triangle the strain E (t, 3), the line load S (t, 3) in N/mm averaged over neighbours, the largest
    principal line load (t,) and the state (t,): 0 slack, 1 drawn in one direction, 2 taut.
    """

    X: Array
    x: Array
    triangles: Index
    E: Array
    S: Array
    line_load: Array
    state: Index
    told: Told = Told(0.0, None)
    source: str = "a curtain in memory"

    @cached_property
    def F(self) -> Array:
        """Deformation gradients (t, d, 2) of the triangles."""
        corners = (places[self.triangles] for places in (self.X, self.x))
        dX, dx = ((one[:, 1:] - one[:, :1]).transpose(0, 2, 1) for one in corners)
        return np.asarray(dx @ np.linalg.inv(dX))


@dataclass(frozen=True)
class Sites(Rows):
    """Where rings belong: index (n, 3) = class, i, j; X (n, 2) in mm before; triangle (n,) around them."""

    index: Index
    X: Array
    triangle: Index


def curtain_of(mesh: Any, told: Told, source: str) -> Curtain:
    """The curtain of a mesh of meshio with the fields of curtain.vtu (`macro_fem.output.files.curtain_mesh`).

    Points are the reference state and `displacement_mm` leads to the deformed one; S is averaged over neighbours.
    """
    X, x = mesh.points, mesh.points + mesh.point_data["displacement_mm"]
    triangles = np.asarray(mesh.cells[0].data, dtype=np.intp)
    names = "E_11_12_22", "S_11_12_22_N_per_mm", "line_load_1_N_per_mm", "state_0_slack_1_wrinkled_2_taut"
    E, S, line_load, state = (np.asarray(mesh.cell_data[name][0]) for name in names)
    X, x = X[:, :2], x[:, :2] if np.abs(x[:, 2]).max() <= 1e-9 * np.abs(x).max() else x
    S = recovered(triangles, S, np.abs(signed_areas(X[triangles])))
    return Curtain(X, x, triangles, E, S, line_load, state.astype(int), told, source)


def curtain_file(path: str | Path) -> Path:
    """The VTU that `path` names: itself, or curtain.vtu in the folder `path`."""
    return Path(path) / "curtain.vtu" if Path(path).is_dir() else Path(path)


@checked
def read_curtain(path: str | Path) -> Curtain:
    """The curtain that `macro_fem run` wrote into a folder, or its VTU with summary.json beside it.

    InputError in one sentence for files that are none, or not of the same run.
    """
    vtu = curtain_file(path)
    record = vtu.parent / "summary.json"
    with nullcontext() if Path(path).suffix == ".vtu" else read_as("folder of a curtain", path):
        mesh, known = read_mesh_file(vtu), read_json_object(record)
    check_belongs(vtu, record, known, "run macro_fem again, or put the two files of one run side by side")
    if "E_11_12_22" not in mesh.cell_data:
        raise InputError(f"{vtu}: has no field E_11_12_22; is it the curtain.vtu of macro_fem run?")
    return curtain_of(mesh, read_told(known, str(record)), str(vtu))
