"""What rolling without friction leaves undetermined: motions of the rings that cost nothing, counted and named."""

from functools import partial

import numpy as np
from scipy.linalg import null_space

from benchmarks.every_ring.cases import SHEETS, Array, Sheet, Store, kept_rows
from benchmarks.every_ring.starts import slack_start, solved_from, task_of
from benchmarks.report.measure import Row
from benchmarks.report.records import Section, table
from macro_fem.every_ring import ring_scene
from rve.finite.equations import BLOCK, blocks, gradients
from rve.finite.records import Found, Task
from rve.finite.system import Pattern
from rve.finite.touching import Placed

LOADED = 1e-5
"""Contacts with less than this part of the largest force carry nothing."""
SOFT = 1e-7
"""Stiffness, over the largest, below which a motion costs nothing."""


def measure(full: bool, store: Store) -> Section:
    """The section."""
    sizes = (1, 2) if full else (1,)
    makes = {
        f"loose_{sheet.key}_{k}_{space}": partial(_row, sheet, k, space)
        for sheet in (SHEETS if full else SHEETS[:1])
        for k in sizes
        for space in (False, True)
    }
    rows = kept_rows(store, {}, makes)
    text = (
        "Motions that keep all loaded contacts closed, on which the second derivative of the potential (the curvature "
        f"of the contacts times their forces) is below {SOFT:g} of the largest. A ring has five coordinates; its spin "
        "about its own axis is none, since it moves no wire, so every ring has one more free motion than is counted. "
        "`loose rings` touch others without force: their centre and tilts are free as far as gaps allow. The other "
        "free motions are split by their squared size in r1 and radians: of tilts, and of centres along and across "
        "the plane; `rings in these`: rings that carry more than a hundredth of one, and those of them that link at "
        "most two others."
    )
    share = [row["free"] / row["coordinates"] for row in rows]
    conclusion = (
        f"Between {100 * min(share):.0f} and {100 * max(share):.0f} % of the coordinates are undetermined, besides the "
        "spin of every ring."
    )
    return Section("What is undetermined", text, (table("Free motions of the rings", rows, {}),), (), conclusion)


def _row(sheet: Sheet, k: int, space: bool) -> Row:
    rings = ring_scene(sheet.scene(k, 8))
    start = slack_start(rings)
    if space:
        rng = np.random.default_rng(0)
        start = Placed(start.x + np.where(rings.held, 0.0, 0.01 * rng.uniform(-1.0, 1.0, start.x.shape)), start.normal)
    found = solved_from(rings, start, space)
    return _counted(found, task_of(rings, space), sheet.key, space)


def _counted(found: Found, task: Task, scene: str, space: bool) -> Row:
    con, n = found.touching, len(task.force)
    G = gradients(found.placed, con)
    loaded = found.force > LOADED * found.force.max()
    pair = con.minima.pair
    touched = np.zeros(n, dtype=bool)
    touched[con.a[pair[loaded]]] = touched[con.b[pair[loaded]]] = True
    touched |= task.held[:, :2].any(axis=1)
    free = task.free & touched[:, None]
    dense = np.zeros((int(loaded.sum()), n, BLOCK))
    rows = np.arange(len(dense))
    for rings, sign, tilts in ((con.a, -1.0, slice(3, 5)), (con.b, 1.0, slice(5, 7))):
        dense[rows, rings[pair[loaded]], :3] = sign * G[loaded, :3]
        dense[rows, rings[pair[loaded]], 3:] = G[loaded, tilts]
    Z = null_space(dense[:, free], rcond=1e-9)
    K = blocks(found.placed, con, G, np.zeros(len(G)), np.where(loaded, found.force, 0.0), 0.0)
    H = Pattern.of(con, con.count > 0, free).matrix(K, np.zeros(free.shape)).toarray()
    values, vectors = np.linalg.eigh(Z.T @ H @ Z)
    soft = values < SOFT * max(float(np.abs(values).max(initial=0.0)), 1e-300)
    modes = np.zeros((n, BLOCK, int(soft.sum())))
    modes[free] = Z @ vectors[:, soft]
    part = modes**2
    loose = int((task.free & ~touched[:, None]).sum())
    return {
        "scene": scene,
        "centres": "space" if space else "plane",
        "status": found.status,
        "rings": n,
        "coordinates": int(task.free.sum()),
        "loaded contacts": int(loaded.sum()),
        "free": loose + int(soft.sum()),
        "of loose rings": loose,
        "loose rings": int((~touched).sum()),
        "others": int(soft.sum()),
        "rings in these": int((moving := part.sum(axis=(1, 2)) > 0.01).sum()),
        "with one or two links": int((moving & (np.bincount(task.linked.ravel(), minlength=n) <= 2)).sum()),
        "tilts, %": _percent(part[:, 3:], part),
        "centres in the plane, %": _percent(part[:, :2], part),
        "centres across, %": _percent(part[:, 2:3], part),
    }


def _percent(part: Array, whole: Array) -> float:
    return float(100.0 * part.sum() / max(float(whole.sum()), 1e-300))
