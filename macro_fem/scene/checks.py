"""Contradictions in a scene, keys that change nothing, and sizes that are more likely metres than millimetres."""

from collections.abc import Iterable, Iterator
from dataclasses import fields
from itertools import pairwise
from math import dist

from macro_fem.scene.moving import Ball, scaled
from macro_fem.scene.obstacles import Body
from macro_fem.scene.scene import Scene
from macro_fem.scene.shapes import MeshFile, Rectangle
from macro_fem.scene.support_kinds import Edge, Hanging, Track
from macro_fem.scene.tables import FACTORED, Bar, Load, PatchLoad, Timed, Vector, Wind, in_3d
from rve.common import Typed
from rve.common.typed import BadField

OF_HOOKS, OF_REST = ("capacity", "rings_per_hook"), ("tolerance", "max_iterations", "stabilising_tension")
"""Keys that every ring does not read, of what holds and loads points, and a curtain in motion, of how it is solved at
rest."""


def check_scene(scene: Scene) -> None:
    """InputError for records that contradict each other, and for keys that change nothing."""
    for what in _contradictions(scene):
        scene.refuse(what)


def _contradictions(scene: Scene) -> Iterator[str]:
    """What is wrong with a scene, a sentence each."""
    yield from _over_time(scene)
    yield from _of_combinations(scene)
    shape, pattern, steps = scene.curtain, scene.mesh.pattern, scene.load.steps
    is_hung = scene.motion is None or scene.motion.start == "hung"
    if not scene.support and scene.motion is None:
        yield "[support]: is missing, so nothing holds the curtain"
    if pattern != "aligned" and (not isinstance(shape, Rectangle) or shape.holes):
        what = f'shape = "{shape.kind}"' if not isinstance(shape, Rectangle) else "holes"
        yield f"[mesh] pattern = {pattern!r}: has no effect with {what}"
    for item in scene.support:
        held, move = item.held, item.move
        for axis, way in zip("xyz", in_3d(move), strict=True):
            if way != 0.0 and held != "both" and axis not in held:
                yield f"{item.where} move = {list(move)}: has no effect along {axis}, as held = {held!r}"
        if held == "z" and not scene.in_space:
            yield f"{item.where} held = 'z': holds nothing, as the scene lies in the plane"
    is_laid = any(wind.follows for wind in scene.of(Wind)) or bool(scene.of(Body)) or not is_hung
    if scene.start is not None and not is_laid:
        let_go = "" if scene.motion is None else "; [motion] start = 'reference' begins there"
        yield f"[start]: has no effect without bodies and following pressure{let_go}"
    is_live = [isinstance(item, Load) and not isinstance(item, Bar) for item in scene.items]
    changes = any(is_live) or any(any(item.move) for item in scene.items)
    if steps > 1 and not changes:
        yield f"[load] steps = {steps}: has no effect without live loads and moves"
    if any(wind.speed is not None for wind in scene.of(Wind)) and not scene.in_space:
        yield "[load.wind] speed: has no effect on a plane sheet along direction; give that a third component"
    if scene.solver.is_bounded:
        check_bounds(scene, "[solver] bounds and adapt:")
    if scene.solver.is_plastic:
        yield from _of_flow(scene)
    elif scene.solver.strings:
        yield "[solver] strings: has no effect without kind = 'plastic', as only rings that flow become strings"
    for kind, items in (("body", scene.of(Ball)), ("obstacle", scene.obstacle)):
        names = [item.name for item in items]
        for name in {name for name in names if names.count(name) > 1}:
            yield f"[[{kind}]] name = {name!r}: is that of two, and results go by it; give each its own"


def _of_flow(scene: Scene) -> Iterator[str]:
    """What does not go with rings that flow: what has no convex problem, and what would unload them."""
    where = "[solver] kind = 'plastic':"
    if scene.motion is not None:
        yield f"{where} is for a curtain at rest, as rings that flow do not go back"
    if scene.mesh.element != "P1":
        yield f"{where} needs element = 'P1', not {scene.mesh.element!r}"
    if bodies := scene.of(Body):
        yield f"{where} does not go with {bodies[0].name}: outside a body the problem is not convex, and has no limit"
    if any(wind.is_shaped for wind in scene.of(Wind)):
        yield f"{where} does not go with wind on the present shape; give its pressure, without speed and follows"


def _over_time(scene: Scene) -> Iterator[str]:
    """Histories that do not go on in time, and keys that need [motion]."""
    for item in scene.items:
        history, release = item.history, item.release
        if scene.motion is None and (history or release is not None):
            yield f"{item.where} {'history' if history else 'release'}: has no effect without [motion] duration"
        if scene.motion is None and isinstance(item, Ball):
            yield f"{item.where}: moves over time; give [motion] duration, in s"
        for (before, _), (after, _) in pairwise(history):
            if after <= before:
                yield f"{item.where} history: {after:g} s does not come after {before:g} s"
    for item in scene.of(Timed):
        for t, share in item.history:
            try:
                scaled(item, share)
            except BadField as error:
                yield f"{item.where} history: a share of {share:g}, at {t:g} s: {error.what}"
        if item.history and scaled(item, 0.5) == item:
            yield f"{item.where} history: has no effect without a move or load that it scales"
    if scene.motion is None:
        return
    if scene.load.steps > 1:
        yield f"[load] steps = {scene.load.steps}: has no effect in motion, use history"
    if scene.solver.is_bounded:
        yield "[solver] bounds and adapt: have no effect in motion"
    for key in keys_set(scene.solver, OF_REST) if scene.motion.start == "reference" else ():
        yield f"[motion] start = 'reference': [solver] {key} = {vars(scene.solver)[key]:g}: has no effect in motion"


def keys_set(record: Typed, keys: Iterable[str]) -> list[str]:
    """Those of the keys that a record has and whose value is not the default."""
    own, unset = vars(record), {item.name: item.default for item in fields(record)}  # type: ignore[arg-type]
    return [key for key in keys if key in unset and own[key] != unset[key]]


def _of_combinations(scene: Scene) -> Iterator[str]:
    """Combinations of one name, of loads that are not there, or of a scene in motion."""
    names = [one.name for one in scene.combination]
    kinds = {"name", "weight"} | {item.kind for item in scene.of(Load)}
    for one in scene.combination:
        where = f"[combination] {one.name}"
        if names.count(one.name) > 1:
            yield f"{where}: is the name of two combinations"
        if scene.motion is not None:
            yield f"{where}: has no effect with [motion]; give the factored loads"
        for kind in [*(item.name for item in fields(one) if item.name != "own"), *dict(one.own)]:
            if kind not in kinds and one.factor(kind) != 1.0:
                yield f"{where}: {kind}: has no effect, as the scene has no [load.{kind}]"
        for item in scene.of(Load):
            if one.factor(item.kind) != 1.0 and scaled(item, 0.5, FACTORED) == item:
                yield f"{where}: {item.kind}: has no effect, as it has no field force, pressure or mass"


def check_bounds(scene: Scene, by: str) -> None:
    """InputError if a scene is one whose curtain cannot be bounded; `by`: the words that asked for bounds."""
    if scene.solver.is_elastic:
        scene.refuse(f"{by} need rings that lock, [solver] kind = 'rigid' or 'auto', not 'elastic'")
    if any(wind.follows for wind in scene.of(Wind)):
        scene.refuse(f"{by} do not go with following pressure, no dead load")
    if bodies := scene.of(Body):
        scene.refuse(f"{by} do not go with {bodies[0].name}: outside a body the problem is not convex")
    if scene.mesh.element != "P1":
        scene.refuse(f"{by} need element = 'P1', not {scene.mesh.element!r}")


def check_sizes(scene: Scene, r1: float | None) -> None:
    """InputError for a curtain, pitch, track or line less than a ring of radius r1, or a smaller body or patch; r1 is
    None without rings."""
    if r1 is None:
        return
    sizes: list[tuple[str, float]] = []
    if not isinstance(scene.curtain, MeshFile):
        width, height = scene.curtain.extent(scene.curtain.corners(1)).tolist()
        sizes = [("[curtain] width", width), ("[curtain] height", height)]
    sizes += [(f"{one.where} pitch", one.pitch) for one in scene.of(Hanging) if one.pitch]
    limits = [(where, value, 2.0 * r1, "mean diameter") for where, value in sizes]
    limits += [(f"{one.where} width", 2.0 * one.breadth, r1, "radius") for one in scene.of(Body)]
    limits += [(f"{one.where} radius", one.radius, r1, "radius") for one in scene.of(PatchLoad)]
    limits += [(f"{one.where} radius", one.radius, r1, "radius") for one in scene.of(Track) if one.radius]
    lines: list[tuple[str, tuple[Vector, ...]]]
    lines = [(f"{one.where} path", one.path) for one in scene.of(Track) if one.path]
    lines += [(f"{one.where} along", one.along) for one in scene.of(Edge) if one.along]
    limits += [(f"{where}: length", sum(map(dist, line, line[1:])), r1, "radius") for where, line in lines]
    for where, value, least, what in limits:
        if value < least:
            hint = f", did you mean {1e3 * value:g}? ({value:g} metres)" if 1e3 * value >= least else ""
            scene.refuse(
                f"{where} = {value:g}: is less than the {what} of a ring, {least:g} mm; lengths are in mm{hint}"
            )
