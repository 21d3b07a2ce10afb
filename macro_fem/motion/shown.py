"""A frame of a curtain in motion as the record that pictures and files of curtains at rest are made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from macro_fem.fem.assembly import internal_force
from macro_fem.motion.pace import F
from macro_fem.motion.run import MotionFrame, MotionRun
from macro_fem.motion.stage import let_go
from macro_fem.scene.tables import Support
from macro_fem.solution import CurtainSolution, InnerForces
from macro_fem.solvers.status import Accuracy

MOST_SHOWN = 200
"""Frames of the series of VTUs at most."""


def as_solution(run: MotionRun, frame: MotionFrame) -> CurtainSolution:
    """The curtain at a frame, with balls as obstacles of the scene and without supports that have let go.

    Its load is what line loads and supports balance: outer forces, pushes, and those of inertia.
    """
    problem, n = frame.problem, frame.problem.disc.n_nodes
    gone = let_go(run.scene, frame.moment.t)
    kept = [item for number, item in enumerate(problem.scene.support) if number not in gone]
    scene = replace(problem.scene, items=(*kept, *(i for i in problem.scene.items if not isinstance(i, Support))))
    for ball, place in zip(run.bodies, frame.moment.x[n:], strict=True):
        scene = scene.beside("sphere", centre=place.tolist(), radius=ball.radius, name=ball.name)
    force = internal_force(problem.disc, frame.P) - frame.supports
    told = replace(problem, scene=scene, force=force, walls=None, winds=())
    inner, asked = InnerForces(frame.P, frame.S, 0.0, np.zeros(0)), Accuracy(1.0, 1.0, 1.0)
    return CurtainSolution(told, "converged", asked, frame.moment.x[:n], inner, 0.0, 0.0, frame.iterations, run.wall_s)


def chosen(frames: tuple[F, ...], most: int = MOST_SHOWN) -> list[F]:
    """At most so many frames, at times as even as the steps are, the first and the last among them."""
    t = np.array([frame.moment.t for frame in frames])
    which = np.arange(len(t))
    if len(t) > most:
        which = np.unique(np.abs(t[:, None] - np.linspace(t[0], t[-1], most)).argmin(axis=0))
    return [frames[k] for k in which]
