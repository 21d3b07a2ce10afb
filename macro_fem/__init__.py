"""A ring-mesh curtain as a homogenized plane membrane."""

from rve.common.moved import attach_root

__getattr__, __dir__, __all__ = attach_root(
    __name__,
    __file__,
    {
        "macro_fem.curtain": "CurtainSolution",
        "macro_fem.rings": "Curtain RingField",
        "macro_fem.solvers": "Status",
    },
)
"""The public names, listed in `__init__.pyi`: their modules are imported when they are first used. Those that were
public in version 0.2 say where they are; the list goes with version 0.4."""
