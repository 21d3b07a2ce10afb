"""What a finite mesh is asked for: options, obstacles, forces, supports; the equations without units; an iterate."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import coo_matrix, csr_matrix, identity
from scipy.sparse.csgraph import connected_components

from rve.common import Array, Flags, Index, InputError, Typed
from rve.finite.contacts import (
    NO_POINTS,
    SOFT,
    FixedPoints,
    MeshContacts,
    MeshPose,
    SoftMinima,
    find_mesh_contacts,
    find_rows,
    transfer_forces,
)
from rve.finite.layout import RingLayout
from rve.geometry.ring_pair import cross, dot, tangent_frame

BLOCK = 5
"""Unknowns of a ring: its centre (3) and two tilts about the axes of its tangent frame."""


Share = Annotated[float, Meta(gt=0.0, le=1.0)]


@dataclass(frozen=True)
class FiniteOptions(Typed):
    """Options of `FiniteMesh.solve`; lengths in units of r1, forces in units of the mean force on a link.

    tolerance: of the Karush-Kuhn-Tucker residual. patience: iterations in which the decrement of Newton's method did
    not fall by 30 % after which mu, the product of force and gap, is lifted, at most `retries` times before `stalled`.
    first, last: mu at the start and at the end.
    reach: gap beyond which a contact has no force.
    disturbance, seed, starts: size and seed of the random numbers added to z at the start in space, so that folds may
    form, and how many seeds, one after the other, are tried where a path of `max_iterations` does not converge.
    """

    tolerance: Share = 1e-8
    patience: Annotated[int, Meta(ge=1, le=1_000_000)] = 8
    retries: Annotated[int, Meta(ge=0, le=1_000_000)] = 20
    reach: Share = 0.6
    max_iterations: Annotated[int, Meta(ge=1, le=1_000_000)] = 1000
    disturbance: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.01
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 0
    starts: Annotated[int, Meta(ge=1, le=1000)] = 2
    first: Share = 0.1
    last: Share = 1e-9

    def check(self) -> None:
        if self.last > self.first:
            self.refuse(f"last = {self.last:g}: is more than first = {self.first:g}")


@dataclass(frozen=True)
class StepMethod:
    """Numbers of a Newton step; lengths in r1.

    travel: longest way of a support in an iteration. regularisation: stiffness of every coordinate, which keeps loose
    rings in place. turn: most that a joining ring turns, rad, where turns are limited; a quarter of what closed a gap,
    if that was more than `turned`. turns: how often pairs and contacts that limit a step are stiffened before it is
    taken; another factor counts as two. short: a smaller fraction of a step is short. rank: of the largest update of a
    factor. closing: contacts that close before these fractions of a step are stiffened, the smaller one if they are
    many. closed: fraction of its gap that a stiffened contact may close. many: fraction of pairs without negative
    curvature above which all lose it. attempts: how often single pairs are damped before a step is shortened.
    corrections: trials of a step, as it is and corrected. farthest: fraction of a gap that the linear forecast of a
    step may close. least: fraction of the gap of a pair that a step must leave.
    """

    travel: float = 3.0
    regularisation: float = 1e-10
    turn: float = 0.3
    turned: float = 1e-4
    turns: int = 6
    short: float = 0.3
    rank: int = 64
    closing: tuple[float, ...] = (1.0, 0.5)
    closed: float = 0.8
    many: float = 0.5
    attempts: int = 3
    corrections: int = 3
    farthest: float = 0.995
    least: float = 0.002


@dataclass(frozen=True)
class PathMethod:
    """Numbers of the path of mu, the product of force and gap.

    shrink, power: the next mu of a ring is the lesser of shrink mu and mu^power, once its Newton decrement is below
    `centred` mu, with wide contacts `centred_wide` mu: joining rings turn while gaps are large. smoothing: passes over
    neighbours in which decrements are averaged. lift: factor on mu of stagnant rings, and of those within `links`
    links. reaches: (mu, reach) of contacts from this mu on; farther ones have next to no force. parts: of the way of
    supports, tried in this order; larger ones close gaps for good in some sheets that are drawn far together. window:
    iterations in which supports must come 1 % nearer, and a step must be longer than 1e-6. idle: iterations without
    progress at the last mu after which unbalanced pairs get fixed points. slide_mu, slide_damping, slides: over a floor
    mu does not fall below the first while pairs are damped by the second and lifts are fewer than the third, since
    sliding rings gain little for the damping.
    """

    shrink: float = 0.3
    power: float = 1.15
    centred: float = 0.5
    centred_wide: float = 0.05
    smoothing: int = 4
    lift: float = 30.0
    links: int = 6
    reaches: tuple[tuple[float, float], ...] = ((1e-2, np.inf), (1e-4, 0.3), (0.0, 0.15))
    parts: tuple[int, ...] = (1, 8, 40)
    window: int = 25
    idle: int = 5
    slide_mu: float = 1e-5
    slide_damping: float = 0.1
    slides: int = 4


@dataclass(frozen=True)
class SolverMethod:
    """Numbers of the solver that no user sets.

    ring_mu: mu below which each ring has its own, and single contacts and rings are treated one by one. guide_mu,
    guide_stiffness: above this mu springs pull rings to the guide, with this stiffness over mu. gap_share: largest
    disturbance of the start over its least gap. clearance: distance in r1 of the start from half-spaces that cut it.
    """

    ring_mu: float = 1e-4
    guide_mu: float = 1e-3
    guide_stiffness: float = 0.1
    gap_share: float = 0.25
    clearance: float = 0.3
    path: PathMethod = PathMethod()
    step: StepMethod = StepMethod()
    soft: SoftMinima = SOFT


METHOD = SolverMethod()


Row = tuple[Array, Array, float]
"""Point (3,) in mm, unit normal (3,) and radius in mm of a row of `MeshPose`."""


@dataclass(frozen=True)
class HalfSpace:
    """A half-space that contains the rings: normal . x >= offset in mm, the normal of any length but 0, the offset
    along its unit vector.

    >>> HalfSpace((0.0, 2.0, 0.0), -50.0).unit
    array([0., 1., 0.])
    """

    normal: tuple[float, float, float]
    offset: float
    name: str = "wall"
    load: ClassVar[tuple[float, float, float]] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """InputError for a normal that is not a direction, or numbers that are not finite."""
        m = np.asarray(self.normal, dtype=float)
        if m.shape != (3,) or not np.isfinite([*m, self.offset]).all() or not np.linalg.norm(m) > 0.0:
            raise InputError(f"{self.name}: normal {self.normal} and offset {self.offset} are not a half-space")

    @property
    def unit(self) -> Array:
        """Unit normal (3,), towards the rings."""
        m = np.asarray(self.normal, dtype=float)
        return np.asarray(m / np.linalg.norm(m))

    def row(self, wire: float) -> Row:
        """A point of the plane, `wire` mm off it."""
        return (self.offset + wire) * self.unit, self.unit, np.inf


@dataclass(frozen=True)
class RoundBody:
    """A ball of `radius` mm whose centre is at `place`, mm; time steps move it, under the force `load` in N."""

    place: tuple[float, float, float]
    radius: float
    load: tuple[float, float, float] = (0.0, 0.0, 0.0)
    name: str = "ball"

    def row(self, wire: float) -> Row:
        """The centre, and the radius of the ball and the wire."""
        return np.array(self.place), np.array([0.0, 0.0, 1.0]), self.radius + wire

    def moved(self, place: Array) -> RoundBody:
        """The ball at another place (3,)."""
        return replace(self, place=(float(place[0]), float(place[1]), float(place[2])))


Obstacle = HalfSpace | RoundBody


@dataclass(frozen=True, eq=False)
class RingInertia:
    """The term |x - x_hat|^2_M / (2 (beta h)^2) of a time step, see `step`: weight (n,) of the centres over
    (beta h)^2 and their places x_hat (n, 3) without forces, rotary weight (n,) of the normals and these without forces.
    """

    weight: Array
    place: Array
    rotary: Array
    normal: Array

    def springs(self, pose: MeshPose) -> tuple[float, Array, Array]:
        """Energy, generalised forces (n, 2) and stiffness (n, 2) of the tilts."""
        energy = 0.5 * float((self.rotary * ((pose.normal - self.normal) ** 2).sum(axis=1)).sum())
        torque = self.rotary[:, None] * cross(pose.normal, self.normal)
        stiffness = (self.rotary * dot(pose.normal, self.normal))[:, None]
        return energy, np.stack([dot(torque, e) for e in tangent_frame(pose.normal)], axis=1), stiffness


@dataclass(frozen=True, eq=False)
class ScaledProblem:
    """A problem in units of r1 and of the mean force on a link.

    linked (m, 2): pairs that interlink; wire = r2/r1; force (n, 3): dead forces; held (n, 3): which coordinates are
    held, at (n, 3): their places; motions (5 n, u): the coordinates by the free motions, rings on straight bars moving
    with the ends of their bar; guard_points, fixed_points: as of `find_mesh_contacts`, but no guard points where soft
    pairs have `wide` contacts; guide (n, 3): places that pull at the centres while mu is large, nan for none; load: sum
    of the loads, the scale of residuals; unit: of forces, N.
    """

    linked: Index
    wire: float
    force: Array
    held: NDArray[np.bool_]
    at: Array
    motions: sparse.csr_matrix
    guard_points: bool = True
    wide: bool = False
    fixed_points: FixedPoints = NO_POINTS
    guide: Array = field(default_factory=lambda: np.array(np.nan))
    load: float = 1.0
    inertia: RingInertia | None = None
    unit: float = 1.0
    method: SolverMethod = METHOD

    @property
    def keys(self) -> Index:
        """Keys of the linked pairs."""
        return np.asarray(self.linked[:, 0] * len(self.force) + self.linked[:, 1])

    def find(self, pose: MeshPose, reach: float, old: MeshContacts | None = None) -> MeshContacts:
        """The contacts of a pose after those of `old`."""
        wide = (self.keys[:0] if old is None else old.wide_keys) if self.wide else None
        guard, points, soft = self.guard_points and not self.wide, self.fixed_points, self.method.soft
        return find_mesh_contacts(
            pose, self.linked, self.wire, reach, guard_points=guard, fixed_points=points, soft=soft, wide=wide
        )

    def way_left(self, pose: MeshPose) -> Array:
        """Distance (n, 3) of held coordinates from their places, 0 for others."""
        return np.where(self.held, self.at - pose.x, 0.0)

    def springs(self, pose: MeshPose, mu: float) -> tuple[float, Array, Array]:
        """Energy, generalised forces (n, 5) and stiffness (n, 5) of inertia and, at a large mu, of the guide."""
        energy, pull, stiff = 0.0, np.zeros((len(pose.x), BLOCK)), np.zeros((len(pose.x), BLOCK))
        ends = []
        if mu >= self.method.guide_mu:
            guided = np.isfinite(self.guide)
            ends.append((np.where(guided, self.method.guide_stiffness * mu, 0.0), np.where(guided, self.guide, 0.0)))
        if self.inertia is not None:
            ends.append((self.inertia.weight[:, None], self.inertia.place))
            energy, pull[:, 3:], stiff[:, 3:] = self.inertia.springs(pose)
        for weight, end in ends:
            delta = end - pose.x
            energy += 0.5 * float((weight * delta**2).sum())
            pull[:, :3] += weight * delta
            stiff[:, :3] += weight
        return energy, pull, stiff

    def barrier(self, con: MeshContacts, mu: Array) -> float:
        """The merit function -f.x + sum mu `MeshContacts.barrier` + energy of springs and inertia, mu (n,) of rings."""
        energy = self.springs(con.pose, float(mu.max()))[0] - (self.force * con.pose.x).sum()
        return float(energy + (con.pair_max(mu)[con.minima.pair] * con.barrier(con.gap)).sum())


@dataclass(frozen=True, eq=False)
class Iterate:
    """An iterate of the path.

    force (m,): of contacts; mu (n,): of rings, a contact has the greater one of its rings; damping: of all pairs, local
    (p,): additional damping of single pairs; convex (p,): fraction of the negative curvature of a pair that is left
    out; extra (m,): additional stiffness of contacts; gain (n,): Newton decrement of the step to it by rings, negative
    where no step led to it; swing, turn (n,): stiffness of the tilts of single rings in this step, and how far they may
    turn, rad.
    """

    contacts: MeshContacts
    force: Array
    mu: Array
    damping: float
    local: Array
    convex: Array
    extra: Array
    gain: Array
    swing: Array
    turn: Array

    @property
    def contact_mu(self) -> Array:
        """mu (m,) of the contacts."""
        return np.asarray(self.contacts.pair_max(self.mu)[self.contacts.minima.pair])

    def at(self, contacts: MeshContacts) -> Iterate:
        """The iterate with other contacts, to which forces are transferred."""
        row = find_rows(self.contacts.key, contacts.key)
        local, convex = (np.where(row >= 0, of[row], 0.0) for of in (self.local, self.convex))
        new = replace(self, contacts=contacts, local=local, convex=convex, extra=np.zeros(len(contacts.gap)))
        return replace(new, force=transfer_forces(self.contacts, self.force, contacts, new.contact_mu))


@dataclass(frozen=True, eq=False)
class Problem:
    """Rings with loads and supports, see `FiniteMesh.solve`; force, held, at, guide (n, 3) in N and mm.

    Unless `is_space` the third coordinate of all rings is held.
    """

    mesh: RingLayout
    force: Array
    held: Flags
    at: Array
    is_space: bool
    walls: tuple[Obstacle, ...] = ()
    guide: Array | float = np.nan

    def check(self) -> None:
        """InputError for arrays of other shapes, no load, or a piece that nothing holds against its load."""
        mesh, force, n = self.mesh, self.force, len(self.mesh.X)
        for name, array in (("force", force), ("held", self.held), ("at", self.at), ("guide", self.guide)):
            if np.shape(array) != (n, 3):
                raise InputError(f"{name}: has shape {np.shape(array)}, it must be ({n}, 3), one row per ring")
        if not np.isfinite([*force.ravel(), *self.at[self.held]]).all() or np.isinf(self.guide).any():
            raise InputError("force, places and guide must be finite numbers; nan in a guide is none")
        if not (self.is_space or mesh.cell.weave.is_flat):
            raise InputError(f"the centres of {mesh.cell.weave.name} lie in no plane: its rings are solved in space")
        if not np.abs(force).sum() > 0.0:
            raise InputError("the mesh carries no load, so that it has no shape; give it weight or a pull")
        on_bars = np.concatenate([*mesh.bars, np.zeros(0, dtype=np.intp)])
        if self.held[on_bars].any() or len(np.unique(on_bars)) < len(on_bars):
            raise InputError("a ring of a straight bar is held or has a second bar; leave one of them out")
        for bar in mesh.bars:
            X = mesh.X[bar]
            across = X - X[0] - along(X)[:, None] * (X[-1] - X[0])
            if len(bar) < 2 or np.abs(across).max() > 1e-4 * mesh.cell.r1:
                raise InputError("the rings of a bar lie on no line; let the outline be whole cells of the weave")
        graph = coo_matrix((np.ones(len(mesh.linked)), mesh.linked.T), shape=(n, n))
        count, label = connected_components(graph, directed=False)
        for piece in range(count):
            rings = np.flatnonzero(label == piece)
            for axis in range(3):
                push = float(force[rings, axis].sum())
                is_held = self.held[rings, axis].any() or (axis == 2 and not self.is_space)
                is_held |= any(isinstance(w, HalfSpace) and w.unit[axis] * push < 0.0 for w in self.walls)
                if abs(push) > 1e-9 * np.abs(force).sum() and not is_held:
                    x, y = mesh.X[rings].mean(axis=0)
                    raise InputError(
                        f"nothing carries the force of {push:.6g} N along {'xyz'[axis]} on the piece around "
                        f"({x:g}, {y:g}) mm, it would move for ever; hold one of its rings"
                    )

    def _motions(self, free: Flags) -> csr_matrix:
        """The motions of `ScaledProblem` for free coordinates (n, 5); on a bar, x = (1 - s) x_first + s x_last."""
        T, is_motion = identity(free.size, format="lil"), free.copy()
        for bar in self.mesh.bars:
            is_motion[bar[1:-1], :3] = False
            for ring, share in zip(bar[1:-1], along(self.mesh.X[bar])[1:-1], strict=True):
                for axis in range(3):
                    row, first, last = BLOCK * np.array([ring, bar[0], bar[-1]]) + axis
                    T[row, row], T[row, first], T[row, last] = 0.0, 1.0 - share, share
        return csr_matrix(T)[:, np.flatnonzero(is_motion)]

    def start(self, options: FiniteOptions) -> MeshPose:
        """The slack weave, translated towards the held places; in space with a disturbance in z.

        Half-spaces that cut it start farther back.
        """
        mesh, r1 = self.mesh, self.mesh.cell.r1
        centre, normal = mesh.slack()
        for axis in range(3 if self.is_space else 2):
            rows = self.held[:, axis]
            if rows.any():
                centre[:, axis] += (self.at[rows, axis] - centre[rows, axis]).mean()
        x = centre / r1
        if self.is_space:
            reach = options.disturbance / METHOD.gap_share
            near = find_mesh_contacts(replace(self, walls=()).pose(r1 * x, normal), mesh.linked, mesh.cell.wire, reach)
            size = min(options.disturbance, METHOD.gap_share * float(near.deepest.min(initial=np.inf)))
            shift = size * np.random.default_rng(options.seed).uniform(-1.0, 1.0, len(x))
            x[:, 2] += np.where(self.held[:, 2], 0.0, shift)
        for bar in self.mesh.bars:
            x[bar] = x[bar[0]] + along(mesh.X[bar])[:, None] * (x[bar[-1]] - x[bar[0]])
        pose = self.pose(r1 * x, normal)
        for place, m in zip(pose.x[len(x) :], pose.normal[len(x) :], strict=True):
            sine, (radii, wires) = np.sqrt(1.0 - np.minimum((normal @ m) ** 2, 1.0)), mesh.sizes
            lowest = float(((x - place) @ m - radii * sine - mesh.cell.wire * (wires - 1.0)).min())
            place += min(0.0, lowest - METHOD.clearance) * m
        return pose

    def pose(self, centre: Array, normal: Array) -> MeshPose:
        """The pose of rings with centres (n, 3) in mm and normals (n, 3), and of half-spaces and balls."""
        cell, rows = self.mesh.cell, [wall.row(self.mesh.cell.r2) for wall in self.walls]
        place, unit = (np.array([row[k] for row in rows]).reshape(-1, 3) for k in (0, 1))
        radius = np.array([row[2] for row in rows]) / cell.r1
        x, normal = np.concatenate([centre, place]) / cell.r1, np.concatenate([normal, unit])
        if cell.weave.is_of_equal_rings:
            return MeshPose(x, normal, radius)
        return MeshPose(x, normal, radius, *(np.append(size, np.ones(len(rows))) for size in self.mesh.sizes))

    def scaled(self, load: float | None = None) -> ScaledProblem:
        """The problem without units, with rows of half-spaces, which are held, and of balls after the rings.

        load: scale of residuals and mu in N; the sum of the dead loads if None.
        """
        mesh, r1, n, k = self.mesh, self.mesh.cell.r1, len(self.mesh.X), len(self.walls)
        load = float(np.abs(self.force).sum()) if load is None else load
        unit = load * float(np.hypot(*np.ptp(mesh.X, axis=0))) / (len(mesh.linked) * r1)
        loose = np.array([[isinstance(wall, RoundBody)] * 3 for wall in self.walls], dtype=bool).reshape(k, 3)
        free = np.zeros((n + k, BLOCK), dtype=bool)
        free[:n], free[n:, :3] = True, loose
        held = self.held | np.array([False, False, not self.is_space])
        free[:n, :3] = ~held
        at = self.at if self.is_space else self.at * [1.0, 1.0, 0.0]
        force = np.concatenate([self.force, np.array([wall.load for wall in self.walls]).reshape(k, 3)]) / unit
        held = np.concatenate([held, ~loose])
        guide = np.concatenate([np.broadcast_to(self.guide, (n, 3)) / r1, np.full((k, 3), np.nan)])
        at, size = self.pose(at, at).x, load / unit
        motions = self._motions(free)
        # Joining rings, and rings that lie upon each other, turn until minima of the distance split.
        wide = not (mesh.cell.weave.is_of_equal_rings and mesh.cell.weave.is_flat)
        return ScaledProblem(
            mesh.linked, mesh.cell.wire, force, held, at, motions, wide=wide, guide=guide, load=size, unit=unit
        )


def along(X: Array) -> Array:
    """Positions of points (k, 2) between the first, 0, and the last, 1, (k,)."""
    line = X[-1] - X[0]
    return np.asarray((X - X[0]) @ line / (line @ line))
