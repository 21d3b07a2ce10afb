"""What summary.json says of an answer: one record for each of its tables, with attributes named as the keys.

Lengths are in mm, forces in N, line loads in N per mm of reference length, heights along y. What each of them
means is in docs/reference/files.md.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import Field, asdict, dataclass, field, fields, is_dataclass
from functools import cached_property
from typing import Any

from rve.common.materials import Material
from rve.common.typed import did_you_mean

Numbers = Sequence[float]
Own = dict[str, Any]


def _plain(value: Any) -> Any:
    if isinstance(value, Table):
        return value.to_dict()
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value


class Table:
    """Base of the records. A field with a default is written where it has another value, or where "when" in its
    metadata says so of the values of its record."""

    def parts(self) -> Own:
        """Its attributes by their names, of which a larger record is made."""
        return {one.name: vars(self)[one.name] for one in fields(self)}  # type: ignore[arg-type]

    def to_dict(self) -> Own:
        """The table as a file has it: lists, numbers, texts and dicts."""

        def is_written(one: Field[Any]) -> bool:
            return one.metadata["when"](own) if "when" in one.metadata else own[one.name] is not one.default

        own = vars(self)
        return {one.name: _plain(own[one.name]) for one in fields(self) if is_written(one)}  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False, kw_only=True)
class Record(Table, Mapping[str, Any]):
    """The whole of a file such as summary.json; `summary["key"]` gives what the file has."""

    @cached_property
    def _written(self) -> Own:
        return self.to_dict()

    def __getitem__(self, key: str) -> Any:
        try:
            return self._written[key]
        except KeyError:
            is_field = key in [one.name for one in fields(self)]
            hint = "is left out here" if is_field else f"is no entry; {did_you_mean(key, self._written)}".rstrip("; ")
            raise KeyError(f"{key} {hint}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._written)

    def __len__(self) -> int:
        return len(self._written)


@dataclass(frozen=True, eq=False, kw_only=True)
class Summary(Record):
    """A record of an answer, with how it ended."""

    status: str
    message: str


@dataclass(frozen=True, kw_only=True)
class HeldPoint(Table):
    """A held node or ring, the force on it (None: not known), and where it is before and after."""

    point: str | None = None
    at_mm: Numbers
    force_N: Numbers | None
    place_mm: Numbers

    @property
    def size_N(self) -> float:
        """Size of the force, 0 where it is not known."""
        return math.hypot(*(self.force_N or ()))


@dataclass(frozen=True, kw_only=True)
class RingSupport(Table):
    """Forces of a support on rings, None where there are none."""

    support: str
    force_N: Numbers | None
    largest_nodal_force_N: float | None
    points: tuple[HeldPoint, ...]


@dataclass(frozen=True, kw_only=True)
class SupportForce(Table):
    """Forces of a support on the curtain, in sum and at each of its nodes, and what it holds; capacity and pitch of
    those that have one."""

    support: str
    force_N: Numbers
    largest_nodal_force_N: float
    largest_force_per_ring_N: float | None = None
    capacity_N: float | None = field(
        default=None, metadata={"when": lambda own: own["capacity_N"] or own["support"] in ("hooks", "track")}
    )
    pitch_mm: float | None = None
    pitch_asked_mm: float | None = field(default=None, metadata={"when": lambda own: own["pitch_mm"] is not None})
    nodes_held: int
    length_held_mm: float
    points: tuple[HeldPoint, ...]


@dataclass(frozen=True, kw_only=True)
class LineLoads(Table):
    """The largest line loads; averages are None for a law that has no cell."""

    max_principal_line_load_N_per_mm: float
    max_principal_line_load_at_mm: Numbers
    max_line_load_over_a_cell_N_per_mm: float | None
    max_line_load_over_a_cell_at_mm: Numbers | None
    line_load_averaged_over_mm2: float | None


@dataclass(frozen=True, kw_only=True)
class Utilisation(Table):
    """What the loads ask of the rings, None where their strength is not known."""

    utilisation_max: float | None
    utilisation_max_at_mm: Numbers | None
    utilisation_pointwise_max: float | None
    utilisation_of_averages_max: float | None
    utilisation_of_point_forces_max: float | None
    utilisation_of_hook_rings_max: float | None
    ring_at_hook: str | None
    utilisation_too_low: str | None
    safety_factor: float | None
    collapse_factor: float | None
    first_yield_near: str | None
    first_yield_distance_mm: float | None


@dataclass(frozen=True, kw_only=True)
class RingStrength(Utilisation):
    """`Utilisation`, the metal and joint of the rings that it is of, and what it means or why it is not known."""

    ring_material: str | None
    ring_yield_N_per_mm2: float | None
    material: Material | None
    ring_joint: str | None
    strength_note: str


@dataclass(frozen=True, kw_only=True)
class Limit(Table):
    """The limit of a curtain whose rings flow: factors on all loads, and where they flow under the loads as they
    are."""

    limit_factor: float | None = None
    limit_interval: Numbers | None = None
    limit_of_points: float | None = None
    limit_note: str | None = None
    plastic_area_share: float | None = None
    largest_plastic_strain: float | None = None
    largest_plastic_strain_at_mm: Numbers | None = None
    plastic_work_N_mm: float | None = None
    strings_stress_N_per_mm2: float | None = None
    rupture_stress_N_per_mm2: Numbers | None = None
    rupture_factor: Numbers | None = None
    way_at_rupture_mm: Numbers | None = None
    energy_until_rupture_N_mm: Numbers | None = None

    @property
    def limit_of_mesh(self) -> float | None:
        """The lower end of the interval, or the factor of the mesh where that is 0 as cells at points are too large."""
        return (self.limit_interval[0] or self.limit_factor) if self.limit_interval else None


@dataclass(frozen=True, kw_only=True)
class RingSizes(Table):
    """Rings of a law, sides of their reference cell, and the rings of a weave that is not in the catalogue."""

    r1_mm: float
    r2_mm: float
    b_x_mm: float
    b_y_mm: float
    drawing: Mapping[str, Any] | None = None


@dataclass(frozen=True, kw_only=True)
class WeaveOfLaw(Table):
    """Rings, weave and reference cell of a law, None for one without rings; the angle at which they hang."""

    hang_deg: float
    rings: RingSizes | None
    weave: str | None
    grain: str | None
    reference_cell: str | None


@dataclass(frozen=True, kw_only=True)
class WindDrag(Table):
    """A wind with a speed: of one flat layer, and of the present shape."""

    speed_m_per_s: float
    solidity: float
    drag_coefficient: float
    pressure_N_per_m2: float
    front_area_m2: float
    layers: float
    drag_N: float


@dataclass(frozen=True, kw_only=True)
class HungShape(Table):
    """Where the curtain hangs."""

    notes: Sequence[str]
    mean_height_mm: float
    lowest_point_mm: float
    lowest_point_at_mm: Numbers | None = None
    out_of_plane_mm: float | None = None
    mean_sag_mm: float | None = None
    largest_sag_mm: float | None = None
    centre_of_gravity_mm: Numbers | None = None
    lean_mm: float
    max_displacement_mm: float


@dataclass(frozen=True, kw_only=True)
class Bearing(Table):
    """What gives first, and what supports bear."""

    weakest: str | None
    weakest_factor: float | None
    weakest_place: str | None
    total_load_N: Numbers
    support_forces: tuple[SupportForce, ...]
    forces_by: str
    support_forces_note: str | None
    single_forces_note: str | None


@dataclass(frozen=True, kw_only=True)
class Solved(Table):
    """How well the curtain is solved, and by what."""

    potential_primal_N_mm: float
    potential_dual_N_mm: float
    relative_gap: float
    residual: float
    stretch_beyond_locking: float
    iterations: int
    cells: int
    dofs: int
    element: str
    pattern: str
    linear_solver: str
    law: str


@dataclass(frozen=True, kw_only=True)
class HungSheet(Table):
    """The mesh that hangs, and how much of it is taut."""

    wind: tuple[WindDrag, ...] | None = None
    areal_mass_kg_per_m2: float
    mass_kg: float
    taut_area_fraction: float
    wrinkled_area_fraction: float
    slack_area_fraction: float
    wall_s: float
    versions: Mapping[str, str]


@dataclass(frozen=True, kw_only=True)
class BoundsOfPotential(Table):
    """Bounds of the potential on a mesh, and of the mean height where weight is the only load."""

    status: str
    cells: int
    upper_N_mm: float
    lower_N_mm: float
    gap_N_mm: float
    gap_over_load_times_height: float
    part_of_gap_due_to_points_N_mm: float
    wall_s: float
    mean_height_mm: Numbers | None = None


@dataclass(frozen=True, kw_only=True)
class Bounds(Table):
    """Bounds on the last mesh and on all; the interval of the mean height, or of the potential, and its parts, of which
    that of the law is None for one without rows; that of the least plastic work in which loads do as much as here."""

    bounds: BoundsOfPotential | None = None
    levels: tuple[BoundsOfPotential, ...] | None = None
    mean_height_interval_mm: Numbers | None = None
    law_part_mm: float | None = field(default=None, metadata={"when": lambda own: own["mesh_part_mm"] is not None})
    mesh_part_mm: float | None = None
    potential_interval_N_mm: Numbers | None = None
    plastic_work_interval_N_mm: Numbers | None = None
    law_part_N_mm: float | None = field(default=None, metadata={"when": lambda own: own["mesh_part_N_mm"] is not None})
    mesh_part_N_mm: float | None = None


@dataclass(frozen=True)
class Turn(Table):
    """A turn: triangles, rows, load directions solved and read so far, bounds and their law's part, seconds so far."""

    cells: int
    rows: int
    ring_solves: int
    cache_hits: int
    upper_N_mm: float
    lower_N_mm: float
    law_part_N_mm: float
    wall_s: float


@dataclass(frozen=True, kw_only=True)
class Asked(Table):
    """How the rings were asked on demand."""

    accuracy: float | None = None
    ring_solves: int | None = None
    cache_hits: int | None = None
    ring_failures: int | None = None
    rows: int | None = None
    largest_contradiction_of_rows: float | None = None
    turns: tuple[Turn, ...] | None = None


@dataclass(frozen=True, kw_only=True)
class ObstacleStep(Table):
    """Force and way of an obstacle at a load step."""

    displacement_mm: float
    reaction_N: Numbers


@dataclass(frozen=True, kw_only=True)
class ObstacleForce(Table):
    """An obstacle at full load, and over the load steps."""

    obstacle: str
    kind: str
    nodes_touched: int
    displacement_mm: float
    reaction_N: Numbers
    steps: tuple[ObstacleStep, ...]


@dataclass(frozen=True, kw_only=True)
class Rounds(Table):
    """How far the rounds of a shape with bodies or wind have come."""

    rounds: int
    misfit: float
    complementarity: float
    asked: float
    smoothing: float
    penetration_between_nodes_mm: float


@dataclass(frozen=True, kw_only=True)
class CombinationRow(Table):
    """The answer under a load combination."""

    name: str
    factors: Mapping[str, float]
    largest_force_N: float
    status: str
    message: str
    safety_factor: float | None
    weakest: str | None
    weakest_factor: float | None
    weakest_place: str | None
    utilisation_too_low: str | None
    limit_factor: float | None = None


@dataclass(frozen=True, kw_only=True)
class LargestForce(Table):
    """The largest force of a held point, or of the sum over a support, under any load combination."""

    support_number: int
    support: str
    x_mm: float | None = None
    y_mm: float | None = None
    force_N: float
    combination: str
    point: str | None = None


@dataclass(frozen=True, kw_only=True)
class Envelope(Table):
    """The load combination that governs, and the largest forces under any."""

    governing: str
    safety_factor: float | None
    weakest: str | None
    weakest_factor: float | None
    weakest_place: str | None
    utilisation_too_low: str | None
    support_forces: tuple[LargestForce, ...]
    support_sums: tuple[LargestForce, ...]
    limit_factor: float | None = None


@dataclass(frozen=True, kw_only=True)
class Decision(Table):
    """What to decide by; None where it is not known, and for the combination without any."""

    holds: bool | None
    governing_factor: float | None
    governing_note: str | None
    governing_combination: str | None
    governing_link: str | None
    governing_place: str | None
    governing_force_N: float


@dataclass(frozen=True, kw_only=True)
class Order(Table):
    """The order sheet: width and height of the mesh pulled along its grain; None without rings, hooks or a track."""

    mesh_width_mm: float
    mesh_height_mm: float
    area_m2: float
    holes: int
    cells: int | None
    rings: int | None
    weave: str | None
    r1_mm: float | None
    r2_mm: float | None
    outer_diameter_mm: float | None
    inner_diameter_mm: float | None
    wire_mm: float | None
    mass_kg: float
    hooks: int
    hook_pitch_mm: float | None
    track_mm: float | None
    bars: int
    bars_mm: float
    bars_kg: float
    material: str | None
    held_width_mm: float
    lowest_point_mm: float


@dataclass(frozen=True, kw_only=True)
class Feature(Table):
    """What of the solver was used, and why."""

    feature: str
    used: bool
    why: str


@dataclass(frozen=True, kw_only=True)
class LoadStep(Table):
    """The curtain at a load step."""

    step: int
    factor: float
    status: str
    mean_height_mm: float
    lowest_point_mm: float
    potential_primal_N_mm: float
    way_mm: float | None = None
    plastic_work_N_mm: float | None = None
    strings_stress_N_per_mm2: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class CurtainNumbers(HungSheet, WeaveOfLaw, Solved, Bearing, Limit, RingStrength, LineLoads, HungShape, Summary):
    """The numbers of a curtain, whatever it was solved for."""


@dataclass(frozen=True, kw_only=True)
class Acting(Table):
    """Obstacles, rounds and load combinations, of a curtain that has them."""

    obstacles: tuple[ObstacleForce, ...] | None = None
    settling: Rounds | None = None
    combinations: tuple[CombinationRow, ...] | None = None
    envelope: Envelope | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class CurtainSummary(Decision, Acting, Asked, Bounds, CurtainNumbers):
    """summary.json of a curtain at rest."""

    order: Order
    features: tuple[Feature, ...]
    steps: tuple[LoadStep, ...] | None = None
