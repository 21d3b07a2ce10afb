from .interval import CurtainBounds as CurtainBounds
from .interval import bound as bound
