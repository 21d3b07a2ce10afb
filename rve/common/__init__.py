"""What all packages share: errors, files, jobs, checked values, symmetric tensors, versions, the ends of commands."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
"""The names that most modules need, listed in `__init__.pyi`: their modules are imported when they are first used."""
