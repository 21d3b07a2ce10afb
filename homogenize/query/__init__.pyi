from .answers import extrapolates as extrapolates
from .answers import strain_answer as strain_answer
from .answers import strength_answer as strength_answer
from .answers import support_answer as support_answer
from .strain import LockedStrain as LockedStrain
from .strain import StrainOptions as StrainOptions
from .strain import locked_strain as locked_strain
from .strain_bounds import strain_bounds as strain_bounds
