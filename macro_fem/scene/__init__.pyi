from .meshing.edges import Border as Border
from .meshing.edges import Line as Line
from .support_kinds import Held as Held
from .support_kinds import Places as Places
