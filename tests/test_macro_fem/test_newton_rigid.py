"""The two solvers of the curtain have one limit: elastic minus rigid falls in proportion to the compliance."""

import numpy as np
import pytest

from homogenize.laws.net import ring_net
from homogenize.laws.protocol import CellInfo
from macro_fem.curtain import solve_scene
from macro_fem.fem.membrane import evaluate
from macro_fem.scene.schema import read_scene
from macro_fem.solvers.newton import Membrane, NewtonOptions, solve

RINGS = CellInfo(5.0, 0.5, 11.0, 12.646069623526, 2.785)


@pytest.mark.parametrize("kind", [{"kind": "top", "gather": 0.8}, {"kind": "corners"}])
def test_elastic_minus_rigid_is_proportional_to_the_compliance(scene_tables, kind):
    scene = read_scene(scene_tables(support=kind, mesh={"cells": 6, "element": "P1"}))
    rigid = solve_scene(scene, ring_net(RINGS))
    assert rigid.status == "converged"
    problem = rigid.problem
    X = problem.disc.nodes
    held = problem.supports.mask
    rigid_potential = -float((problem.force * (rigid.x - X)).sum())
    drops = []
    for stiffness in (1.0, 10.0, 100.0):
        law = ring_net(RINGS, stiffness)
        curtain = Membrane(problem.disc, law, held, np.where(held, rigid.x - X, 0.0), problem.force)
        elastic = solve(curtain, NewtonOptions(rtol=1e-10), start=rigid.x - X, stress=rigid.S)
        assert elastic.status.is_solution
        drops.append(rigid_potential - elastic.steps[-1].potential)
        # Compliance only ever lowers the minimum, and by no more than the rigid stress stores in it.
        borne = (
            0.5 * problem.disc.weight @ np.einsum("pi,i,pi->p", rigid.S, [1.0, 2.0, 1.0], rigid.S @ law.compliance.T)
        )
        assert -1e-9 * abs(rigid_potential) <= drops[-1]
        assert drops[-1] <= borne * (1.0 + 1e-6) + 1e-7 * abs(rigid_potential)
    np.testing.assert_allclose(np.array(drops[:-1]) / drops[1:], 10.0, rtol=0.03)
    S = evaluate(curtain, elastic.u).response.S
    total = problem.disc.weight @ rigid.S / problem.disc.weight.sum()
    np.testing.assert_allclose(
        problem.disc.weight @ S / problem.disc.weight.sum(), total, atol=0.02 * np.abs(total).max()
    )
