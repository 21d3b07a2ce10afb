"""Public roots: the names that their stubs list, imported when they are first used, and where others are now."""

from collections.abc import Callable, Mapping
from typing import Any

import lazy_loader


def attach_root(
    package: str, file: str, moved: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """__getattr__, __dir__ and __all__ of a package; ImportError for a name that is `moved` to a face, with its place.

    moved: names, with blanks between them, by the face that lists them now.

    >>> attach_root("rve", __file__.replace("common/moved.py", "__init__.py"), {"rve.wire": "Ring"})[0]("Ring")
    Traceback (most recent call last):
    ...
    ImportError: rve.Ring is now rve.wire.Ring: write from rve.wire import Ring
    """
    public, names, listed = lazy_loader.attach_stub(package, file)
    faces = {name: face for face, words in moved.items() for name in words.split()}

    def get(name: str) -> Any:
        if name in faces:
            face = faces[name]
            raise ImportError(f"{package}.{name} is now {face}.{name}: write from {face} import {name}")
        return public(name)

    return get, names, listed
