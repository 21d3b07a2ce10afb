from .equilibrated import at_dual_nodes as at_dual_nodes
from .equilibrated import dual_disc as dual_disc
from .equilibrated import dual_problem as dual_problem
from .interval import CurtainBounds as CurtainBounds
from .interval import admissible_problem as admissible_problem
from .interval import bound as bound
from .interval import loads_of as loads_of
from .interval import mark as mark
