"""Weaves: rings roughly placed become a pattern with its links, pairs, mirror and slack pose; the catalogue.

The weave's axes are those of its lattice: a1 goes along x and a2 along y, both equally far from them. Rings are counted
from 1 in messages.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from operator import itemgetter
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from rve.common import AnyPath, Array, InputError, Typed, read_as, shown
from rve.common.cell_fields import Length
from rve.common.ring_sizes import DEFAULT_RING
from rve.common.texts import read_toml
from rve.common.typed import not_one_of, read_typed
from rve.geometry.contacts import find_contacts
from rve.geometry.pattern import Centres, Pattern, padded
from rve.geometry.pose import Pose, mirror_modes, mirrored, moved, start_pose
from rve.geometry.ring_pair import are_linked, local_minima
from rve.geometry.slack import Link, flags_of, loosen, matched, near_pairs, once, thickest

MOST_RINGS = 40
"""Rings of a cell: the equations of more, five unknowns each, take hours a table."""
MOST_CROWDED = 100.0
"""Sum of r1^2 of the rings of a cell over its area, 2 in 8-in-1: the pairs that can touch grow with it."""
WITHIN = 3.2
"""Pairs of rings that are nearer in the slack pose, in the sum of their radii, are looked at for contact. Flat rings of
japanese-6-in-1 meet at r1/r2 = 96 that are more than 3.0 apart there."""
SAME = 1e-6
"""Relative difference of the thickest wire by which a smaller or symmetric cell may fall short of the one drawn."""
DISTURBED = 0.02
"""Largest change of a coordinate, in r1 or radians, of a second start for rings in space."""
SYMMETRIES = ((-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (-1.0, 1.0, -1.0), (1.0, -1.0, -1.0))
"""Mirrors and half turns that exchange shears of both signs."""
Coordinate = Annotated[float, Meta(ge=-1e4, le=1e4, title="mm")]


@dataclass(frozen=True)
class PlacedRing(Typed):
    """A ring of a cell: centre in mm, normal of any length, radii of the centre circle and of the wire in mm."""

    centre: tuple[Coordinate, Coordinate, Coordinate]
    normal: tuple[Coordinate, Coordinate, Coordinate]
    r1: Length
    r2: Length

    def check(self) -> None:
        if not np.linalg.norm(self.normal) > 1e-6:
            self.refuse(f"normal = {list(self.normal)}: is no direction")
        if not self.r2 < self.r1:
            self.refuse(f"r2 = {self.r2:g}: must be less than r1 = {self.r1:g}")


@dataclass(frozen=True)
class Drawing(Typed):
    """A weave as text has it: lattice vectors a1, a2 in mm and the rings of one cell. centres: whether they all come to
    lie in one plane, or move in "space", as those of doubled rings do. planar_ratio: see `Pattern`."""

    name: Annotated[str, Meta(min_length=1, max_length=60)]
    lattice: tuple[tuple[Coordinate, Coordinate], tuple[Coordinate, Coordinate]]
    ring: tuple[PlacedRing, ...]
    pairs: tuple[tuple[int, int, int, int], ...] = ()
    planar_ratio: float | None = None
    centres: Centres = "plane"


class Weave(Pattern):
    """A periodic pattern of interlinked rings, see `Pattern` for what it holds.

    >>> from rve import Weave
    >>> tilt = 0.56
    >>> rings = [{"centre": (0, 0, 0), "normal": (0, tilt, 0.83), "r1": 5, "r2": 0.5}]
    >>> rings += [{"centre": (6.2, 3.1, 0), "normal": (0, -tilt, 0.83), "r1": 5, "r2": 0.5}]
    >>> mine = Weave.from_rings([(12.5, 0), (0, 6.2)], rings, name="mine")
    >>> round(mine.jamming_ratio, 4), mine.is_mirrored, int(mine.linked.sum())
    (3.9809, True, 4)
    """

    @classmethod
    def from_rings(
        cls,
        lattice: Sequence[Sequence[float]],
        rings: Sequence[Mapping[str, Any]],
        name: str = "own",
        centres: Centres = "plane",
    ) -> Weave:
        """The weave of rings roughly placed, in mm: lattice vectors a1 and a2, and of each ring of a cell its centre
        (x, y, z), normal, r1 and r2. Their links count; distances and angles become those of largest clearance, with
        all centres in one plane, or in "space".

        InputError, one sentence with the numbers of the rings, for what is no sheet of interlinked rings.
        """
        table = {"name": name, "lattice": lattice, "ring": _placed(rings), "centres": centres}
        return woven(read_typed(Drawing, table, "weave"))

    def drawing(self, r1: float, r2: float) -> Drawing:
        """The slack pose as text, for radii of the first ring in mm."""
        pose = start_pose(self, 1)
        places = (r1 * padded(pose.centres[0])).tolist(), pose.normals[0].tolist()
        sizes = zip(*places, self.radii.tolist(), self.wires.tolist(), strict=True)
        rings = [PlacedRing((x, y, z), (n[0], n[1], n[2]), r1 * a, r2 * w) for (x, y, z), n, a, w in sizes]
        a1, a2 = ((float(r1 * a[0, 0]), float(r1 * a[0, 1])) for a in (pose.a1, pose.a2))
        return Drawing(self.name, (a1, a2), tuple(rings), centres=self.centres)


def _placed(rings: Any) -> tuple[PlacedRing, ...]:
    """The rings of a cell; InputError with the number of the ring that does not fit."""
    if not isinstance(rings, list | tuple):
        raise InputError("ring: is no list of rings; write [[ring]] with centre, normal, r1 and r2 for each")
    if len(rings) > MOST_RINGS:
        raise InputError(f"{len(rings)} rings: a cell has at most {MOST_RINGS}; give the smallest cell that repeats")
    parts = enumerate(rings, 1)
    return tuple(r if isinstance(r, PlacedRing) else read_typed(PlacedRing, r, f"ring {k}:") for k, r in parts)


def read_weave(path: AnyPath) -> Weave:
    """The weave in a TOML file: name, lattice = [[x, y], [x, y]], and [[ring]] with centre = [x, y, z], normal, r1, r2;
    lengths in mm. As `Weave.from_rings`; InputError names the file."""
    drawing = read_drawing(path)
    if drawing.name in WEAVES:
        raise InputError(f"{path}: name = {drawing.name}: is a weave of the catalogue; choose another name")
    if drawing.pairs or drawing.planar_ratio is not None:
        key = "pairs" if drawing.pairs else "planar_ratio"
        raise InputError(f"{path}: {key}: is for the catalogue alone, and would have no effect; leave it out")
    try:
        return woven(drawing)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def read_drawing(path: AnyPath) -> Drawing:
    """The drawing in a TOML file, as it is there."""
    with read_as("weave", path):
        table = read_toml(path)
    return drawing_of(table, f"{path}:")


def drawing_of(table: Mapping[str, Any], where: str) -> Drawing:
    """The drawing in a parsed table; InputError, which begins with `where`, for what does not fit."""
    if not isinstance(table, Mapping):
        raise InputError(f"{where} is no table of name, lattice and rings")
    try:
        rings = _placed(table.get("ring", []))
    except InputError as error:
        raise InputError(f"{where} {error}") from None
    return read_typed(Drawing, {**table, "ring": rings}, where)


@cache
def woven(drawing: Drawing, is_slack: bool = False) -> Weave:
    """The weave of a drawing; is_slack: it is drawn in the slack pose that this function found before."""
    weave = _read_off(drawing)
    if is_slack:
        weave = _in_pose(weave, start_pose(weave, 1), thickest(weave, start_pose(weave, 1)))
        image = _mirrored(weave)
        weave = weave if image is None else replace(weave, mirror=image.mirror, images=image.images)
        listed = np.array(drawing.pairs or weave.pairs)
        links = {once(link) for link in weave.pairs[weave.linked]}
        planar = weave.planar_ratio if drawing.planar_ratio is None else drawing.planar_ratio
        return _known(replace(weave, pairs=listed, linked=flags_of(listed, links), planar_ratio=planar))
    free, first = _in_pose(weave, *_loosest(weave)), drawing.ring[0]
    if not first.r1 / first.r2 > free.jamming_ratio:
        raise InputError(
            f"ring 1: r2 = {first.r2:g} is too thick, the rings overlap in every pose; it is at most "
            f"{first.r1 / free.jamming_ratio:.4g}, with the others in proportion"
        )
    for axis, count in product(range(2), range(weave.classes, 1, -1)):
        # As drawn, where many poses are as good as the slack one; as loosened, where rings are placed roughly.
        part = _divided(weave, axis, count) or _divided(free, axis, count) if weave.classes % count == 0 else None
        loose = part and _in_pose(part, *loosen(part))
        if part and loose and loose.jamming_ratio < (1.0 + SAME) * free.jamming_ratio:
            weave, free = part, loose
    for image in filter(None, (_mirrored(weave), _mirrored(free))):
        loose = _in_pose(image, *loosen(image, mirror_modes(image)))
        if loose.jamming_ratio < (1.0 + SAME) * free.jamming_ratio:
            return _known(loose)
    return _known(free)


def _loosest(weave: Weave) -> tuple[Pose, float]:
    """`loosen`, of rings in space also from near the pose that is drawn: parallel rings drawn one upon the other touch
    along all of a line, of which no step leads away."""
    poses = [loosen(weave)]
    if not weave.is_flat:
        rng, start = np.random.default_rng(0), start_pose(weave, 1)
        near = moved(start, DISTURBED * rng.uniform(-1.0, 1.0, (1, weave.coordinates)))
        parts = near.lattice[0], near.centres[0], near.normals[0]
        other = replace(weave, **dict(zip(("start_lattice", "start_centres", "start_normals"), parts, strict=True)))
        links = find_contacts(near, weave, 0.0, 0.1).links_intact[0]
        poses += [loosen(other)] if links else []
    return min(poses, key=itemgetter(1))


def _read_off(drawing: Drawing) -> Weave:
    """The weave as it is drawn, in the axes of its lattice and with all centres in one plane, with the links that are
    read off; InputError for what is no sheet."""
    rings = drawing.ring
    if len(rings) < 2:
        raise InputError(f"{len(rings)} ring: its translates are parallel and interlink in no way; give two or more")
    unit = rings[0].r1
    lattice, centres, normals = (
        np.array(x) for x in (drawing.lattice, [r.centre for r in rings], [r.normal for r in rings])
    )
    radii, wires = np.array([r.r1 for r in rings]) / unit, np.array([r.r2 for r in rings]) / rings[0].r2
    area = float(np.linalg.det(lattice))
    if not abs(area) > 0.01 * np.prod(np.linalg.norm(lattice, axis=1)):
        raise InputError("lattice: a1 and a2 are parallel or zero; give two vectors that span a cell")
    size = unit * radii
    if abs(area) < 0.1 * np.pi * rings[int(wires.argmin())].r2 ** 2 or (size**2).sum() > MOST_CROWDED * abs(area):
        raise InputError(
            f"lattice: a cell of {abs(area):.4g} mm2 is tiny beside rings of r1 = {size.max():g} mm; lengths are in mm"
        )
    lattice = lattice / unit * [[np.sign(area)], [1.0]]
    first, second = np.arctan2(lattice[:, 1], lattice[:, 0])
    lean = 0.5 * (0.5 * np.pi - np.mod(second - first, 2.0 * np.pi))
    c, s = np.cos(first - lean), np.sin(first - lean)
    to_axes = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])  # rows are turned by it
    lattice, normals = lattice @ to_axes[:2, :2], normals @ to_axes
    centres = (centres - centres[0]) @ to_axes / unit
    centres[:, :2] -= np.floor(centres[:, :2] @ np.linalg.inv(lattice) + 1e-9) @ lattice
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(np.abs(size - 1.0) < 1e-6, normals, normals / size)  # as they are written
    z = centres[:, 2]
    if np.ptp(z) > radii.max():
        low, high = int(z.argmin()) + 1, int(z.argmax()) + 1
        raise InputError(
            f"the centres of rings {low} and {high} are {unit * np.ptp(z):.4g} mm apart across the plane: that is a "
            "net in space, and a sheet has all its centres near one plane"
        )
    links = _links(lattice, centres, normals, radii)
    flat = centres * [1.0, 1.0, 0.0] if drawing.centres == "plane" else centres
    for a, b, *_ in links ^ _links(lattice, flat, normals, radii):
        raise InputError(
            f"rings {a + 1} and {b + 1} interlink in another way once all centres are in one plane; place them nearer "
            'to it, or say centres = "space"'
        )
    _check_sheet(links, len(rings))
    start = np.array([lattice[0, 0], lattice[1, 1], np.tan(lean)])
    return _weave(drawing.name, start, flat[:, : 3 if flat[:, 2].any() else 2], normals, radii, wires, links)


def _links(lattice: Array, centres: Array, normals: Array, radii: Array) -> set[Link]:
    """The links of rings; InputError where two wires' centre lines cross, so that nothing can be said."""
    pairs = near_pairs(lattice, centres, radii[:, None] + radii)
    a, b = pairs[:, 0], pairs[:, 1]
    d = centres[b] - centres[a]
    d[:, :2] += pairs[:, 2:] @ lattice
    circles = d, normals[a], normals[b], (radii[a], radii[b])
    minima = local_minima(*circles, reach=1e-6)
    for pair in minima.pair[:1]:
        rings = (
            f"ring {a[pair] + 1} and its translate" if a[pair] == b[pair] else f"rings {a[pair] + 1} and {b[pair] + 1}"
        )
        raise InputError(f"{rings}: their centre lines cross, so that it is open how they interlink; move them apart")
    return {once(pair) for pair in pairs[are_linked(*circles)]}


def _check_sheet(links: set[Link], count: int) -> None:
    """InputError unless links join all rings to one sheet, in two directions."""
    place: dict[int, Array] = {0: np.zeros(2, dtype=int)}
    cycles: list[Array] = []
    ways = [(a, b, np.array([i, j])) for a, b, i, j in links] + [(b, a, -np.array([i, j])) for a, b, i, j in links]
    todo = [0]
    while todo:
        ring = todo.pop()
        for a, b, shift in ways:
            if a == ring and b not in place:
                place[b] = place[a] + shift
                todo.append(b)
    loose = [str(k + 1) for k in range(count) if k not in place]
    if loose:
        what = f"ring {loose[0]} links" if len(loose) == 1 else f"rings {', '.join(loose)} link"
        raise InputError(f"{what} in no way to ring 1; a sheet hangs together by links")
    cycles = [place[a] + shift - place[b] for a, b, shift in ways]
    areas = [abs(int(u[0] * v[1] - u[1] * v[0])) for u in cycles for v in cycles]
    sheets = int(np.gcd.reduce(areas)) if areas else 0
    if not sheets:
        what = "chains, which" if any(cycle.any() for cycle in cycles) else "groups of rings, which"
        raise InputError(f"the rings form {what} no link holds together; a sheet needs links in two directions")
    if sheets > 1:
        raise InputError(f"the rings are {sheets} sheets through each other that no link joins; give one of them")


def _weave(
    name: str, lattice: Array, centres: Array, normals: Array, radii: Array, wires: Array, links: set[Link]
) -> Weave:
    """The weave with these links, whose pairs are those within reach in this pose."""
    a1, a2 = np.array([1.0, lattice[2]]) * lattice[0], np.array([lattice[2], 1.0]) * lattice[1]
    centres = centres - centres[0]
    near = near_pairs(np.stack([a1, a2]), padded(centres), WITHIN * (radii[:, None] + radii))
    far = links - {once(pair) for pair in near}
    pairs = np.concatenate([near, np.array(sorted(far), dtype=int).reshape(-1, 4)])
    # Two cells along a1 and a2, with the next row of the first class, as in the paper.
    rings = np.array([(k, i, j) for k in range(len(centres)) for j in range(2 if k else 3) for i in range(2)])
    return Weave(name, pairs, flags_of(pairs, links), rings, lattice, centres, normals, radii, wires, 0.0, 0.0)


def _in_pose(weave: Weave, pose: Pose, jamming_ratio: float) -> Weave:
    """The weave with this start pose (n = 1); its rings are those in the cell, unless they are known as images."""
    lattice, whole = np.stack([pose.a1[0], pose.a2[0]]), np.zeros((weave.classes, 2), dtype=int)
    if not weave.is_mirrored:
        whole = np.floor(pose.centres[0, :, :2] @ np.linalg.inv(lattice) + 1e-6).astype(int)
    links = {
        once((a, b, i + whole[b, 0] - whole[a, 0], j + whole[b, 1] - whole[a, 1]))
        for a, b, i, j in weave.pairs[weave.linked]
    }
    centres = pose.centres[0].copy()
    centres[:, :2] -= whole @ lattice
    centres = centres[:, : 3 if np.abs(centres[:, 2:]).max(initial=0.0) > SAME else 2]
    placed = _weave(weave.name, pose.lattice[0], centres, pose.normals[0], weave.radii, weave.wires, links)
    return replace(placed, jamming_ratio=jamming_ratio, mirror=weave.mirror, images=weave.images)


def _divided(weave: Weave, axis: int, count: int) -> Weave | None:
    """The weave with a cell that is `count` times shorter along an axis; None where it does not repeat so often."""
    pose = start_pose(weave, 1)
    lattice = np.stack([pose.a1[0], pose.a2[0]])
    rings = matched(weave, weave, np.ones(3), lattice[axis] / count)
    if rings is None:
        return None
    names: dict[int, tuple[int, Array]] = {}
    centres, normals, firsts = [], [], list[int]()
    for first in range(weave.classes):
        if first in names:
            continue
        ring, shift, places, turns = first, np.zeros(2, dtype=int), [], []
        for step in range(count):
            if ring in names:
                return None
            place = -shift
            place[axis] = count * place[axis] + step
            names[ring] = len(firsts), place
            places.append(pose.centres[0, ring].copy())
            places[-1][:2] += shift @ lattice - step / count * lattice[axis]
            normal = pose.normals[0, ring]
            turns.append(normal * np.sign(normal @ pose.normals[0, first]))
            ring, *more = rings[ring]
            shift = shift + more
        firsts.append(first)
        centres.append(np.mean(places, axis=0))
        normals.append(np.mean(turns, axis=0) / np.linalg.norm(np.mean(turns, axis=0)))
    links = set()
    for a, b, i, j in weave.pairs[weave.linked].tolist():
        (ring, place), (other, there) = names[a], names[b]
        shift = np.array([i, j])
        shift[axis] *= count
        links.add(once((ring, other, *(there + shift - place))))
    sides = weave.start_lattice.copy()
    sides[axis] /= count
    sizes = weave.radii[firsts], weave.wires[firsts]
    return _weave(weave.name, sides, np.array(centres), np.array(normals), *sizes, links)


def _known(weave: Weave) -> Weave:
    """The weave; one that is in the catalogue under another name takes the pose there, so that tables agree to the last
    digit."""
    turns = np.array([[1.0, 1.0, 1.0], [-1.0, -1.0, 1.0]])
    for one in WEAVES.values() if weave.name not in WEAVES else ():
        if one.classes != weave.classes:
            continue
        if any(matched(one, weave, turn, place) for turn in turns for place in weave.start_centres):
            return replace(one, name=weave.name)
    return weave


def _mirrored(weave: Weave) -> Weave | None:
    """The weave in the mean of its pose and of its image by a mirror or a half turn, with its images; None if none is
    its own."""
    pose = start_pose(weave, 1)
    if abs(weave.start_lattice[2]) > 0.05:
        return None
    for signs in SYMMETRIES:
        for k in range(weave.classes):
            rings = matched(weave, weave, np.array(signs), pose.centres[0, k])
            if rings is None or rings[0][0] != k:
                continue
            image = replace(weave, mirror=np.array(signs), images=np.array(rings))
            other = mirrored(pose, image)
            normals = pose.normals[0] + other.normals[0]
            return replace(
                image,
                start_lattice=weave.start_lattice * [1.0, 1.0, 0.0],
                start_centres=0.5 * (pose.centres[0] + other.centres[0]),
                start_normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
            )
    return None


def sizes_of(name: str) -> dict[str, float]:
    """r1 and r2 in mm of the first ring in a TOML file, by their names; by default those of `DEFAULT_RING`."""
    ring = None if name in WEAVES else read_drawing(name).ring[0]
    return DEFAULT_RING if ring is None else {"r1": ring.r1, "r2": ring.r2}


def named_weave(name: str) -> Weave:
    """The weave of this name in the catalogue, or in the TOML file of this path; InputError says which there are."""
    if name in WEAVES:
        return WEAVES[name]
    if Path(name).suffix == ".toml":
        return read_weave(name)
    raise InputError(f"weave = {shown(name)}: {not_one_of(name, [*WEAVES, 'FILE.toml'])}")


class Catalogue(Mapping[str, Weave]):
    """The weaves of the package by their names, each read when it is asked for."""

    def __init__(self, folder: Path) -> None:
        self._files = {path.stem: path for path in sorted(folder.glob("*.toml"))}

    def __getitem__(self, name: str) -> Weave:
        return woven(_catalogued(self._files[name]), is_slack=True)

    def __contains__(self, name: object) -> bool:
        return name in self._files

    def __iter__(self) -> Iterator[str]:
        return iter(self._files)

    def __len__(self) -> int:
        return len(self._files)


_catalogued = cache(read_drawing)
WEAVES = Catalogue(Path(__file__).parent / "weaves")
FOUR_IN_ONE, SIX_IN_ONE = WEAVES["4-in-1"], WEAVES["6-in-1"]
