"""Names of scene files that have changed. Old ones are read for one version, with a warning that says the new one."""

from __future__ import annotations

import warnings
from typing import Any

from rve.common.errors import InputError, OldName

KEYS = {("curtain", "hang"): "weave_angle", ("solver", "spread"): "stabilising_tension"}
"""New name of a key by table and old name."""
VALUES = {("solver", "kind"): {"newton": "elastic", "conic": "clarabel"}}
"""New value by old value, of a key of a table."""
FORCE_IS_IDLE = "has no effect, as the solver decides which features to use; leave it out, --explain says what was used"
IDLE = {("solver", "force"): FORCE_IS_IDLE}
"""What is said of a key that is read and has no effect any more, by table and key."""


def with_new_names(data: dict[str, Any], source: object) -> dict[str, Any]:
    """The tables of a scene with old names replaced; warns with OldName if there are any.

    InputError if a key is given by its old and its new name.

    >>> with_new_names({"solver": {"kind": "elastic"}}, "scene.toml")
    {'solver': {'kind': 'elastic'}}
    """
    data = {name: dict(table) if isinstance(table, dict) else table for name, table in data.items()}
    found = []
    for (name, old), new in KEYS.items():
        table = data.get(name)
        if isinstance(table, dict) and old in table:
            if new in table:
                raise InputError(f"{source}: [{name}] {old} and {new}: are the old and the new name of one key")
            table[new] = table.pop(old)
            found.append(f"[{name}] {old} is now {new}")
    for (name, key), new_values in VALUES.items():
        table = data.get(name)
        value = table.get(key) if isinstance(table, dict) else None
        if isinstance(table, dict) and isinstance(value, str) and value in new_values:
            table[key] = new_values[value]
            found.append(f"[{name}] {key} = {value!r} is now {new_values[value]!r}")
    for (name, key), told in IDLE.items():
        table = data.get(name)
        if isinstance(table, dict) and table.pop(key, None) is not None:
            warnings.warn(f"{source}: [{name}] {key}: {told}", OldName, stacklevel=3)
    if found:
        message = f"{source}: {', '.join(found)}; the old names are read until the next version"
        warnings.warn(message, OldName, stacklevel=3)
    return data
