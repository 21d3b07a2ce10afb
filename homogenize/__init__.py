"""From a strain-load table to a convex, tension-only membrane law."""

from rve.common.moved import attach_root

__getattr__, __dir__, __all__ = attach_root(
    __name__,
    __file__,
    {
        "homogenize.export": "write_umat",
        "homogenize.fitting": "FitResult cell_of interval_of_table interval_or_law law_interval",
        "homogenize.laws": "Cut ErrorReport GivingLaw HalfSpaces LockedRows NetLaw Response Strength strength_of_law "
        "strength_of_table",
        "homogenize.query": "LockedStrain",
        "rve.geometry": "CellInfo",
    },
)
"""The public names, listed in `__init__.pyi`: their modules are imported when they are first used. Those that were
public in version 0.2 say where they are; the list goes with version 0.4."""
