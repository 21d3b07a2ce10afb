"""What others measured: published numbers with their scatter beside ours, and what is not known about them.

A number is inside if the range of ours over what its source does not tell meets its scatter.
"""

from collections.abc import Iterable
from functools import cache
from itertools import product
from typing import Any

import numpy as np
from scipy.integrate import quad
from scipy.special import jn_zeros

from benchmarks.chains import BORE, CHAINS, GAUGES, chain_row
from benchmarks.frame import Curve, Diagram, Section, table
from benchmarks.measure import Row
from benchmarks.problems import Array, loads
from homogenize import default_law
from macro_fem import Cylinder, Disk, Edge, EveryRing, Floor, Loading, Mesh, Motion, Rectangle, Scene, Solver, Start
from macro_fem.job import solve, solve_membrane
from macro_fem.modes import find_modes
from macro_fem.motion.curtain import MovingCurtain
from macro_fem.motion.rings import MovingRings
from macro_fem.rings import EveryRingSolution
from rve import WEAVES, Cell, Material, pulled_ring, reference_cell, simulate, solve_table
from rve.common.materials import STEEL
from rve.common.ring_sizes import gauge_mm
from rve.geometry import supercell
from rve.geometry.slack import loosen
from rve.piece import ring_facts

INCH, G = 25.4, 9810.0
SILVER = 10.36e-6
"""Density of sterling silver, kg/mm3."""
OUNCE, TROY = 28.3495, 31.1035
"""Grams of an avoirdupois and of a troy ounce."""
SPRINGBACK = 0.04, 0.0, 0.08
"""By how much the bore of a ring is larger than its mandrel: ours, and the range, of which makers say little."""
BANDS = (
    (6, 21, 55, 13.8),
    (7, 20, 45, 11.3),
    (8, 19, 38, 9.4),
    (9, 18, 33, 7.5),
    (10, 17, 31, 5.5),
    (11, 16, 28, 4.25),
    (13, 15, 23, 3.7),
    (14, 14, 21, 2.9),
)
"""Mandrel in 1/64 inch, AWG, rings per inch of a band of five rows, inches per troy ounce of sterling silver."""
LEAST_MANDRELS = ((14, 8), (16, 6), (18, 5))
"""Gauge, least mandrel in 1/32 inch for 4-in-1."""
LENGTH, ROWS, FALLEN = 1000.0, 32, 0.95
"""Strips in motion: mm, cells along it, and the share of its length that a free end has fallen when it is timed."""
RINGS, APART = (2, 16), 25.0
"""Cells of the folded strip ring by ring, across and along, and the mm between its legs: rings jam in tighter folds."""
PULLEY = 12, 120.0
"""Cells along the strip over a pulley, and its radius in mm."""
DRAPED, ON = 60.0, 0.6
"""Radius in mm of a disk of mesh, and over it that of the disk below: 18 cm and 30 cm in Cusick's test."""


def number(source: str, what: str, value: float, scatter: tuple[float, float], ours: Iterable[float], of: str) -> Row:
    """A row: a published value, its scatter, and ours, first as it is and then over what is not known."""
    values = [float(x) for x in ours]
    low, high = min(values), max(values)
    return {
        "number": what,
        "of": of,
        "published": value,
        "scatter": f"{scatter[0]:.5g} to {scatter[1]:.5g}",
        "ours": values[0],
        "difference": values[0] / value - 1.0,
        "range of ours": f"{low:.5g} to {high:.5g}",
        "inside": max(low, scatter[0]) <= min(high, scatter[1]),
        "source": source,
    }


def about(value: float, off: float) -> tuple[float, float]:
    """The value less and more a part of it."""
    return value * (1.0 - off), value * (1.0 + off)


def bands() -> list[Row]:
    """Rings per inch and inches per ounce of bands of five rows, pulled along the grain."""
    rows, per_ounce = [], []
    for mandrel, gauge, count, inches in BANDS:
        wire, of = gauge_mm(f"{gauge} awg"), f"{gauge} AWG on {mandrel}/64 inch"
        cells = [Cell.of(inner=mandrel / 64.0 * INCH * (1.0 + s), wire=wire, density=SILVER) for s in SPRINGBACK]
        ours = [5.0 * INCH / reference_cell(cell).sides_mm[1] for cell in cells]
        rows.append(number("bands", "rings per inch", count, (count - 0.5, count + 0.5), ours, of))
        length = [TROY / (1e3 * cell.ring_mass * n) for cell, n in zip(cells, ours, strict=True)]
        per_ounce.append(number("bands", "inches per troy ounce", inches, about(inches, 0.05), length, of))
    return rows + per_ounce


def sheets() -> list[Row]:
    """Rings per area and mass as sold, of one size; the mass of an old ring, and rings of a shirt of 10 kg."""
    cell = Cell.of(inner=4.1, wire=1.0, density=SILVER)
    states, foot = ring_facts(cell)["mesh"], 1e-6 * (12.0 * INCH) ** 2
    per_foot = [foot * states[name]["rings_per_m2"] for name in ("pulled_along_grain", "pulled_across_grain", "slack")]
    sizes = [(4.1, 1.0), *product((4.05, 4.15), (0.0385 * INCH, 0.0395 * INCH))]
    masses = [1e3 * Cell.of(inner=inner, wire=wire, density=SILVER).ring_mass for inner, wire in sizes]
    old = [1e3 * Cell.of(outer=outer, wire=wire).ring_mass for outer, wire in ((5.25, 0.8), (5.5, 0.85), (5.0, 0.75))]
    shirt = 10.0 / Cell.of(inner=10.0, wire=1.5).ring_mass
    of = "wire 1.0 mm, inside 4.1 mm"
    ounce = [OUNCE / mass for mass in masses]
    return [
        number("sheets", "rings per square foot, taut to slack", 7954.0, (7953.5, 7954.5), per_foot, of),
        number("sheets", "rings per ounce of silver", 225.0, (224.5, 225.5), ounce, of),
        number("old shirt", "grams of a ring", 0.047, (0.0465, 0.0475), old, "outside 5 to 5.5 mm, wire 0.8 mm"),
        number("shirt", "rings of 10 kg", 3e4, (15e3, 45e3), [shirt], "wire 1.5 mm, inside 10 mm"),
    ]


def aspect_ratios() -> list[Row]:
    """Least inner diameter over wire of weaves; ours as the ring is, and with all the springback by its mandrel."""
    told, larger = {"4-in-1": 2.9, "kings-4-in-1": 4.7, "6-in-1": 4.3}, "6-in-1, 2 x 2 cells in space"
    limits = {name: WEAVES[name].jamming_ratio - 1.0 for name in told}
    limits[larger] = loosen(supercell(WEAVES["6-in-1"], 2, 2, "space"))[1] - 1.0
    rows = []
    for name, ratio in (told | {larger: told["6-in-1"]}).items():
        ours = [limits[name] / (1.0 + s) for s in sorted(SPRINGBACK)]
        rows.append(number("least ratios", "least aspect ratio", ratio, (ratio - 0.05, ratio + 0.05), ours, name))
    ours = [limits["6-in-1"] / (1.0 + s) for s in SPRINGBACK]
    sold, wire = 12.0 / 64.0 * INCH, gauge_mm("18 awg")
    rows.append(number("bands", "least aspect ratio sold", sold / wire, about(sold / wire, 0.01), ours, "6-in-1"))
    for gauge, least in LEAST_MANDRELS:
        wires = [gauge_mm(f"{gauge} {kind}") for kind in ("swg", "awg")]
        ours = [np.ceil(32.0 / INCH * wire * limits["4-in-1"] / (1.0 + s)) for wire in wires for s in SPRINGBACK]
        rows.append(number("least rings", "least mandrel, 1/32 inch", least, (least, least), ours, f"4-in-1, {gauge}"))
    return rows


def rings() -> list[Row]:
    """A pinched ring, two rings pulled until they opened, chains of three rings, and frequencies of a hanging chain."""
    thin = pulled_ring(1000.0, 1.0).opening_mm_per_N * STEEL.young_N_per_mm2 * 0.25 * np.pi / 1000.0**3
    hard = Material(yield_N_per_mm2=STEEL.ultimate_N_per_mm2)
    wires = GAUGES.values()
    open_, whole = (
        [pulled_ring(0.5 * (BORE + wire), 0.5 * wire, metal, joint) for metal in (STEEL, hard) for wire in wires]
        for joint in ("butted:90", "welded")
    )
    broken = [force for ring in whole for force in ring.rupture_N or ()]
    rows = [
        number("pinched", "opening, P R3/EI", 0.14868, about(0.14868, 0.001), [thin], "thin ring"),
        number("pulled rings", "butted ring opens, N", 27.0, (26.9, 27.0), [r.collapse_N for r in open_], "16 gauge"),
        number("pulled rings", "riveted ring breaks, N", 400.0, about(400.0, 0.01), broken, "16 gauge"),
    ]
    for wire, windings, force, elongation in CHAINS:
        row, of = chain_row(wire, windings, force, elongation), f"{windings} windings of {wire:g} mm"
        ours = [row["strings, mm"]]
        rows.append(number("chains", "elongation, mm", elongation, about(elongation, 0.05), ours, of))
        band = [float(text) for text in row["band, kN"].split(" to ")]
        rows.append(number("chains", "rupture, kN", force, (force, force), band, of))
    return rows


def hanging_chain() -> list[Row]:
    """Natural frequencies of a strip hung along the grain, as 2 omega (L/g)^(1/2)."""
    sheet = Scene(Rectangle(LENGTH / ROWS, LENGTH), [Edge("top")], mesh=Mesh(cells=2))
    found = find_modes(solve_membrane(sheet, default_law()).solution, 3).frequencies_Hz
    ours = 4.0 * np.pi * found * np.sqrt(LENGTH / G)
    pairs = enumerate(zip(jn_zeros(0, 3), ours, strict=True), 1)
    return [number("modes", "frequency", round(float(x), 4), about(x, 1e-3), [y], f"mode {k}") for k, (x, y) in pairs]


def paper() -> list[Row]:
    """The load cases of the paper: all of them directly, those that pull both ways by its scheme, step by step."""
    alpha, beta = loads()
    locked = int(solve_table(Cell(), (alpha, beta)).converged.sum())
    both = beta > 0.0
    rest = simulate(Cell(), (alpha[both], beta[both])).rest
    last = np.flatnonzero((alpha[both] == 45.0) & (beta[both] == 90.0))
    of = f"{both.sum()} loads with beta > 0"
    return [
        number("paper", "cases that lock", 190, (190, 190), [locked], "190 loads"),
        number("paper", "least time to rest, s", 14.5, (14.45, 14.55), [rest.time.min()], of),
        number("paper", "time to rest, s", 1340.0, (1335.0, 1345.0), rest.time[last], "(45, 90)"),
        number("paper", "most steps", 2800, (2750, 2850), [rest.steps.max()], of),
    ]


QUICK = bands, sheets, aspect_ratios, rings, hanging_chain
"""What takes seconds; the tests compute it anew."""


def kept(share: float) -> float:
    """Time until the free end of a folded chain has fallen this share of its length, over that of its free fall, if
    all energy is kept: the speed is (g x (2 - x/L)/(1 - x/L))^(1/2)."""
    way = quad(lambda s: np.sqrt(2.0 * (1.0 - s * s) / (2.0 - s * s)), 0.0, np.sqrt(share))[0]
    return float(way / np.sqrt(share))


def strip(items: list[Any], sides: tuple[float, float], cells: int, step: float, steps: int, **more: Any) -> Scene:
    """A strip of `sides` mm in motion."""
    more = {"solver": Solver(space=True)} | more
    return Scene(Rectangle(*sides), items, mesh=Mesh(cells=cells), motion=Motion(steps * step, step=step), **more)


def fold(width: float, length: float, cells: int, apart: float, steps: int) -> Scene:
    """A strip whose ends are held side by side at one height, so far apart; one of them is let go at t = 0."""
    away = ((0.0, length, apart), (width, length, apart))
    ends = [Edge("top"), Edge("bottom", along=away, release=0.0)]
    return strip(ends, (width, length), cells, 1.1 / steps * np.sqrt(2.0 * length / G), steps)


def timed(frames: Iterable[tuple[float, Array]], length: float) -> Array:
    """Shares of its length that the free end has fallen, and the times over those of free fall, (2, n)."""
    times, places = map(np.array, zip(*frames, strict=True))
    tip = (places[0, :, 2] > 0.5 * places[0, :, 2].max()) & (places[0, :, 1] > places[0, :, 1].max() - 1e-3 * length)
    height = places[:, tip, 1].mean(axis=1)
    share = (height[0] - height[1 : 1 + height.argmin()]) / length
    return np.array([share, times[1 : 1 + len(share)] / np.sqrt(2.0 * length / G * share)])


@cache
def folded() -> dict[str, Array]:
    """`timed` of a folded strip of the law, and of one ring by ring."""
    width, (across, along) = LENGTH / ROWS, np.multiply(reference_cell(Cell()).sides_mm, RINGS).tolist()
    law = MovingCurtain(fold(width, LENGTH, 1, width, 60), default_law()).frames()
    every = MovingRings(fold(across, along, RINGS[0], APART, 50)).frames()
    return {
        f"strip, {ROWS} cells long": timed(((f.moment.t, f.x) for f in law), LENGTH),
        f"every ring, {RINGS[1]} cells long": timed(((f.moment.t, f.rings.centre) for f in every), along),
    }


@cache
def on_scale() -> Array:
    """A strip let go above a floor that it touches: shares of its length that have fallen, the time over that of free
    fall from its height, force on the floor over its weight, (3, n)."""
    law, width, duration, rows = default_law(), LENGTH / ROWS, np.sqrt(2.0 * LENGTH / G), []
    scene = strip([Edge("top", release=0.0), Floor()], (width, LENGTH), 1, duration / 100, 100)
    for frame in MovingCurtain(scene, law).frames():
        top = frame.problem.mesh.mesh.p[1] > LENGTH - 1e-6
        rows.append([1.0 - frame.x[top, 1].mean() / LENGTH, frame.moment.t / duration, frame.pushed[0][:, 1].sum()])
    weight = 1e-9 * law.cell.areal_mass_kg_per_m2 * width * LENGTH * G if law.cell else np.nan
    return np.transpose(rows) / np.array([[1.0], [1.0], [weight]])


@cache
def on_pulley() -> Array:
    """A strip over a pulley whose one end is pulled down with g: times over (l/g)^(1/2), l the length that hangs on the
    other side, ways of both ends and how far the strip is off the pulley on that side, over l, (4, n)."""
    cells, radius = PULLEY
    width, hung = LENGTH / cells, LENGTH - np.pi * radius
    times = np.linspace(0.0, 1.35 * np.sqrt(hung / G), 28)
    history = tuple((float(t), float((t / times[-1]) ** 2)) for t in times)
    along, down = ((0.0, 0.0, radius), (width, 0.0, radius)), (0.0, -0.5 * G * times[-1] ** 2, 0.0)
    items = [Edge("top", along=along, move=down, history=history), Cylinder((1.0, 0.0, 0.0), radius, clear="nodes")]
    lying = Start((0.0, radius, radius - LENGTH), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    solver, rows = Solver(space=True, tolerance=1e-6), []
    scene = strip(items, (width, LENGTH), 1, times[1], 27, solver=solver, start=lying)
    for frame in MovingCurtain(scene, default_law()).frames():
        x, t, tip = frame.x, frame.moment.t, frame.problem.mesh.mesh.p[1] < 1e-6
        far = (x[:, 1] > 0.0) & (x[:, 2] < 0.0)
        off = np.hypot(x[far, 1], x[far, 2]).max(initial=radius) - radius
        rows.append([t * np.sqrt(G * hung), 0.5 * G * t * t, x[tip, 1].mean(), off])
    return (np.transpose(rows) - np.array([[0.0], [0.0], [rows[0][2]], [0.0]])) / hung


def moving() -> list[Row]:
    """Folded chains, a chain on a scale, a chain over a pulley."""
    whole, what = kept(FALLEN), f"time to fall {FALLEN:.0%} over free fall"
    times = {name: float(np.interp(FALLEN, *way)) for name, way in folded().items()}
    share, time, force = (values[on_scale()[0] < 0.8] for values in on_scale())
    load = np.trapezoid(force, time) / np.trapezoid(share, time)
    ahead, way, far = share[-1] / time[-1] ** 2, np.diff(on_pulley())[:, -1], (1.0, np.inf)
    of, over = f"strip, {ROWS} cells long", f"strip, {PULLEY[0]} cells long"
    return [
        *(number("fold", what, whole, about(whole, 0.05), [ours], name) for name, ours in times.items()),
        number("scale", "force over fallen weight", 3.0, about(3.0, 0.05), [load], of),
        number("scale", "way of the free end over free fall", 1.0, far, [ahead], of),
        number("pulley", "speed of free over pulled end", 1.0, far, [way[2] / way[1]], over),
    ]


def drape(ratio: float) -> Row:
    """A disk of mesh over a smaller one, ring by ring, r1 = 5 mm: the part of its free area that its shadow covers, and
    the folds by the strongest wave of the rim."""
    angle = 2.0 * np.pi * np.arange(48) / 48
    inner = ON * DRAPED * np.column_stack([np.cos(angle), np.sin(angle)])
    sheet, down = Disk(DRAPED, holes=(tuple(map(tuple, inner.tolist())),)), Loading(gravity=(0.0, 0.0, -1e-3 * G))
    found = solve(Scene(sheet, [Edge("hole")], load=down, mesh=Mesh(cells=24)), EveryRing(Cell(5.0, 5.0 / ratio)))
    assert isinstance(found, EveryRingSolution)
    X, x = found.scene.mesh.X, found.found.centre
    rim = np.hypot(X[:, 0], X[:, 1]) > DRAPED - 9.0
    at = x[rim][np.argsort(np.arctan2(X[rim, 1], X[rim, 0])), :2].T
    shadow = 0.5 * abs(float(at[0] @ np.roll(at[1], -1) - at[1] @ np.roll(at[0], -1))) / np.pi / DRAPED**2
    row: Row = {"r1/r2": ratio, "rings": len(x), "status": str(found.found.status)}
    row["drape coefficient"] = (shadow - ON**2) / (1.0 - ON**2)
    return row | {"folds": 2 + int(np.abs(np.fft.rfft(np.hypot(*at)))[2:].argmax())}


def measure(full: bool) -> Section:
    """The section; `full` has no more."""
    del full
    rows = [row for make in (*QUICK, moving, paper) for row in make()]
    out = ["- {number}, {of}: {published:.4g}, ours {ours:.4g}".format(**row) for row in rows if not row["inside"]]
    text = "\n".join([f"**Outside of the scatter: {len(out)} of {len(rows)}.**", "", *out, "", TEXT])
    forms = {"published": ".5g", "ours": ".5g", "difference": "+.1%"}
    draped = table("Drape of a mesh disk", [*map(drape, (5.0, 10.0, 20.0))], {"r1/r2": "g"}, SHADOW)
    return Section("", text, (table("", rows, forms), draped), diagrams())


def diagrams() -> tuple[Diagram, ...]:
    """Bands, folded chains, a chain on a scale, and one over a pulley."""
    size, shares = [row[0] / 64.0 * INCH for row in BANDS], np.geomspace(0.02, 1.0, 16)
    ours = curve("ours", size, [row["ours"] for row in bands()[: len(BANDS)]])
    told = curve("published", size, [row[2] for row in BANDS], joined=False)
    energy = curve("all energy kept, as published", shares, [*map(kept, shares)])
    falls = [curve(name, *way[:, (way[0] > shares[0]) & (way[0] < 0.99)]) for name, way in folded().items()]
    weight = curve("three times what has fallen, as published", shares, 3.0 * shares)
    share, _, force = (np.convolve(values, np.full(7, 1.0 / 7.0), "valid") for values in on_scale())
    seen = share > shares[0]
    strip_of = curve("strip, mean of 7 steps", share[seen], force[seen], joined=False)
    t, pulled, tip, off = on_pulley()[:, on_pulley()[0] > 0.5]
    off[off < 1e-5] = np.nan
    lifts = curve("strip off the pulley", t, off), curve("lead of the free end", t, tip - pulled)
    way, time = "part of its length that has fallen", "time over (l/g)^(1/2)"
    return (
        Diagram("bands", "Bands of five rows", "mandrel, mm", "rings per inch", (told, ours)),
        Diagram("fold", "A folded chain", way, "time over that of free fall", (energy, *falls)),
        Diagram("scale", "A chain let go above a scale", way, "force over its weight", (weight, strip_of)),
        Diagram("pulley", "A chain over a pulley, one end pulled down with g", time, "way over l", lifts),
    )


def curve(label: str, x: Iterable[float], y: Iterable[float], joined: bool = True) -> Curve:
    """A curve of arrays."""
    return Curve(label, tuple(map(float, x)), tuple(map(float, y)), joined)


TEXT = """`inside`: the range of ours over what the source does not tell meets the scatter; `difference`: ours over the
published number, less one. Sources and what is not known of each stand below. The free end of a folded chain is timed
when it has fallen 95 % of its length: theory has 0.8638 there and 0.8472 at the end. Over a pulley a chain has no push
left where its tension is the mass per length times v^2: at 1.0 of this time, by hand."""
SHADOW = """Nobody has published this for mail. How to measure it: Cusick's test, a disk of mesh of 300 mm on one of 180
mm, light from below; drape coefficient: the part of the free area that the shadow covers; folds counted at the rim;
both ways up, several times, as friction keeps folds. Ours: r1 = 5 mm, disks of 120 and 72 mm, every ring, without
friction, from the slack weave, one start each: rings are coarse here, and another start may fold another way. `folds`:
the strongest wave of the rim, 2 where none stands out from both axes of the mesh. The law has no answer: its sheet
folds as finely as it likes, its skirt hangs plumb."""
