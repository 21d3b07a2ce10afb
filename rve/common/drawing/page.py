"""Views as one HTML file that turns in a browser without a network: plotly's writer with its script inside.

Plotly brings hover numbers, a bar of colours and a legend in which parts are switched on and off. The script is
5 MB of each file.
"""

from __future__ import annotations

import base64
import os
from pathlib import Path
from typing import Any

import numpy as np

from rve.common.drawing.views import Lines, Scale, Surface, View
from rve.common.errors import require
from rve.common.progress import tell
from rve.common.storage.files import write_text
from rve.common.types import Array

AXES = [2, 0, 1]
"""Our axes z, x, y as x, y, z of plotly, whose third axis points up."""
SEEN_THROUGH = 0.5
"""Surfaces more opaque than this are quite opaque: a browser draws the triangles of transparent ones in any order."""
LIGHT = {"ambient": 0.55, "diffuse": 0.7, "specular": 0.15, "roughness": 0.6, "fresnel": 0.05}


def check_page(purpose: str = "a page", instead: str = "ask for none") -> None:
    """InputError if plotly is missing."""
    require("plotly", "pages", purpose, instead)


def write_page(path: str | os.PathLike[str], view: View, *beside: View) -> None:
    """Write the view, and others beside it, as one HTML file, atomically; InputError if plotly is missing."""
    check_page(str(path))
    tell(f"writing {Path(path).name}")
    from plotly.io import to_html

    views = (view, *beside)
    settings = {"displaylogo": False, "responsive": True, "scrollZoom": True}
    traces = [trace for number in range(len(views)) for trace in _traces(views, number)]
    text = to_html(
        {"data": traces, "layout": _layout(views)},
        config=settings,
        include_plotlyjs=True,
        full_html=True,
        validate=False,
        default_height="100vh",
    )
    head = f'<head><title>{_plain(view.title)}</title><link rel="icon" href="data:,">'
    style = "<style>body{margin:0}</style>"
    write_text(path, text.replace("<head>", head + style, 1))


def _scene(number: int, kind: str = "scene") -> str:
    """Plotly's name of the scene, or of the legend, of a view."""
    return f"{kind}{number + 1}" if number else kind


def _traces(views: tuple[View, ...], number: int) -> list[dict[str, Any]]:
    view = views[number]
    traces = [_surface(part, view) if isinstance(part, Surface) else _lines(part, view.scale) for part in view.parts]
    coloured = [trace for trace, part in zip(traces, view.parts, strict=True) if part.values is not None]
    if coloured and view.scale is not None:
        first = coloured[0]
        target = first if first["type"] == "mesh3d" else first["line"]
        target |= {"showscale": True, "colorbar": _bar(view.scale) | {"x": (number + 1.0) / len(views)}}
        if len(views) > 1:
            target["colorbar"] |= {"xanchor": "right"}
    return [trace | {"scene": _scene(number), "legend": _scene(number, "legend")} for trace in traces]


def _place(view: View) -> str:
    """What hovering tells about a point: its coordinates in the order of their names."""
    own = dict(zip(AXES, "xyz", strict=True))  # plotly's letter of each of our axes
    told = sorted((name, own[axis]) for axis, name in enumerate(view.axes))
    return ", ".join(f"{name} %{{{letter}:.4g}}" for name, letter in told) + f" {view.unit}".rstrip()


def _surface(part: Surface, view: View) -> dict[str, Any]:
    scale = view.scale
    x, y, z = map(_packed, part.points.T)
    i, j, k = map(_packed, part.triangles.T)
    trace = {
        **{"type": "mesh3d", "name": part.name, "x": z, "y": x, "z": y, "i": i, "j": j, "k": k},
        **{
            "opacity": part.opacity if part.opacity < SEEN_THROUGH else 1.0,
            "showlegend": part.in_legend,
            "flatshading": not part.is_smooth,
            "showscale": False,
        },
        **{
            "lighting": _light(part),
            "color": part.colour,
            "hovertemplate": f"{_plain(part.name)}<br>{_place(view)}<extra></extra>",
            "lightposition": {"x": 1e5, "y": 3e4, "z": 1e5},
        },
    }
    if part.values is None or scale is None:
        return trace
    hover = f"{scale.label}: %{{customdata:.4g}}<br>{_place(view)}<extra></extra>"
    trace |= {"showlegend": False}  # the bar of colours tells what it is
    values = {"intensity": _packed(_shares(part.values, scale)), "customdata": _packed(part.values)}
    return trace | values | {"hovertemplate": hover} | _range(scale)


def _light(part: Surface) -> dict[str, float]:
    if not part.is_lit:
        return {"ambient": 1.0, "diffuse": 0.0, "specular": 0.0}
    return LIGHT if part.values is not None else LIGHT | {"ambient": 0.7}


def _lines(part: Lines, scale: Scale | None) -> dict[str, Any]:
    n, k = part.points.shape[:2]
    broken = np.full((n, k + 1, 3), np.nan)  # a point that is no number ends a line
    broken[:, :k] = part.points
    x, y, z = map(_packed, broken.reshape(-1, 3).T)
    line: dict[str, Any] = {"width": part.width, "color": part.colour}
    trace: dict[str, Any] = {"type": "scatter3d", "mode": "lines", "name": part.name, "x": z, "y": x, "z": y}
    trace |= {"line": line, "showlegend": part.in_legend, "hoverinfo": "name", "connectgaps": False}
    if part.values is None or scale is None:
        return trace
    values = np.repeat(part.values, k + 1)
    line |= {"color": _packed(_shares(values, scale)), "showscale": False} | _range(scale)
    hover = f"{scale.label}: %{{customdata:.4g}}<extra></extra>"
    return trace | {"customdata": _packed(values), "hovertemplate": hover, "showlegend": False}


def _packed(values: Array) -> dict[str, str]:
    """Numbers as plotly takes them in JSON: base64 of float32 or int32, a third of the bytes of digits."""
    kind = "i4" if np.issubdtype(np.asarray(values).dtype, np.integer) else "f4"
    return {"dtype": kind, "bdata": base64.b64encode(np.asarray(values).astype(f"<{kind}").tobytes()).decode()}


STRIP = 0.025
"""Length of the strip of the colour beyond the scale, over that of the scale."""


def _shares(values: Array, scale: Scale) -> Array:
    return np.clip(scale.share(values), 0.0, 1.0 + STRIP if scale.is_exceeded else 1.0)


def _range(scale: Scale) -> dict[str, Any]:
    """Colours over the share of the scale, with a strip of `over` at the end if values exceed it."""
    end = 1.0 + STRIP if scale.is_exceeded else 1.0
    at = np.linspace(0.0, 1.0 / end, len(scale.colours))
    colours = [[float(x), colour] for x, colour in zip(at, scale.colours, strict=True)]
    if scale.is_exceeded:
        colours += [[colours[-1][0], scale.over], [1.0, scale.over]]
    return {"cmin": 0.0, "cmax": end, "colorscale": colours}


def _bar(scale: Scale) -> dict[str, Any]:
    values = scale.ticks()
    text = scale.tick_labels()
    at = [float(x) for x in scale.share(np.array(values))]
    if scale.is_exceeded:
        at, text = [*at, 1.0 + STRIP], [*text[:-1], "", f"{text[-1]}; above: up to {scale.largest:.3g}"]
    return {
        "title": {"text": scale.label, "side": "right"},
        "tickvals": at,
        "ticktext": text,
        "len": 0.7,
        "thickness": 18,
        "x": 1.0,
    }


def _layout(views: tuple[View, ...]) -> dict[str, Any]:
    share = 1.0 / len(views)
    texts = []
    for number, view in enumerate(views):
        notes = "<br>".join(_plain(line) for line in view.notes)
        texts += [_text(notes, number * share + 0.01, -0.02, {"size": 12, "color": "#555"})]
        texts += [_text(_plain(view.title).replace("\n", "<br>"), number * share + 0.01, 1.0, {"size": 16})]
    lines = max(view.title.count("\n") for view in views) + 1
    return {
        "font": {"family": "sans-serif", "size": 13},
        "margin": {"l": 0, "r": 0, "t": 24 + 24 * lines, "b": 24 + 18 * max(len(view.notes) for view in views)},
        "annotations": texts,
        **{
            _scene(number, "legend"): {"x": number * share + 0.01, "y": 0.98, "bgcolor": "rgba(255,255,255,0.7)"}
            for number in range(len(views))
        },
        **{
            _scene(number): _scene_of(view, (number * share, (number + 0.94) * share))
            for number, view in enumerate(views)
        },
    }


def _text(text: str, x: float, y: float, font: dict[str, Any]) -> dict[str, Any]:
    """Text that begins at (x, y) of the page, below the line y = 0 or above y = 1."""
    place = {
        "x": x,
        "y": y,
        "xref": "paper",
        "yref": "paper",
        "xanchor": "left",
        "yanchor": "bottom" if y > 0 else "top",
    }
    return place | {"text": text, "align": "left", "showarrow": False, "font": font}


def _away(view: View) -> float:
    """How far the eye stands off, in plotly's unit: the geometric mean of the sides of the box around the view."""
    sides = np.maximum(np.ptp(view.box(), axis=0), 1e-12)
    sides = np.maximum(sides, 1e-3 * sides.max())
    return float(1.35 * np.linalg.norm(sides) / sides.prod() ** (1.0 / 3.0))


def _scene_of(view: View, reach: tuple[float, float]) -> dict[str, Any]:
    camera = view.cameras[-1]
    eye = -np.array(camera.direction)
    eye = _away(view) * eye[AXES] / np.linalg.norm(eye)
    axis = {"showbackground": False, "zeroline": False, "gridcolor": "#e3e6ea", "showspikes": False}
    names = [", ".join(filter(None, (view.axes[axis], view.unit))) for axis in AXES]
    return {
        "domain": {"x": list(reach)},
        "aspectmode": "data",
        "dragmode": "turntable",
        "camera": {
            "up": dict(zip("xyz", (0, 0, 1), strict=True)),
            "eye": dict(zip("xyz", map(float, eye), strict=True)),
        },
        **{f"{own}axis": axis | {"title": {"text": name}} for own, name in zip("xyz", names, strict=True)},
    }


def _plain(text: str) -> str:
    from html import escape

    return escape(text, quote=False)
