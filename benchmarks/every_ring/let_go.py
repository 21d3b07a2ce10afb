"""Every ring in motion against the disk in motion: a sheet hung by its corners is let go at one of them."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.every_ring.cases import KEPT, SHEETS, kept_rows
from benchmarks.frame import Section, table
from benchmarks.measure import Row
from homogenize import default_law
from macro_fem import Motion, Point, Scene
from macro_fem.motion.files import account_error, row
from macro_fem.motion.run import solve_motion
from macro_fem.rings.motion import solve_ring_motion
from macro_fem.rings.motion_files import ring_row

DURATION, STEP, CELLS = 0.15, 5e-3, 16
"""Seconds, and cells of the disk across."""
SHOWN = 5
"""Every so many steps are listed."""
TRAVEL = 0.02
"""Part of the travel by which rings and disk may differ beyond their difference at rest."""


def measure(full: bool, store: Path = KEPT) -> Section:
    """The section."""
    rows, worst = [], []
    for k in (1, 2) if full else (1,):
        found = kept_rows(store, {"step": STEP}, {f"let_go_{k}": partial(_row, k)})[0]
        t, rings, disk = (np.array(found[f"_{name}"]) for name in ("t", "rings", "disk"))
        height = SHEETS[0].sides(k)[1]
        allowed = abs(rings[0] - disk[0]) + TRAVEL * np.abs(disk - disk[0])
        worst.append((found["rings"], float((np.abs(rings - disk) - allowed).max()) / height, found["account"]))
        rows += [
            {
                "rings": found["rings"],
                "t, s": t[i],
                "fallen, %": 100.0 * (disk[0] - disk[i]) / height,
                "rings less disk, %": 100.0 * (rings[i] - disk[i]) / height,
                "allowed, %": 100.0 * allowed[i] / height,
            }
            for i in range(0, len(t), SHOWN)
        ]
    text = (
        f"The sheet `corners` of the first section, in steps of {1e3 * STEP:g} ms (BDF2, Euler's where rings lock); "
        f"the right corner lets go at t = 0. Rings in space; the disk has {CELLS} columns of finite elements. Mean "
        "heights over the height of the sheet. `allowed`: the difference at rest and "
        f"{100.0 * TRAVEL:g} % of how far the disk has fallen."
    )
    forms = {"t, s": ".3f"} | dict.fromkeys(("fallen, %", "rings less disk, %", "allowed, %"), ".2f")
    conclusion = " ".join(
        f"{count} rings: {'within' if over <= 0.0 else f'{100.0 * over:.2f} % of the height beyond'} what is allowed "
        f"at every step; the energy account of the rings closes to {account:.0e}."
        for count, over, account in worst
    )
    return Section("A corner let go", text, (table("Mean height over time", rows, forms),), (), conclusion)


def _row(k: int) -> Row:
    """Times and mean heights of rings and disk, in mm."""
    W, H = SHEETS[0].sides(k)
    away = 0.5 * (1.0 - SHEETS[0].gather) * W
    corners = (Point((0.0, H), move=(away, 0.0)), Point((W, H), move=(-away, 0.0), release=0.0))
    sheet = Scene.rectangle(W, H, cells=CELLS)
    scene = replace(sheet, items=(*sheet.items, *corners), motion=Motion(DURATION, STEP))
    ring_run, disk_run = solve_ring_motion(scene), solve_motion(scene, default_law())
    rings = np.array([ring_row(frame) for frame in ring_run.frames])
    disk = np.array([row(disk_run, frame) for frame in disk_run.frames])
    return {
        "rings": len(ring_run.frames[0].rings.centre),
        "account": account_error(rings),
        "_t": rings[:, 0].tolist(),
        "_rings": rings[:, 2].tolist(),
        "_disk": disk[:, 2].tolist(),
    }
