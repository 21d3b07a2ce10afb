from .interval import CurtainBounds as CurtainBounds
from .interval import bound as bound
from .limit import CurtainLimit as CurtainLimit
from .limit import curtain_limit as curtain_limit
from .limit import limit_levels as limit_levels
