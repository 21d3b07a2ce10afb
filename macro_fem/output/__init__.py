"""Output of a solved curtain: files, pictures, and what is said of it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
"""The names for other folders, listed in `__init__.pyi`: their modules are imported when they are first used."""
