"""What summary.json says of a curtain solved ring by ring, as `macro_fem.summary` does of one at rest."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from macro_fem.summary import Numbers, RingSupport, Summary, Table, WeaveOfLaw


@dataclass(frozen=True, kw_only=True)
class RingObstacle(Table):
    """Force of a floor or wall on rings, None where there is none."""

    obstacle: str
    reaction_N: Numbers | None


@dataclass(frozen=True, kw_only=True)
class RingShape(Table):
    """Where rings hang, and how they touch; None for forces where there are none."""

    ring_count: int
    centres: str
    mean_height_mm: float
    lowest_point_mm: float
    depth_mm: float
    potential_N_mm: float
    min_gap_mm: float
    notes: Sequence[str]
    links: int
    links_intact: bool
    kkt_residual: float | None
    way_left_mm: float
    contacts: int | None
    largest_contact_force_N: float | None


@dataclass(frozen=True, kw_only=True)
class RingForces(Table):
    """What rings bear; whether they hold is not known."""

    total_load_N: Numbers
    support_forces: tuple[RingSupport, ...]
    safety_factor: None
    obstacles: tuple[RingObstacle, ...]


@dataclass(frozen=True, kw_only=True)
class RingRun(Table):
    """How the rings were solved."""

    iterations: int
    wall_s: float
    versions: Mapping[str, str]
    start: str


@dataclass(frozen=True, kw_only=True, eq=False)
class EveryRingSummary(RingRun, WeaveOfLaw, RingForces, RingShape, Summary):
    """summary.json of a curtain solved ring by ring."""
