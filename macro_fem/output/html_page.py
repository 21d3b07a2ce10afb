"""Plotters of pyvista as one HTML file that turns in a browser without a network, by plotly with its script inside.

Hovering shows numbers, a click on the legend hides a part. The script is 5 MB of each file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from macro_fem.output.images import parts
from rve.common import JsonObject
from rve.common.drawing.plane import Scale
from rve.common.drawing.space import UNLISTED
from rve.common.errors import require
from rve.common.files import AnyPath, write_text
from rve.common.optional import Plotter
from rve.common.progress import tell
from rve.common.texts import digits

AXES = [2, 0, 1]
"""Our axes z, x, y as x, y, z of plotly, whose third axis points up."""
RIGHT = 0.92
"""Share of the page's width at which the scene ends; bars of colours stand left of it."""
LAYOUT: JsonObject = {"margin": {"l": 0, "r": 0, "b": 0, "t": 70}, "font": {"family": "sans-serif"}}
LEGEND = {"x": 0.01, "y": 0.98, "bgcolor": "rgba(255,255,255,0.7)"}
LIT = {"lighting": {"ambient": 0.6, "diffuse": 0.7, "specular": 0.1, "roughness": 0.6, "fresnel": 0.05}}


def check_page(purpose: str, instead: str = "ask for none") -> None:
    """InputError if plotly or pyvista is missing."""
    require("plotly", "pages", purpose, instead)
    require("pyvista", "pages", purpose, instead)


def write_page(path: AnyPath, draw: Callable[[], Plotter], title: str) -> None:
    """Write what is drawn beneath a title as one HTML file, atomically; InputError, before, if plotly is missing."""
    check_page(str(path))
    write_moments(path, [("", draw())], title)


def write_moments(path: AnyPath, moments: Iterable[tuple[str, Plotter]], title: str) -> None:
    """Write what a plotter shows at several moments, each with its name, as one HTML file with a slider, atomically.

    The plotter may be the same one, drawn anew for each moment.
    """
    import plotly.graph_objects as go

    figure, words, bounds = go.Figure(layout=LAYOUT), list[str](), []
    owner: list[int] = []  # moment of each trace
    scene: JsonObject = {}
    for word, plotter in moments:
        tell(f"writing {Path(path).name}{f', {word}' if word else ''}")
        for trace in _traces(plotter):
            figure.add_trace(trace | {"visible": not words})
            owner.append(len(words))
        words.append(word)
        bounds.append(np.reshape(plotter.renderers[0].bounds, (3, 2)))
        scene = scene or _scene(plotter)
    low, high = np.min(bounds, axis=0)[:, 0], np.max(bounds, axis=0)[:, 1]
    room = 0.02 * float((high - low).max())  # plotly cuts off what lies on the end of an axis, as a ground does
    for own, k in zip("xyz", AXES, strict=True):
        scene[f"{own}axis"]["range"] = [low[k] - room, high[k] + room]
    steps = [
        {"label": word, "method": "restyle", "args": [{"visible": [number == one for one in owner]}]}
        for number, word in enumerate(words)
    ]
    if len(steps) > 1:
        figure.update_layout(sliders=[{"steps": steps, "pad": {"l": 20, "r": 20, "b": 10}}])
    shown = escape(title, quote=False)
    figure.update_layout(title={"text": shown.replace("\n", "<br>"), "x": 0.01}, legend=LEGEND)
    figure.update_layout(scene=scene | {"domain": {"x": [0.0, RIGHT]}})
    settings = {"displaylogo": False, "responsive": True, "scrollZoom": True}
    text = figure.to_html(config=settings, include_plotlyjs=True, full_html=True, default_height="100vh")
    name = shown.replace("\n", " ")
    write_text(path, text.replace("<head>", f"<head><title>{name}</title><style>body{{margin:0}}</style>", 1))


def _traces(plotter: Plotter) -> Iterator[JsonObject]:
    """What a plotter shows, as traces of plotly."""
    for name, (mesh, actor, scale) in parts(plotter).items():
        prop, at = actor.prop, np.arange(mesh.n_points)
        if mesh.n_lines:  # a point that is no number after each line ends it in plotly
            k = mesh.lines[0]
            at = np.pad(mesh.lines.reshape(-1, k + 1)[:, 1:], ((0, 0), (0, 1)), mode="edge").ravel()
            line = {"color": prop.color.hex_rgb, "width": prop.line_width if scale is None else 2}
            trace: JsonObject = {"type": "scatter3d", "mode": "lines", "line": line, "connectgaps": False}
        else:
            mesh = mesh.triangulate()
            trace = dict(zip("ijk", np.asarray(mesh.regular_faces, np.int32).T, strict=True)) | LIT
            # a browser draws the triangles of transparent surfaces in any order: those nearly opaque are opaque
            opacity = prop.opacity if prop.opacity < 0.5 else 1.0
            trace |= {"type": "mesh3d", "color": prop.color.hex_rgb, "opacity": opacity, "showscale": False}
            trace |= {"hovertemplate": "%{y:.4g}, %{z:.4g}, %{x:.4g}"}
        points = np.asarray(mesh.points, np.float32)[at]
        if mesh.n_lines:
            points[k :: k + 1] = np.nan
        trace |= dict(zip("xyz", points[:, AXES].T, strict=True))
        trace |= {"name": escape(name, quote=False), "showlegend": name not in UNLISTED}
        if scale is not None:
            colours = _colours(np.asarray(mesh[scale.label], np.float32)[at], scale, bool(mesh.n_lines))
            trace |= colours | ({"line": trace["line"] | colours["line"]} if mesh.n_lines else {})
        yield trace


def _colours(values: Any, scale: Scale, of_lines: bool) -> JsonObject:
    """Values on a scale with its bar."""
    to_shown = np.log10 if scale.spread == "log" else np.asarray
    shown, (low, top) = to_shown(np.maximum(values, scale.low)), to_shown([scale.low, scale.top]).tolist()
    # Length of the strip of the colour above the scale, over that of the scale.
    share = 1.0 + (0.03 if scale.is_exceeded else 0.0)
    places = np.linspace(0.0, 1.0, 101)
    tones = [f"rgb({','.join(map(str, tone[:3]))})" for tone in scale.colour_map()(share * places, bytes=True)]
    colours = [*zip(places.tolist(), tones, strict=True)]
    bar: JsonObject = {"title": {"text": scale.title, "side": "right"}, "len": 0.7, "thickness": 18}
    bar |= {"x": RIGHT, "xanchor": "right"}
    if scale.spread == "log":
        ticks = np.linspace(low, top, 6)
        bar |= {"tickvals": ticks.tolist(), "ticktext": [digits(10.0**tick, 2) for tick in ticks]}
    found = {"colorscale": colours, "cmin": low, "cmax": low + share * (top - low), "colorbar": bar, "showscale": True}
    hover = {"hovertemplate": f"{scale.label}: %{{customdata:.4g}}<extra></extra>", "customdata": values}
    own = {"line": found | {"color": shown}} if of_lines else found | {"intensity": shown}
    return hover | {"showlegend": False} | own


def _scene(plotter: Plotter) -> JsonObject:
    renderer = plotter.renderers[0]
    sides = np.maximum(np.ptp(np.reshape(renderer.bounds, (3, 2)), axis=1), 1e-12)
    sides = np.maximum(sides, 1e-3 * sides.max())
    eye = np.array(renderer.camera.position) - np.array(renderer.camera.focal_point)
    eye *= 1.35 * np.linalg.norm(sides) / sides.prod() ** (1.0 / 3.0) / np.linalg.norm(eye)  # in plotly's unit
    axis = {"showbackground": False, "zeroline": False, "gridcolor": "#e3e6ea", "showspikes": False}
    return {
        "aspectmode": "data",
        "dragmode": "turntable",
        "camera": {"up": {"x": 0, "y": 0, "z": 1}, "eye": dict(zip("xyz", eye[AXES].tolist(), strict=True))},
        **{f"{own}axis": axis | {"title": {"text": f"{'xyz'[k]}, mm"}} for own, k in zip("xyz", AXES, strict=True)},
    }
