"""Plugins: laws, supports, loads and materials of others, in a Python file or an installed package.

A class that names its `kind` makes itself known when its module is imported. `--plugin FILE.py` imports a file, in each
process that a command starts as well. The entry points of the group `ring_mesh.plugins` are imported where kinds are
looked up.
"""

import sys
from functools import cache
from hashlib import sha256
from importlib.metadata import entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from traceback import walk_tb
from typing import Any

from rve.common.errors import InputError
from rve.common.files import PLUGINS, AnyPath
from rve.common.texts import MOST_TOML_BYTES, read_bytes

GROUP = "ring_mesh.plugins"
PACKAGES = ("rve", "homogenize", "macro_fem")
REGISTERS: list[dict[str, type[Any]]] = []
"""What classes of plugins are known by, each by the words of files."""


def load_plugin(path: AnyPath) -> None:
    """Import a Python file, once unless it changes; InputError says what it raised."""
    place = Path(path).resolve()
    content = sha256(read_bytes(place, MOST_TOML_BYTES)).hexdigest()
    if PLUGINS.get(str(place)) == content:
        return
    name = f"{place.stem}_{sha256(str(place).encode()).hexdigest()[:8]}"  # the same in every process, for pickles
    spec = spec_from_file_location(name, place)
    if spec is None or spec.loader is None:
        raise InputError(f"--plugin = {path}: is no Python file, .py")
    sys.modules[name] = module_from_spec(spec)
    PLUGINS[str(place)] = content
    try:
        spec.loader.exec_module(sys.modules[name])
    except Exception as error:  # whatever the code of others raises
        at = place_in_plugin(error)
        del sys.modules[name], PLUGINS[str(place)]
        raise InputError(f"--plugin = {path}: {at and f'{at}: '}{type(error).__name__}: {error}") from error


def forget_plugins() -> None:
    """Let this process know no plugin file any more, so that the next one may take its words."""
    for kinds in REGISTERS:
        for kind, cls in list(kinds.items()):
            if getattr(sys.modules[cls.__module__], "__file__", None) in PLUGINS:
                del kinds[kind]
    PLUGINS.clear()


@cache
def load_installed() -> None:
    """Import the plugins of installed packages; InputError names one that cannot be."""
    for entry in entry_points(group=GROUP):
        try:
            entry.load()
        except Exception as error:  # whatever the code of others raises
            raise InputError(f"plugin {entry.name} = {entry.value}: {type(error).__name__}: {error}") from error


def place_in_plugin(error: BaseException) -> str:
    """File and line where a plugin raised an error, or called what did; "" if none had a part in it."""
    packages = {entry.module.partition(".")[0] for entry in entry_points(group=GROUP)}
    for frame, line in reversed([*walk_tb(error.__traceback__)]):
        file, module = frame.f_code.co_filename, str(frame.f_globals.get("__name__"))
        if file in PLUGINS or module.partition(".")[0] in packages:
            return f"{Path(file).name}, line {line}"
    return ""


def register(kinds: dict[str, type[Any]], kind: str, cls: type) -> None:
    """Make a class known by the word of files for it; InputError if that is another one's."""
    other = kinds.get(kind, cls)
    if (other.__module__, other.__qualname__) != (cls.__module__, cls.__qualname__):
        raise InputError(f"kind = {kind!r} of {cls.__name__}: is that of {other.__name__}; choose another word")
    kinds[kind] = cls
    if not any(kinds is one for one in REGISTERS):
        REGISTERS.append(kinds)


def plugin_of(cls: type) -> str | None:
    """The file or package that defines a class; None for one of this project."""
    top = cls.__module__.partition(".")[0]
    file = vars(sys.modules[cls.__module__]).get("__file__")
    if top in PACKAGES:
        return None
    return Path(file).name if file and (top == "__main__" or str(Path(file).resolve()) in PLUGINS) else top
