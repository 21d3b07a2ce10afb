"""A support of one's own: the top edge on a rope that sags.

python -m macro_fem run SCENE --plugin examples/own_support.py --out FOLDER

    [support]
    kind = "rope"
    sag = 80.0
    gather = 0.95
"""

from dataclasses import dataclass

import numpy as np

from macro_fem import Support
from macro_fem.scene import Border, Held
from rve.common import Index


@dataclass(frozen=True)
class Rope(Support, kind="rope"):
    """The whole top edge on a parabola that sags by `sag` mm; `gather` draws its ends together.

    The fields are the keys of the scene file. `places` is that of every support, the edge as a whole: another one gives
    single points of the flat sheet, `Places(np.array([[x, y], ...]))`.
    """

    sag: float
    gather: float = 1.0

    def check(self) -> None:
        """Refuse, in one sentence, what makes no sense."""
        if not (self.sag >= 0.0 and self.gather > 0.0):
            self.refuse(f"sag = {self.sag:g}, gather = {self.gather:g}: must not be negative")

    def hold(self, border: Border, nodes: Index) -> Held:
        """Where the nodes of the edge, in their order, are held: mm, (n, 2) in the plane or (n, 3) in space."""
        place = border.points[nodes]
        x, middle = place[:, 0], 0.5 * np.sum(place[[0, -1], 0])
        along = (x - x[0]) / (x[-1] - x[0])
        y = place[:, 1] - 4.0 * self.sag * along * (1.0 - along)
        target = np.column_stack([middle + self.gather * (x - middle), y])
        return Held("rope", nodes, np.ones((len(nodes), 3), bool), np.pad(target, ((0, 0), (0, 1))))
