"""Geometry of rings and cells: two tori in contact, contacts of a cell, poses, weaves, strain and line load."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
"""The names for other packages, listed in `__init__.pyi`: their modules are imported when they are first used."""
