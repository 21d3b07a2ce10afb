"""Values and keys as error messages show them."""

from __future__ import annotations

import reprlib
from typing import Any

_short = reprlib.Repr()
_short.maxstring = _short.maxother = _short.maxlong = 80


def shown(value: Any) -> str:
    """A value as an error message shows it: its repr, cut to about a line however large or deep the value is."""
    text = _short.repr(value)
    return text if len(text) <= 160 else f"{text[:157]}..."


def shown_key(key: str) -> str:
    """A key as an error message shows it."""
    return key if key.isidentifier() and key.isascii() and len(key) <= 80 else shown(key)
