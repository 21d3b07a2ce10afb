"""The same cell and load in another solver, run through its public interface: MuJoCo.

It gets our slack pose and a load along the cell's axes (alpha = 0), where the cell stays a rectangle. MuJoCo has no
periodic cells: the ten rings of the paper are held by joints, and equality constraints tie ring (i, j) to i times one
lattice joint and j times the other, so that the line load acts on the current cell through those two joints. Contacts
are MuJoCo's own, of its exact torus (`mujoco.sdf.torus`) or of closed polygons of capsules, as stiff as it allows.
"""

import importlib.util
import itertools
import math
import time
from dataclasses import dataclass

import numpy as np

from rve.geometry.cell import Cell

TORUS = (
    '<extension><plugin plugin="mujoco.sdf.torus"><instance name="torus"><config key="radius1" value="{r1}"/>'
    '<config key="radius2" value="{r2}"/></instance></plugin></extension>'
    '<asset><mesh name="torus"><plugin instance="torus"/></mesh></asset>'
)


@dataclass(frozen=True)
class PeerAnswer:
    """Sides x2, y3 of the primitive cell in mm, how the run ended, its processor seconds and time steps."""

    status: str
    x2_mm: float
    y3_mm: float
    seconds: float
    steps: int


@dataclass(frozen=True)
class MujocoOptions:
    """`capsules` per ring, 0 for the torus; the run ends at rest (lattice speed below `rest` mm/s) or after `steps`.

    `load` in N/mm on rings of 1 kg with 1 kg/s of damping: small, so that contacts give by 1e-6 mm only.
    """

    capsules: int = 0
    steps: int = 4000
    dt: float = 0.01
    load: float = 1.0
    rest: float = 1e-6
    sdf_points: int = 40
    sdf_iterations: int = 10


def has_mujoco() -> bool:
    """Whether MuJoCo is installed."""
    return importlib.util.find_spec("mujoco") is not None


def run_mujoco(cell: Cell, stress: tuple[float, float], options: MujocoOptions) -> PeerAnswer:
    """The cell in MuJoCo under the Cauchy line loads `stress` along x and y; ImportError without mujoco."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(mujoco_xml(cell, options))
    data = mujoco.MjData(model)
    slot = [model.joint(name).dofadr[0] for name in ("X", "Y")]
    start = cell.r1 * cell.weave.start_lattice[:2]
    began = time.process_time()
    steps, block, status = 0, 50, "step-limit"
    while steps < options.steps:
        x2, y3 = start + data.qpos[slot]
        data.qfrc_applied[slot] = options.load * stress[0] * y3, options.load * stress[1] * x2
        mujoco.mj_step(model, data, block)
        steps += block
        way = np.abs(start + data.qpos[slot] - [x2, y3]).max()
        if steps > 10 * block and way < options.rest * block * options.dt:
            status = "converged"
            break
    seconds = time.process_time() - began
    x2, y3 = start + data.qpos[slot]
    return PeerAnswer(status, float(x2), float(y3), seconds, steps)


def mujoco_xml(cell: Cell, options: MujocoOptions) -> str:
    """The model: lattice joints X and Y, one body on slides for each ring, ties between lattice copies."""
    first: dict[int, str] = {}
    bodies: dict[int, list[str]] = {0: [], 1: []}
    ties = []
    for ring in cell.weave.rings.tolist():
        kind, i, j = ring
        name = f"ring{kind}{i}{j}"
        bodies[kind].append(_ring_body(name, ring, cell, options))
        ties += [_tie(name + axis, axis, copies) for axis, copies in (("X", i), ("Y", j)) if copies]
        if kind in first:
            ties += [_tie(name + tilt, first[kind] + tilt, 1) for tilt in ("u", "v")]
        first.setdefault(kind, name)
    x, y = cell.r1 * cell.weave.start_centres[1]
    light = '<inertial pos="0 0 0" mass="1e-3" diaginertia="1e-3 1e-3 1e-3"/>'
    slide = '<joint name="{}" type="slide" axis="{}"/>'
    world = "".join(
        f"<body>{light}{slide.format(name, axis)}</body>" for name, axis in (("X", "1 0 0"), ("Y", "0 1 0"))
    )
    offset = slide.format("cx", "1 0 0") + slide.format("cy", "0 1 0")
    rigid = f'solref="{2.0 * options.dt} 1" solimp="0.9999 0.9999 1e-3"'
    torus = TORUS.format(r1=cell.r1, r2=cell.r2) if options.capsules == 0 else ""
    return (
        f'<mujoco>{torus}<option gravity="0 0 0" timestep="{options.dt}" integrator="implicitfast" iterations="100" '
        f'tolerance="1e-12" sdf_initpoints="{options.sdf_points}" sdf_iterations="{options.sdf_iterations}"/>'
        f'<size memory="128M"/><default><geom condim="1" {rigid}/><equality {rigid}/></default>'
        f"<worldbody>{world}{''.join(bodies[0])}"
        f'<body pos="{x} {y} 0">{light}{offset}{"".join(bodies[1])}</body></worldbody>'
        f"<equality>{''.join(ties)}</equality></mujoco>"
    )


def _ring_body(name: str, ring: list[int], cell: Cell, options: MujocoOptions) -> str:
    """One ring: an outer body that slides with the lattice, an inner one that tilts about two diameters."""
    kind, i, j = ring
    x2, y3 = cell.r1 * cell.weave.start_lattice[:2]
    slides = "".join(
        f'<joint name="{name}{axis}" type="slide" axis="{way}" damping="1"/>'
        for axis, way, copies in (("X", "1 0 0", i), ("Y", "0 1 0", j))
        if copies
    )
    tilts = "".join(
        f'<joint name="{name}{tilt}" type="hinge" axis="{way}" damping="{cell.r1**2}"/>'
        for tilt, way in (("u", "1 0 0"), ("v", "0 1 0"))
    )
    lean = -math.degrees(_tilt(cell, kind))
    return (
        f'<body pos="{i * x2} {j * y3} 0">{slides}<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-6 1e-6 1e-6"/>'
        f'<body name="{name}" euler="{lean} 0 0">{tilts}{ring_shape(cell, options)}</body></body>'
    )


def ring_shape(cell: Cell, options: MujocoOptions) -> str:
    """The torus, or a polygon of capsules that lies as far inside the centre circle as outside."""
    n = options.capsules
    if n == 0:
        return '<geom type="sdf" mesh="torus" mass="1"><plugin instance="torus"/></geom>'
    corner = 2.0 * cell.r1 / (1.0 + math.cos(math.pi / n))
    turn = 2.0 * np.pi * (np.arange(n + 1) - 0.5) / n
    points = [f"{corner * math.cos(t):.12f} {corner * math.sin(t):.12f} 0" for t in turn]
    return "".join(
        f'<geom type="capsule" size="{cell.r2}" mass="{1.0 / n}" fromto="{a} {b}"/>'
        for a, b in itertools.pairwise(points)
    )


def _tie(joint: str, master: str, factor: int) -> str:
    return f'<joint joint1="{joint}" joint2="{master}" polycoef="0 {factor} 0 0 0"/>'


def _tilt(cell: Cell, kind: int) -> float:
    """Turn of ring `kind` about x in the slack pose: its normal is (0, sin, cos) of it."""
    _, y, z = cell.weave.start_normals[kind]
    return math.atan2(y, z)
