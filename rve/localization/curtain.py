"""What `localize` needs of a solved curtain: fields of its cells, and the weave that its summary names.

Both come from the files of `macro_fem run`, or from an answer in memory that follows `SolvedCurtain`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rve.common.cells import as_triangles, recovered, triangle_areas
from rve.common.errors import InputError
from rve.common.rings import RING_CHECKS, check_rings
from rve.common.storage.jobs import check_belongs
from rve.common.storage.reading import read_json_object
from rve.common.storage.vtu import DISPLACEMENT, LINE_LOAD_1, OLD_REFERENCE, STATE, STRAIN, STRESS, VtuFile, read_vtu
from rve.common.types import Array
from rve.common.values import checked, finite, shown

CURTAIN_RECORD, CURTAIN_VTU = "summary.json", "curtain.vtu"
"""The file that stands for a curtain's job and lists the others by their checksums, and the one with its fields."""
HANG_DEG = finite(least=-360.0, most=360.0)
MOST_NUMBER = 1e12
"""Of coordinates in mm, strains and line loads in N/mm: their squares must stay numbers."""
_CELL_FIELDS = {
    "E": (STRAIN, 3),
    "S": (STRESS, 3),
    "line_load": (LINE_LOAD_1, 1),
    "state": (STATE, 1),
}


@dataclass(frozen=True)
class Curtain:
    """A solved curtain in its own axes.

    X (p, 2), x (p, d): corners before and after, mm, d = 2 in the plane and 3 in space; triangles (t, 3) of corner
    numbers; cell (t,): cell of each triangle (quadrilaterals are cut in two); per cell the strain E (c, 3), the line
    load S (c, 3) in N/mm averaged over neighbours, the largest principal line load (c,) and the state (c,): 0 slack,
    1 drawn in one direction, 2 taut.
    """

    X: Array
    x: Array
    triangles: NDArray[np.intp]
    cell: NDArray[np.intp]
    E: Array
    S: Array
    line_load: Array
    state: NDArray[np.intp]

    @property
    def x_in_space(self) -> Array:
        """Corners after deformation with three coordinates (p, 3), mm."""
        return self.x if self.x.shape[1] == 3 else np.column_stack([self.x, np.zeros(len(self.x))])

    @classmethod
    def of(
        cls,
        X: Array,
        x: Array,
        cells: NDArray[np.intp],
        *,
        E: Array,
        S: Array,
        line_load: Array,
        state: Array,
        where: str = "curtain",
    ) -> Curtain:
        """The curtain of a mesh of triangles (c, 3) or quadrilaterals (c, 4), corners X (p, 2), x (p, 2 or 3), and cell
        fields.

        S is averaged over neighbouring cells. InputError, which begins with `where`, for cells without area.
        """
        triangles, cell = as_triangles(cells)
        _check_triangles(where, X, triangles, cell)
        area = np.asarray(np.bincount(cell, weights=triangle_areas(X[triangles]), minlength=len(cells)), dtype=float)
        return cls(X, x, triangles, cell, E, recovered(cells, S, area), line_load, state.astype(int))


class SolvedCurtain(Protocol):
    """A solved curtain in memory. What `macro_fem.solve` returns is one.

    `summary` holds the entries of summary.json, of which `status`, `hang_deg` and `rings` are read.
    """

    @property
    def summary(self) -> dict[str, Any]: ...

    def to_curtain(self) -> Curtain:
        """Geometry and fields of the curtain's cells."""
        ...


def curtain_file(path: Path) -> Path:
    """The VTU that `path` names: itself, or curtain.vtu in the folder `path`."""
    return path / CURTAIN_VTU if path.is_dir() else path


def read_curtain(path: Path) -> Curtain:
    """The curtain in a VTU that `macro_fem run` wrote; InputError in one sentence otherwise.

    Points are the reference state and `displacement_mm` leads to the deformed one. Files of older versions have the
    deformed state as points and the reference state as `reference_mm`, by which they are told.
    """
    if not path.is_file():
        raise InputError(f"{path}: {'is a folder, not a VTU' if path.is_dir() else 'there is no such file'}")
    data = read_vtu(path)
    kinds = [*data.cells, *data.other]
    if kinds not in (["triangle"], ["quad"]):
        raise InputError(f"{path}: needs cells of one kind, triangle or quad, it has {kinds}")
    cells = data.cells[kinds[0]]
    fields = {key: _field(path, data.cell_data, *names, len(cells)) for key, names in _CELL_FIELDS.items()}
    return Curtain.of(*_states(path, data), cells, **fields, where=str(path))


def _states(path: Path, data: VtuFile) -> tuple[Array, Array]:
    """Reference (p, 2) and deformed positions of the points, (p, 2) in the plane z = 0 and (p, 3) elsewhere.

    Which is which is told by the fields that the file has.
    """
    points, number = np.asarray(data.points, dtype=float), len(data.points)
    if not np.isfinite(points).all():
        raise InputError(f"{path}: a point is not finite")
    if OLD_REFERENCE in data.point_data:  # an older version: points are deformed
        reference, deformed = _field(path, data.point_data, OLD_REFERENCE, 3, number), points
    else:
        reference, deformed = points, points + _field(path, data.point_data, DISPLACEMENT, 3, number)
    for state in (reference, deformed):
        if np.abs(state).max() > MOST_NUMBER:
            raise InputError(f"{path}: a coordinate is {np.abs(state).max():g} mm, at most {MOST_NUMBER:g} is allowed")
    if not _is_plane(reference):
        raise InputError(f"{path}: its reference state is not plane, z reaches {np.abs(reference[:, 2]).max():g} mm")
    return reference[:, :2], deformed[:, :2] if _is_plane(deformed) else deformed


def _is_plane(points: Array) -> bool:
    return bool(np.abs(points[:, 2]).max(initial=0.0) <= 1e-9 * np.abs(points).max(initial=0.0))


def _field(path: Path, data: dict[str, Any], name: str, width: int, count: int) -> Array:
    """The field as (count, width), or (count,) for width 1."""
    if name not in data:
        raise InputError(f"{path}: has no field {name}; is it the curtain.vtu of macro_fem run?")
    found = np.asarray(data[name], dtype=float)
    if found.size != count * width:
        raise InputError(f"{path}: field {name} has {found.size} numbers, not {count} times {width}")
    if not np.isfinite(found).all():
        raise InputError(f"{path}: field {name} holds a number that is not finite")
    if np.abs(found).max() > MOST_NUMBER:
        raise InputError(f"{path}: field {name} reaches {np.abs(found).max():g}, at most {MOST_NUMBER:g} is allowed")
    return found.reshape((count, width) if width > 1 else count)


def _check_triangles(where: str, X: Array, triangles: NDArray[np.intp], owner: NDArray[np.intp]) -> None:
    if triangles.min() < 0 or triangles.max() >= len(X):
        raise InputError(f"{where}: a cell names point {triangles.max()}, there are {len(X)}")
    area = triangle_areas(X[triangles])
    if not area.min() > 1e-12 * area.max():
        raise InputError(f"{where}: cell {owner[int(np.argmin(area))]} has no area in the reference state")


@dataclass(frozen=True)
class WeaveOfCurtain:
    """Radii in mm, angle from the vertical to the weave's y axis, sides (b_x, b_y) in mm if the summary names them.

    `solved`: status of the curtain's solver, as the summary says; `source`: the summary, for messages.
    """

    r1: float
    r2: float
    hang_deg: float
    sides: tuple[float, float] | None
    solved: str
    source: str


def read_weave(vtu: Path, r1: float | None, r2: float | None, hang_deg: float | None) -> WeaveOfCurtain:
    """What the options say, and where they are None the summary.json beside the VTU; InputError if neither knows, or
    the summary is that of another VTU."""
    path = vtu.parent / CURTAIN_RECORD
    known = read_json_object(path) if path.is_file() else {}
    if known:
        check_belongs(vtu, path, known, "run macro_fem again, or put the two files of one run side by side")
    says = "does not tell" if path.is_file() else "there is no such file to tell"
    return weave_of(known, (r1, r2, hang_deg), str(path), says)


def weave_of(
    known: dict[str, Any],
    asked: tuple[float | None, float | None, float | None],
    source: str,
    says: str = "does not tell",
) -> WeaveOfCurtain:
    """What `asked` (r1, r2, hang_deg) says, and where it holds None the summary `known`.

    InputError, which begins with `source`, if neither knows or a value is impossible.
    """
    rings = known.get("rings") or {}
    if not isinstance(rings, dict):
        raise InputError(f"{source}: rings = {shown(rings)}: is not a table of names and values")
    tables = (("--r1", "r1_mm", rings), ("--r2", "r2_mm", rings), ("--hang", "hang_deg", known))
    rows = list(zip(tables, asked, strict=True))
    missing = [(option, key) for (option, key, table), given in rows if given is None and table.get(key) is None]
    if missing:
        options, keys = (", ".join(names) for names in zip(*missing, strict=True))
        raise InputError(f"{source}: {says} {keys}; give {options}")
    values = {}
    for (option, key, table), given in rows:
        check = HANG_DEG if key == "hang_deg" else RING_CHECKS[key]
        values[key] = (
            checked(table, key, check, f"{source}:") if given is None else checked({option: given}, option, check, "")
        )
    is_own = asked[:2] == (None, None) and {"b_x_mm", "b_y_mm"} <= rings.keys()
    own = check_rings(rings, f"{source}: rings") if is_own else {}
    sides = (own["b_x_mm"], own["b_y_mm"]) if is_own else None
    solved = str(known.get("status", "unknown"))
    return WeaveOfCurtain(values["r1_mm"], values["r2_mm"], values["hang_deg"], sides, solved, source)
