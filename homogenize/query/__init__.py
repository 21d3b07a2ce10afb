"""Questions to a law: the locked strain under a Cauchy load, its bounds, answers of the command line."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
"""The names for other packages, listed in `__init__.pyi`: their modules are imported when they are first used."""
