"""Fixed points of forces by Anderson's mixing, with a way back (D. G. Anderson, J. ACM 12, 1965).

Forces f are looked for that a map G leaves: G(f) - f = 0. The next ones are those at which the changes seen so far, if
they were linear, would cancel, plus a part of what then remains. Where a change is far larger than the least one, the
forces of that one are tried again with half the part, and all but the newest few are forgotten: the slope of G may be
far below -1, so that rounds swing between a curtain that flies and one that hangs.
"""

import numpy as np

from rve.common import Array

LEAST_PART = 0.02
"""Least part of a change that is taken. Less hardly moves."""
FAR = 2.0
"""Changes this many times the least one are not built upon. Smaller values go back from every detour."""
KEPT = 3
"""Rounds that are remembered on the way back."""
GROWTH = 1.3
"""How much larger the part becomes with every least change."""
FLAT = 1e-4
"""Relative singular values of changes that are noise. With 1e-8 mixed forces were noise of solvers, multiplied."""


class Mixer:
    """Forces (n_points, d) of `memory` rounds at points of the areas `weight` (n_points,), and the least changed ones.

    part: of a change that is taken at first and `most` later. `idle`: rounds since the change was least.
    """

    def __init__(self, weight: Array, memory: int, part: float, most: float) -> None:
        self.scale, self.memory = np.sqrt(weight)[:, None], memory
        self.part, self.most, self.idle = part, most, 0
        self.rounds: list[Array] = []  # forces and their changes (2, n_points, d)
        self.best: tuple[Array, Array] | None = None
        self.least = self.far = np.inf

    def next(self, force: Array, change: Array) -> Array:
        """The force (n_points, d) to try after one that the present shape would change by `change`."""
        size = float(np.linalg.norm(self.scale * change))
        if self.best is not None and size > self.far:
            return self._back()
        if size < self.least:
            self.least, self.best, self.idle = size, (force, change), 0
            self.part = min(self.most, GROWTH * self.part)
        else:
            self.idle += 1
        self.far = FAR * self.least
        self.rounds = [*self.rounds, np.stack([force, change])][-self.memory - 1 :]
        return self._mixed(force, change)

    def _back(self) -> Array:
        """The best forces and a smaller part of their change."""
        assert self.best is not None
        self.part = max(0.5 * self.part, LEAST_PART)
        self.far *= FAR
        self.idle += 1
        self.rounds = self.rounds[-KEPT:]
        return np.asarray(self.best[0] + self.part * self.best[1])

    def _mixed(self, force: Array, change: Array) -> Array:
        """Force and change less the sum of earlier ones that cancels the change best."""
        if len(self.rounds) == 1:
            return force + self.part * change
        df, dg = np.stack([self.rounds[-1] - before for before in self.rounds[:-1]], axis=-1)
        scaled = (self.scale[:, :, None] * dg).reshape(-1, dg.shape[-1])
        sizes = np.maximum(np.linalg.norm(scaled, axis=0), 1e-300)
        weights = np.linalg.lstsq(scaled / sizes, (self.scale * change).ravel(), rcond=FLAT)[0] / sizes
        return np.asarray(force + self.part * change - (df + self.part * dg) @ weights)
