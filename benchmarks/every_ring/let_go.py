"""Every ring in motion against the disk in motion: a sheet let go at one corner, and a gust on a sheet."""

import time
from functools import cache

import numpy as np

from benchmarks.every_ring.cases import SHEETS
from benchmarks.frame import Section, table
from benchmarks.measure import Row
from homogenize import default_law
from macro_fem import Mesh, Motion, Point, Rectangle, Scene, Top, Wind
from macro_fem.motion.curtain import MovingCurtain
from macro_fem.motion.pace import COLUMNS
from macro_fem.motion.rings import MovingRings
from macro_fem.motion.series import account_error

DURATION, STEP, CELLS = 0.15, 5e-3, 16
"""Seconds, and cells of the disk across."""
PRESSURE, HISTORY = 14.0, ((0.0, 0.0), (0.03, 1.0), (0.09, 1.0), (0.12, 0.0))
"""The gust: half the weight per area, N/m2, and its share over time in s."""
SHOWN = 5
"""Every so many steps are listed."""
BESIDE = 2
"""Size of the sheet beside MuJoCo: 111 rings."""
TRAVEL = 0.02
"""Part of the travel by which rings and disk may differ beyond their difference at rest."""
MEAN = [COLUMNS.index(f"mean_{axis}_mm") for axis in "xyz"]
POTENTIAL, WORK = COLUMNS.index("potential_N_mm"), COLUMNS.index("work_N_mm")
LOST = [COLUMNS.index(f"lost_by_{name}_N_mm") for name in ("locking", "scheme")]
SCENES = ("corner let go", "gust")


def motion_scene(name: str, k: int) -> Scene:
    """The sheet `corners` of the first section, its right corner let go at t = 0, or hung by its top, in a gust."""
    W, H = SHEETS[0].sides(k)
    away = 0.5 * (1.0 - SHEETS[0].gather) * W
    corners = (Point((0.0, H), move=(away, 0.0)), Point((W, H), move=(-away, 0.0), release=0.0))
    gust = (Top(), Wind(direction=(0.0, 0.0, -1.0), pressure=PRESSURE, history=HISTORY))
    items = corners if name == SCENES[0] else gust
    return Scene(Rectangle(W, H), items, mesh=Mesh(cells=CELLS), motion=Motion(DURATION, STEP))


@cache
def solved(name: str, k: int) -> Row:
    """Times, mean places of rings and disk in mm, and what both have lost by locking at the end, in %."""
    scene, began = motion_scene(name, k), time.process_time()
    ring_run = MovingRings(scene).solve()
    seconds = time.process_time() - began
    disk_run = MovingCurtain(scene, default_law()).solve()
    rings = np.array([frame.row for frame in ring_run.frames])
    disk = np.array([frame.row for frame in disk_run.frames])
    given = float((disk[:, WORK] - disk[:, POTENTIAL]).max() + disk[0, POTENTIAL])
    found = {"scene": name, "rings": len(ring_run.frames[0].rings.centre), "account": account_error(rings)}
    found["lost"] = [float(100.0 * rows[-1, LOST].sum() / given) for rows in (rings, disk)]
    found["places"] = rings[:, 0], rings[:, MEAN], disk[:, MEAN]
    return found | {"share": 100.0 / SHEETS[0].sides(k)[1], "seconds": seconds}


def measure(full: bool) -> Section:
    """The section; `full` takes 413 rings as well."""
    rows, ends = [], []
    for name, k in [(name, k) for k in sorted({1, BESIDE, 4} if full else {1, BESIDE}) for name in SCENES]:
        added, end = _compared(solved(name, k))
        rows += added
        ends.append(end)
    tables = [
        table("Mean place over time", rows, _forms(rows[0], {"t, s": ".3f"})),
        table("At the end", ends, _forms(ends[0], {"account, N mm": ".0e", "s of rings": ".0f"})),
    ]
    text = (
        f"The sheet `corners` of the first section, whose right corner lets go at t = 0, and the same sheet hung by "
        f"its top in a gust of {PRESSURE:g} N/m2, half its weight, that grows in 0.03 s and stays until 0.09 s. Steps "
        f"of {1e3 * STEP:g} ms (BDF2, Euler's where rings lock). Rings in space; the disk has {CELLS} columns of "
        "elements. Ways of the mean place over the height of the sheet. `allowed`: the difference at rest and "
        f"{100.0 * TRAVEL:g} % of the way of the disk. `lost`: by locking and by the scheme "
        "until the end, part of the energy that weight and wind have given the disk at most."
    )
    held = [end for end in ends if end["beyond, %"] <= 0.0]
    conclusion = (
        f"{len(held)} of {len(ends)} runs stay within what is allowed at every step; the energy account of the rings "
        f"closes to {max(end['account, N mm'] for end in ends):.0e} N mm."
    )
    return Section("Rings and disk in motion", text, tuple(tables), (), conclusion)


def _compared(found: Row) -> tuple[list[Row], Row]:
    """Rows over time of one scene and size, and one of its end."""
    (t, rings, disk), share = found["places"], found["share"]
    disk = disk[: len(rings)]  # a run of rings may have ended before its time
    away, way = np.linalg.norm(rings - disk, axis=1), np.linalg.norm(disk - disk[0], axis=1)
    allowed, of = away[0] + TRAVEL * way, {"scene": found["scene"], "rings": found["rings"]}
    rows = [
        {
            **of,
            **{"t, s": t[i], "way of the disk, %": share * way[i]},
            **{"rings less disk, up, %": share * (rings - disk)[i, 1], "distance, %": share * away[i]},
            "allowed, %": share * allowed[i],
        }
        for i in range(0, len(t), SHOWN)
    ]
    end = of | {"until, s": t[-1], "beyond, %": share * float((away - allowed).max())}
    end |= {"lost, rings, %": found["lost"][0], "lost, disk, %": found["lost"][1]}
    return rows, end | {"account, N mm": found["account"], "s of rings": found["seconds"]}


def _forms(row: Row, own: dict[str, str]) -> dict[str, str]:
    return {key: ".2f" for key in row if key not in ("scene", "rings")} | own
