"""What a notebook shows of a record: a sentence, lines, and a table of its numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape
from typing import Any


def as_html(title: object, values: Mapping[str, Any] | None = None, lines: Iterable[str] = ()) -> str:
    """A paragraph with the title, a list of lines, and a table of those values that are single numbers or words.

    >>> as_html("Ring of 5 < 6 mm", {"r1_mm": 5.0, "path": [1, 2]})
    '<p>Ring of 5 &lt; 6 mm</p><table><tr><th>r1_mm</th><td>5</td></tr></table>'
    """
    html = f"<p>{escape(str(title))}</p>"
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    single = {key: value for key, value in (values or {}).items() if isinstance(value, str | int | float)}
    rows = "".join(f"<tr><th>{escape(key)}</th><td>{escape(_text(one))}</td></tr>" for key, one in single.items())
    return html + (f"<ul>{items}</ul>" if items else "") + (f"<table>{rows}</table>" if rows else "")


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
