"""A solved curtain: the record that status, pictures and files are made of."""

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from macro_fem.curtain.problem import gathered_start, placed_obstacles
from macro_fem.curtain.state import CurtainState
from macro_fem.fem.assembly import internal_force, load_vector
from macro_fem.scene.obstacles import PlacedObstacle
from macro_fem.scene.support_kinds import Track
from macro_fem.solvers.cones import Cones, all_cuts, green_strain, least_slack
from macro_fem.solvers.status import FREE, ROUNDING, Evidence, Judged, Reach, Settling, Verdict, judged, load_scale
from rve.common import Array
from rve.geometry import padded


@dataclass(frozen=True, eq=False, kw_only=True)
class CurtainSolution(CurtainState, Judged):
    """The curtain at one load step.

    primal, dual: values of the potential -sum force . (x - X), N mm; `inner`: pushes of half-spaces too. Status and
    message follow from the rest: `stop` is why the solver stopped, `asked` what the numbers of an answer must not
    exceed, `reach` how much farther apart the supports could be, `relaxation` by how much the law was relaxed, whose
    bounds primal and dual then are; None for the law as it is. `second_step`: whether forces are those of elastic rings
    by a second step, and why; None where that is no question. `settling`: how far the rounds of
    `macro_fem.curtain.shape` have come, None where the problem is convex. tau (nq,): plastic work per area, N/mm, with
    what elastic strings store, None where rings do not flow; drawn: see `Evidence`.
    """

    stop: str
    asked: Evidence
    primal: float
    dual: float
    iterations: int
    wall_s: float
    reach: Reach = FREE
    relaxation: float | None = None
    cones: Cones | None = field(default=None, repr=False)
    second_step: tuple[bool, str] | None = None
    settling: Settling | None = None
    tau: Array | None = None
    drawn: float = 1.0

    @property
    def elastic(self) -> bool:
        """Whether P is the stress of the elastic law, else of ideal locking."""
        return self.problem.scene.solver.is_elastic

    tension = property(lambda self: self.inner.tension)
    wall_forces = property(lambda self: self.inner.wall_forces)

    @cached_property
    def evidence(self) -> Evidence:
        """The errors of this answer, from its own numbers and the solver's dual value."""
        return Evidence(self.relative_gap / self.drawn, self.residual / self.drawn, self._violation(), self.drawn)

    @cached_property
    def verdict(self) -> Verdict:
        asked = [track.fullness for track in self.problem.scene.of(Track) if track.fullness is not None]
        least = math.ceil(1e3 * max(asked, default=0.0) * (1.0 + self.reach.excess)) / 1e3
        remedy = f"a fullness of at least {least:g}" if asked else "a smaller gather"
        verdict = judged(self.stop, self.evidence, self.asked, self.iterations, self.reach, self.relaxation, remedy)
        return verdict if self.settling is None else self.settling.verdict(verdict)

    @property
    def plastic_work(self) -> float | None:
        """The energy in N mm that rings which flow have taken up; None where they do not flow."""
        return None if self.tau is None else float(self.problem.disc.weight @ self.tau)

    @property
    def relative_gap(self) -> float:
        """(primal - dual) / (total load times size): the error of the potential on the scale of the curtain."""
        return float((self.primal - self.dual) / (self._total * self.problem.mesh.size))

    @cached_property
    def residual(self) -> float:
        """Sum of the forces on free unknowns that do not balance, over the sum of the loads."""
        return float(np.abs(self.problem.fem.gather(self.unbalanced)).sum()) / self._total

    @cached_property
    def obstacles(self) -> list[PlacedObstacle]:
        return placed_obstacles(self.problem)

    @cached_property
    def pushed(self) -> Array:
        walls = self.problem.walls
        each = [np.where(walls.owner == one.number, self.wall_forces, 0.0) for one in self.obstacles]
        return np.reshape([walls.nodal(one) for one in each], (len(each), *self.x.shape))

    @property
    def blown(self) -> Array:
        problem = self.problem
        return problem.force - problem.dead if problem.winds else np.zeros_like(problem.dead)

    @cached_property
    def pushes(self) -> Array:
        """Forces of floors, walls and bodies on the nodes (n_nodes, d), N."""
        return self.problem.walls.nodal(self.wall_forces)

    @property
    def _total(self) -> float:
        return load_scale(self.problem.force, self.problem.disc.weight)

    def _violation(self) -> float:
        """Largest relative violation of the law; none where rings are elastic, which any strain goes with."""
        E = green_strain(self.F / (1.0 + (self.relaxation or 0.0)))
        if not (np.isfinite(E).all() and np.isfinite(self.P).all()):
            return np.inf
        crossed = -float(self.problem.walls.gap(self.x).min(initial=np.inf)) / self.problem.mesh.size
        can_stretch = self.elastic or self.problem.scene.solver.is_plastic
        return max(0.0, crossed) if can_stretch else max(-least_slack(self.problem.law, E), crossed)

    @property
    def stretch_excess(self) -> float:
        """Largest stretch anywhere beyond that at which the rings lock, relative; 0 where none is."""
        return float(self.stretch_beyond_locking.max())

    @cached_property
    def stretch_beyond_locking(self) -> Array:
        """Stretch at each point beyond that at which the rings lock, relative (nq,); 0 where none is."""
        cut = all_cuts(self.problem.law, self.E)
        return np.sqrt(1.0 + np.maximum(0.0, cut.violation / (cut.h + 0.5))) - 1.0

    @property
    def displacement(self) -> Array:
        """x - X (n_nodes, d), mm."""
        return self.x - self.problem.fem.reference

    @property
    def reactions(self) -> Array:
        """Forces of the supports on the curtain (n_nodes, d), N."""
        return self.problem.supports.carried(self.unbalanced)

    @cached_property
    def unbalanced(self) -> Array:
        """Inner forces less loads and pushes of obstacles at all nodes (n_nodes, d), N."""
        own = self.P - self.tension * self.problem.frame
        return internal_force(self.problem.disc, own) - self.problem.force - self.pushes

    @property
    def noise(self) -> float:
        """Force in N up to which this answer does not tell a force from none.

        The even tension presses the curtain on obstacles beside it with up to tension times size. At a relative gap g
        the solver's path pushes with up to about g of the load where nothing touches. Rounds leave their misfit.
        """
        errors = ROUNDING * self.drawn + abs(self.relative_gap) + self.residual
        errors += 0.0 if self.settling is None else self.settling.misfit
        return float(errors * self._total + 2.0 * self.tension * self.problem.mesh.size)

    def area_mean(self, values: Array) -> Array:
        """Mean of nodal values (n_nodes, ...) over the reference area."""
        return np.average(values, axis=0, weights=load_vector(self.problem.exact, np.array([1.0]))[:, 0])

    def mean_height(self) -> float:
        """Mean of y over the reference area, mm."""
        return float(self.area_mean(self.x[:, 1]))

    def sag(self) -> tuple[float, float] | None:
        """Displacement along the weight, the mean over the reference area and the largest, mm, of a sheet whose weight
        acts mostly along z; None of others."""
        weight = np.array(self.problem.scene.load.acceleration)
        if np.abs(weight).argmax() != 2:
            return None
        along = self.displacement @ (weight / np.linalg.norm(weight))
        return float(self.area_mean(along)), float(along.max())

    def lean(self) -> float:
        """How far the lower end hangs to the right of the upper one, mm: the mean over the reference area of the part
        of its upright lines along x, in space along its level lines, which follow a track; times its height."""
        F1, F2 = np.moveaxis(self.F, -1, 0)
        ahead = F1 if self.problem.fem.d == 3 else np.eye(2)[[0] * len(F1)]
        along = (ahead * F2).sum(axis=1) / np.maximum(np.linalg.norm(ahead, axis=1), 1e-300)
        return -self.problem.mesh.height * float(np.average(along, weights=self.problem.disc.weight))

    def places(self, X: Array) -> Array:
        """Where the points X (n, 2) in mm of the reference are, (n, 3) in mm, linear between the nodes.

        Points beside the mesh are where the nearest node is.
        """
        from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

        nodes = self.problem.disc.nodes
        x = LinearNDInterpolator(nodes, self.x)(X)
        lost = ~np.isfinite(x).all(axis=1)
        x[lost] = NearestNDInterpolator(nodes, self.x)(X[lost])
        return padded(x)


def slackened(solution: CurtainSolution, inward: float) -> Array:
    """Positions (n_nodes, d) of a curtain, drawn a little towards its slack start."""
    return solution.x + inward * (gathered_start(solution.problem) - solution.x)
