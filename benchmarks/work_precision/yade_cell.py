"""Eight rings of 4-in-1 in a periodic cell of Yade, pulled along the cell's axes: run by Yade's own Python.

    yade -x -n -j1 benchmarks/work_precision/yade_cell.py '{"spheres": 96, ...}'

A ring is a clump of spheres on its centre circle; the cell follows the wanted true stress (PeriTriaxController: a
Cauchy load on the current cell). Prints one line "RESULT {...}" with the sides of the cell in mm.
"""

import json
import sys
import time

import numpy as np
from yade import O, utils
from yade.wrapper import (
    Bo1_Sphere_Aabb,
    ForceResetter,
    FrictMat,
    Ig2_Sphere_Sphere_ScGeom,
    InsertionSortCollider,
    InteractionLoop,
    Ip2_FrictMat_FrictMat_FrictPhys,
    Law2_ScGeom_FrictPhys_CundallStrack,
    NewtonIntegrator,
    PeriTriaxController,
)

asked = json.loads(sys.argv[1])
r1, r2, (x2, y3), tilt = asked["r1"], asked["r2"], asked["lattice"], asked["tilt"]
O.periodic = True
# Two primitive cells each way: a ring must not meet its own image.
O.cell.setBox(2.0 * x2, 2.0 * y3, 8.0 * r1)
O.materials.append(FrictMat(young=asked["young"], poisson=0.3, frictionAngle=0.0, density=7800.0))
turn = 2.0 * np.pi * np.arange(asked["spheres"]) / asked["spheres"]
for row in range(4):
    lean = tilt if row % 2 == 0 else -tilt
    along_x, along_y = np.array([1.0, 0.0, 0.0]), np.array([0.0, np.cos(lean), -np.sin(lean)])
    for place in range(2):
        centre = np.array([(place + 0.25 + 0.5 * (row % 2)) * x2, (0.5 * row + 0.25) * y3, 4.0 * r1])
        points = [centre + r1 * (np.cos(t) * along_x + np.sin(t) * along_y) for t in turn]
        O.bodies.clump([O.bodies.append(utils.sphere(tuple(p), r2)) for p in points])

triax = PeriTriaxController(
    goal=(asked["stress"][0], asked["stress"][1], 0.0),
    stressMask=3,
    dynCell=True,
    mass=2e5,
    maxStrainRate=(0.05, 0.05, 0.0),
    maxUnbalanced=asked["tolerance"] / 10.0,
    relStressTol=asked["tolerance"],
    doneHook="finished()",
)
O.engines = [
    ForceResetter(),
    InsertionSortCollider([Bo1_Sphere_Aabb()]),
    InteractionLoop(
        [Ig2_Sphere_Sphere_ScGeom()], [Ip2_FrictMat_FrictMat_FrictPhys()], [Law2_ScGeom_FrictPhys_CundallStrack()]
    ),
    triax,
    NewtonIntegrator(damping=0.4),
]
O.dt = 0.3 * utils.PWaveTimeStep()
outcome = []


def finished():
    """What Yade calls when the stress is reached."""
    outcome.append("converged")
    O.pause()


began = time.process_time()
O.run(asked["steps"], True)
seconds = time.process_time() - began
size = O.cell.size
answer = {"status": outcome[0] if outcome else "step-limit", "steps": O.iter, "seconds": seconds}
answer.update(x2=size[0] / 2.0, y3=size[1] / 2.0, stress=[triax.stress[0], triax.stress[1]])
print("RESULT " + json.dumps(answer))
