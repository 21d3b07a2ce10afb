"""Strain-load table, one row per load direction, and its file: a CSV with its provenance in a JSON of the same name.

Symmetric tensors are triples (11, 12, 22); S is the second Piola-Kirchhoff line load of a unit Cauchy load
(s1^2 + s2^2 = 1); `unique` is 0 where the load leaves the strain free (E is then the limit from inside the tensile
cone).
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rve.common import (
    Array,
    InputError,
    JsonObject,
    Rows,
    atomic_path,
    check_belongs,
    checksum,
    json_text,
    require,
    shown,
    sidecar_path,
)
from rve.common.arguments import checked
from rve.common.cell_fields import ArealMass, Joint, check_rings
from rve.common.files import TABLE_FORMAT, AnyPath, Inputs, check_out_file
from rve.common.records import ByValue
from rve.common.tensor import IDENTITY, eigenvalues
from rve.common.texts import Columns, check_header, csv_text, read_as, read_columns, read_json_object
from rve.common.typed import NAMES, read_entry, read_typed, types_of
from rve.geometry.cell import CellInfo, read_cell_info
from rve.geometry.kinematics import cauchy_line_load, deformation_gradient, load_directions, second_pk
from rve.locking.interior_point import DirectOptions, LockedStates

if TYPE_CHECKING:
    from pandas import DataFrame

_PARTS = {"E": ["E11", "E12", "E22"], "S": ["S11", "S12", "S22"]}
_PARTS |= {"x2_mm": ["x2_x_mm", "x2_y_mm"], "x3_mm": ["x3_x_mm", "x3_y_mm"]}
_PARTS |= {"compliance": [f"D{i}_{j}_mm_per_N" for i in ("11", "12", "22") for j in ("11", "12", "22")]}
_PARTS |= {"strength": ["first_yield_1_per_mm", "collapse_1_per_mm"], "h_strings": ["h_strings"]}
"""The columns of fields with several numbers a row, of which the last three may be absent. Strength is the yield stress
in N/mm2 that a line load S with S11 + S22 = 1 N/mm asks of the wire."""
COLUMNS = ["alpha_deg", "beta_deg", *_PARTS["E"], *_PARTS["S"], *_PARTS["x2_mm"], *_PARTS["x3_mm"]]
COLUMNS += ["R", "min_gap_mm", "contacts", "unique", "status", "iterations"]
REFERENCE = {"r1_mm", "r2_mm", "b_x_mm", "b_y_mm"}
"""What a sidecar says of the rings and their reference cell at least."""
_LOADS = (_PARTS["S"], ["alpha_deg", "beta_deg"])
"""Two ways to give the load of a row, of which a file needs one."""
_KNOWN = [*COLUMNS, "branch", *_PARTS["compliance"], *_PARTS["strength"], *_PARTS["h_strings"]]
_MOST = {"alpha_deg": 360.0, "beta_deg": 360.0, "contacts": 1e9, "unique": 1.0, "iterations": 1e9}
_MOST |= dict.fromkeys(("E11", "E12", "E22"), 1e3) | dict.fromkeys(("S11", "S12", "S22"), 1e30)


@dataclass(frozen=True)
class RowQuality(Rows):
    """How well each row is solved, (n,) each: weighted residual R, least gap, contacts with force, iterations."""

    R: Array
    min_gap_mm: Array
    contacts: NDArray[np.intp]
    iterations: NDArray[np.intp]


@dataclass(frozen=True)
class Origin:
    """Where a table comes from, as its sidecar file tells: the rings and their reference cell; options of the solver;
    joint of the rings, None without their strength; and notes: method, rows by status, versions, wall time.

    cell is None for a table whose file does not tell the rings, options where they are not those of this version.
    Without rings, as of a mesh that was measured: areal_mass_kg_per_m2, None where it is not known, and is_mirrored,
    whether the mesh is its own mirror image, so that every row stands for two.
    """

    cell: CellInfo | None = None
    options: DirectOptions | None = None
    joint: str | None = None
    notes: Mapping[str, Any] = field(default_factory=dict)
    areal_mass_kg_per_m2: float | None = None
    is_mirrored: bool = True

    def to_dict(self) -> JsonObject:
        """What the sidecar file says, but for the checksum."""
        record: JsonObject = {"format": TABLE_FORMAT, "format_version": 1}
        if self.cell is not None:
            metal = self.cell.material
            record |= asdict(self.cell) | {"density_kg_per_mm3": metal and metal.density_kg_per_mm3}
            record = {key: value for key, value in record.items() if value is not None and key != "reference"}
        elif self.areal_mass_kg_per_m2 is not None:
            record["areal_mass_kg_per_m2"] = self.areal_mass_kg_per_m2
        record |= {} if self.is_mirrored else {"is_mirrored": False}
        record |= {} if self.options is None else {"options": asdict(self.options)}
        record |= {} if self.joint is None else {"compliance": "rings", "joint": self.joint}
        return record | dict(self.notes)


@dataclass(frozen=True, eq=False, repr=False)
class StrainTable(ByValue):
    """A strain-load table of n rows.

    alpha_deg, beta_deg (n,); E, S (n, 3); x2_mm, x3_mm (n, 2); unique (n,) bool; status (n,) str; quality: how well
    each row is solved; compliance (n, 3, 3) dE/dS in mm/N or None; origin: rings, options, and what else the sidecar
    file says; states: the locked states of the direct solver, which are not written to files, None for a table that was
    read. branch (n,) str or None: how the locked state was reached, "slack", "restart",
    or "coexisting" where a second state does the same work under S (`rve.locking.branches`); "below" only in
    rows of that status.
    strength (n, 2) or None: the yield stress over S11 + S22, in 1/mm, at which the row's load is that of first
    yield and of plastic collapse. h_strings (n,) or None: the work S:E of rings drawn to strings, at S11 + S22 = 1.
    """

    alpha_deg: Array
    beta_deg: Array
    E: Array
    S: Array
    x2_mm: Array
    x3_mm: Array
    unique: NDArray[np.bool_]
    status: NDArray[np.str_]
    quality: RowQuality
    compliance: Array | None = None
    origin: Origin = Origin()
    branch: NDArray[np.str_] | None = None
    states: LockedStates | None = field(default=None, repr=False, compare=False)
    strength: Array | None = None
    h_strings: Array | None = None

    def __len__(self) -> int:
        return len(self.alpha_deg)

    @property
    def converged(self) -> NDArray[np.bool_]:
        """Rows to rely on, (n,)."""
        return np.asarray(self.status == "converged")

    @property
    def is_mirrored(self) -> bool:
        """Whether the weave is its own mirror image, so that every row stands for two.

        A weave that is not known here counts as chiral, so that nothing is added to its rows.
        """
        return self.origin.is_mirrored if self.cell is None else self.cell.is_mirrored

    @property
    def cell(self) -> CellInfo | None:
        """The rings and their reference cell, None for a table whose file does not tell them."""
        return self.origin.cell

    @property
    def options(self) -> DirectOptions | None:
        """Of the solver, None where they are not those of this version."""
        return self.origin.options

    def columns(self) -> dict[str, NDArray[Any]]:
        """The columns of the CSV file, by name."""
        known = vars(self) | vars(self.quality) | {"unique": self.unique.astype(int)}
        for part, names in _PARTS.items():
            if known[part] is not None:
                known |= zip(names, known[part].reshape(len(self), -1).T, strict=True)
        order = (*COLUMNS, "branch", *_PARTS["compliance"], *_PARTS["strength"], *_PARTS["h_strings"])
        return {name: known[name] for name in order if known.get(name) is not None}

    @classmethod
    def from_pandas(cls, frame: DataFrame) -> StrainTable:
        """The table in a pandas DataFrame, see `read_table`; its `attrs` say what a sidecar file does.

        InputError for what is no data frame, and for columns that are missing or no numbers, with their row.
        """
        require("pandas", "notebook", "a data frame", "give the path of a CSV file")
        from pandas import DataFrame, isna

        if not isinstance(frame, DataFrame):
            got = NAMES.get(type(frame).__name__, type(frame).__name__)
            what = f"table = {shown(frame)}: expected StrainTable or DataFrame, got {got}"
            raise InputError(f"{what}; read_table reads a file")
        header = [" ".join(str(name).split()) for name in frame.columns]
        check_header("the data frame", header, _PARTS["E"], _KNOWN)
        cells = (frame.iloc[:, number].tolist() for number in range(len(header)))
        texts = (["" if isna(value) else str(value) for value in column] for column in cells)
        places = [f"row {index}" for index in frame.index]
        table = _table_of(Columns("the data frame", dict(zip(header, texts, strict=True)), places))
        told: JsonObject = {str(key): value for key, value in frame.attrs.items()}
        return replace(table, origin=_origin_of(told, "attrs of the data frame:")) if told else table

    @classmethod
    @checked
    def from_rows(cls, E: Array, S: Array) -> StrainTable:
        """The table of strains E (n, 3) and second Piola-Kirchhoff line loads S (n, 3) of any unit, one row each.

        >>> StrainTable.from_rows([[0.1, 0.0, -0.1]], [[2.0, 0.0, 0.0]]).alpha_deg
        array([0.])
        """
        values = [np.asarray(one, float) for one in (E, S)]
        if values[0].ndim != 2 or values[0].shape[1] != 3 or values[0].shape != values[1].shape:
            raise InputError(f"E and S are both (n, 3), components 11, 12, 22; got {[one.shape for one in values]}")
        names, columns = [*_PARTS["E"], *_PARTS["S"]], np.hstack(values).T.tolist()
        texts = {name: [*map(repr, column)] for name, column in zip(names, columns, strict=True)}
        return _table_of(Columns("E, S", texts, [f"row {row}" for row in range(len(values[0]))]))

    def to_pandas(self) -> DataFrame:
        """The table as a pandas DataFrame with the columns of its CSV file; its `attrs` hold what its JSON says.

        InputError if pandas is not installed.
        """
        require("pandas", "notebook", "to_pandas()", "read the CSV file in another way")
        from pandas import DataFrame

        frame = DataFrame(self.columns())
        frame.attrs.update(self.origin.to_dict())
        return frame

    def save(self, path: AnyPath) -> None:
        """Write the CSV and its sidecar JSON, both or none; see `write_table`."""
        write_table(self, path)

    def __str__(self) -> str:
        rings = "" if self.cell is None else f", r1 = {self.cell.r1_mm:g} mm, r2 = {self.cell.r2_mm:g} mm"
        return f"StrainTable: {int(self.converged.sum())} of {len(self)} rows converged{rings}"

    __repr__ = __str__


def check_out_table(path: AnyPath, option: str = "--out", inputs: Inputs = ()) -> None:
    """`check_out_file` for a table and its sidecar."""
    sidecar = sidecar_path(path)
    if sidecar == Path(path):
        raise InputError(f"{option} = {path}: is the name of the table's sidecar file; choose a name such as *.csv")
    inputs = list(inputs)
    check_out_file(path, option, inputs)
    check_out_file(sidecar, option, inputs, is_sidecar=True)


@checked
def write_table(table: StrainTable, path: AnyPath) -> None:
    """Write the CSV and its sidecar JSON, which holds the SHA-256 of the CSV; an unknown number is an empty cell.

    InputError where they cannot be written, or would overwrite something else (`check_out_table`).
    """
    check_out_table(path, "table")
    target, sidecar = Path(path), sidecar_path(path)
    columns = table.columns()
    numbers = [
        np.where(np.isfinite(one), one.astype(object), "") if one.dtype.kind == "f" else one for one in columns.values()
    ]
    with atomic_path(sidecar) as record, atomic_path(target) as rows:  # the sidecar takes its place last
        rows.write_text(csv_text([*columns], zip(*(one.tolist() for one in numbers), strict=True)), encoding="utf-8")
        files = {"files": {target.name: checksum(rows)}}
        record.write_text(json_text(table.origin.to_dict() | files), encoding="utf-8")


def read_table(path: AnyPath) -> StrainTable:
    """Read a table and, where it is there, its sidecar JSON.

    The columns E11, E12, E22 and either S11, S12, S22, of any unit, or alpha_deg, beta_deg are needed; a row counts as
    converged where the column `status` is missing, and must then have finite numbers in them. A strain counts as unique
    where the column `unique` is missing or its cell empty. The sidecar must belong to the CSV: it holds its SHA-256, or
    is of an older version and holds none. Raises InputError naming file, line, column and value.
    """
    with read_as("strain-load table", path):
        columns = read_columns(path, _PARTS["E"], _KNOWN)
    return replace(_table_of(columns), origin=_read_origin(Path(path)))


def _table_of(columns: Columns) -> StrainTable:
    """The table of columns of text; InputError as of `read_table`."""
    texts, count = columns.texts, len(columns.places)
    given = [names for names in _LOADS if set(names) <= texts.keys()]
    if not given:
        missing = ", ".join(name for names in _LOADS for name in names if name not in texts)
        ways = " or ".join(map(", ".join, _LOADS))
        raise InputError(f"{columns.source}: tells no loads: give the columns {ways}; missing are {missing}")
    status = np.array([text.strip() for text in texts["status"]] if "status" in texts else ["converged"] * count)
    good = status == "converged"
    required = {*_PARTS["E"], *(name for names in given for name in names)}

    def column(name: str) -> Array:
        return columns.numbers(name, _MOST.get(name, np.inf), good if name in required else None)

    parts: dict[str, Any] = {
        part: np.stack([column(name) for name in names], axis=1)
        for part, names in _PARTS.items()
        if part in ("x2_mm", "x3_mm") or set(names) <= texts.keys()
    }
    if "h_strings" in parts:
        parts["h_strings"] = parts["h_strings"][:, 0]
        if len(wrong := np.flatnonzero(parts["h_strings"] < 0.0)):
            columns.refuse(int(wrong[0]), "h_strings", "is below 0: no mesh of strings is shorter than its reference")
    if "compliance" in parts:
        parts["compliance"] = parts["compliance"].reshape(-1, 3, 3)
    parts |= {name: column(name) for name in _LOADS[1]}
    E = parts["E"][good]
    is_sheet = eigenvalues(2.0 * E + IDENTITY)[0] > 0.0
    if not is_sheet.all():
        row = int(np.flatnonzero(good)[np.argmin(is_sheet)])
        columns.refuse(row, "E11", "with E12 and E22 it squeezes the sheet to nothing; strains have no unit, and no %")
    if "S" not in parts:
        parts["S"] = np.full((count, 3), np.nan)
        s = cauchy_line_load(*(parts[name][good] for name in _LOADS[1]))
        parts["S"][good] = second_pk(deformation_gradient(E), s)
    elif _LOADS[1] not in given:
        for name, angle in zip(_LOADS[1], load_directions(parts["S"][good], E), strict=True):
            parts[name][good] = angle
    unique = column("unique")
    whole = (np.nan_to_num(column(name)).astype(int) for name in ("contacts", "iterations"))
    return StrainTable(
        unique=np.where(np.isfinite(unique), unique, 1.0) > 0.5,
        status=status,
        quality=RowQuality(column("R"), column("min_gap_mm"), *whole),
        branch=np.array([text.strip() for text in texts["branch"]]) if "branch" in texts else None,
        **parts,
    )


def _read_origin(table: Path) -> Origin:
    """What the sidecar file says, if there is one; InputError for numbers of the rings out of their range, and for a
    sidecar that is not of this table."""
    path = sidecar_path(table)
    if not path.exists():
        return Origin()
    record = read_json_object(path)
    origin = _origin_of(record, f"{path}:")
    remedy = "make the table again, or put the two files of one table side by side; if you have edited the table on "
    if "files" in record:  # those of tables that were edited on purpose list none
        check_belongs(table, path, record, f'{remedy}purpose, remove "files" from {path.name}')
    return origin


def _origin_of(record: Mapping[str, Any], where: str) -> Origin:
    """What a sidecar file says, or attrs of a data frame; InputError for numbers of the rings out of their range."""
    options = _options_of_record(record)
    of_options = record["options"] if isinstance(record.get("options"), dict) else {}
    reference = {key: value for key, value in of_options.items() if key == "reference"}
    is_told = record.keys() >= REFERENCE
    check_rings(record, where)
    cell = read_cell_info(dict(record) | reference, where) if is_told else None
    joint = Joint.of(record["joint"], f"{where} joint").name if "joint" in record else None
    of_mesh = {"areal_mass_kg_per_m2": None, "is_mirrored": True} | dict(record)
    kinds = {"areal_mass_kg_per_m2": ArealMass | None, "is_mirrored": bool}
    mass, is_mirrored = (read_entry(of_mesh, key, kind, where) for key, kind in kinds.items())
    typed = {"format", "format_version", "files", *kinds} | ({"compliance", "joint"} if joint else set())
    typed |= ({"options"} if options else set()) | ({*types_of(CellInfo), "density_kg_per_mm3"} if cell else set())
    rest = {key: value for key, value in record.items() if key not in typed}
    return Origin(cell, options, joint, rest, None if is_told else mass, is_mirrored)


def _options_of_record(record: Mapping[str, Any]) -> DirectOptions | None:
    """The options of a sidecar; None where they are not those of this version."""
    with suppress(InputError):
        return read_typed(DirectOptions, record.get("options"), "options")
    return None
