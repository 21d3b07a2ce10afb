"""What summary.json says of a scene in motion, and modes.json of natural frequencies, as `macro_fem.summary` does of a
curtain at rest."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from macro_fem.summary import Numbers, Record, RingStrength, RingSupport, Summary, SupportForce, Table


@dataclass(frozen=True, kw_only=True, eq=False)
class Running(Summary):
    """How far a run has come that has not ended, or was killed."""

    reached_s: float
    steps: int


@dataclass(frozen=True, kw_only=True)
class BodyEnd(Table):
    """Where a body is at the end, and how fast."""

    body: str
    mass_kg: float
    end_mm: Numbers
    velocity_mm_per_s: Numbers


@dataclass(frozen=True, kw_only=True)
class Travel(Table):
    """How far a run has come, and where the mesh is at its end."""

    duration_s: float
    reached_s: float
    steps: int
    frames: int
    scheme: str
    mean_height_mm: float
    lowest_point_mm: float
    bodies: tuple[BodyEnd, ...]
    notes: Sequence[str]
    relative_gap: float
    wall_s: float
    versions: Mapping[str, str]


@dataclass(frozen=True, kw_only=True)
class Energies(Table):
    """The account at the end; what the scheme has lost over the largest kinetic energy, None where nothing moves; steps
    that lose energy for good as rings lock or something is touched, and the one that loses most."""

    kinetic_N_mm: float
    potential_N_mm: float
    stored_N_mm: float
    work_N_mm: float
    lost_by_scheme_N_mm: float
    lost_by_locking_N_mm: float
    lost_by_damping_N_mm: float
    lost_by_scheme_share: float | None
    account_error: float
    impacts: int
    largest_impact_at_s: float | None


@dataclass(frozen=True, kw_only=True)
class SupportPeaks(Table):
    """The largest force of all supports together, and impulse of a step, of rigid rings; whose forces these are."""

    forces: str
    peak_support_force_N: float
    peak_support_force_at_s: float
    peak_support_impulse_N_s: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionNumbers(SupportPeaks, Energies, Travel, Summary):
    """The numbers of a motion, whatever moves."""


@dataclass(frozen=True, kw_only=True)
class MotionVerdict(Table):
    """Whether the curtain holds at every step, None where that is not known; at its weakest moment the factor, what
    gives first and where, and forces of supports; what the verdict does not know."""

    holds: bool | None
    smallest_factor: float | None
    at_s: float
    weakest: str | None
    weakest_place: str | None
    verdict_note: str | None
    support_forces: tuple[SupportForce, ...] | tuple[RingSupport, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionSummary(MotionVerdict, MotionNumbers):
    """summary.json of a scene in motion."""

    safety_factor: float | None


@dataclass(frozen=True, kw_only=True, eq=False)
class CurtainMotionSummary(RingStrength, MotionSummary):
    """summary.json of a curtain in motion; the strength of rings is that of the weakest moment."""

    support_forces: tuple[SupportForce, ...]
    peak_line_load_N_per_mm: float
    peak_line_load_at_s: float
    peak_utilisation: float | None
    peak_utilisation_at_s: float | None
    cells: int
    element: str
    law: str


@dataclass(frozen=True, kw_only=True, eq=False)
class RingMotionSummary(MotionSummary):
    """summary.json of every ring in motion."""

    support_forces: tuple[RingSupport, ...]
    safety_factor: None = field(default=None, metadata={"when": lambda own: True})
    peak_contact_force_N: float
    peak_contact_force_at_s: float
    ring_count: int
    centres: str
    min_gap_mm: float
    links_intact: bool
    iterations: int


@dataclass(frozen=True, kw_only=True, eq=False)
class ModesSummary(Record):
    """modes.json: what the command prints, too."""

    frequencies_Hz: Numbers
    multiplicity: Sequence[int]
    left_out: str
    loads: str
    time_s: float | None
    forces_by: str
    cells: int
    notes: Sequence[str]
    law: str
    wall_s: float
    versions: Mapping[str, str]
