"""Records as JSON, rows as CSV, and what notebooks show: the same text on every machine."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any


def json_text(record: Mapping[str, Any], indent: int = 2) -> str:
    """A record as JSON with a line end: arrays as lists, null for numbers that are not finite.

    >>> print(json_text({"force_N": [1.5, math.nan]}), end="")
    {
      "force_N": [
        1.5,
        null
      ]
    }
    """
    return json.dumps(_finite(record), indent=indent, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    value = value.tolist() if hasattr(value, "tolist") else value  # of numpy, which is not imported for this
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def csv_text(columns: Sequence[str], rows: Iterable[Iterable[Any]]) -> str:
    """Rows as CSV below a line of names.

    >>> print(csv_text(["cells", "pitch_mm"], [[9, None]]), end="")
    cells,pitch_mm
    9,
    """
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([columns, *rows])
    return text.getvalue()


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
