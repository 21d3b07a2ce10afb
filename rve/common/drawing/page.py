"""Plotters of pyvista as one HTML file that turns in a browser without a network, by plotly with its script inside.

Hovering shows numbers, a click on the legend hides a part. The script is 5 MB of each file.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rve.common.drawing.scale import OVER, Scale
from rve.common.drawing.space import parts
from rve.common.errors import require
from rve.common.files import AnyPath, write_text
from rve.common.progress import tell

if TYPE_CHECKING:
    from pyvista import Plotter

AXES = [2, 0, 1]
"""Our axes z, x, y as x, y, z of plotly, whose third axis points up."""
OVER_STRIP = 0.03
"""Length of the strip of the colour above the scale, over that of the scale."""
LAYOUT: dict[str, Any] = {"margin": {"l": 0, "r": 0, "b": 0, "t": 70}, "font": {"family": "sans-serif"}}
LEGEND = {"x": 0.01, "y": 0.98, "bgcolor": "rgba(255,255,255,0.7)"}
LIT: dict[str, Any] = {
    "lighting": {"ambient": 0.6, "diffuse": 0.7, "specular": 0.1, "roughness": 0.6, "fresnel": 0.05},
    "lightposition": {"x": 1e5, "y": 3e4, "z": 1e5},
}


def check_page(purpose: str = "a page", instead: str = "ask for none") -> None:
    """InputError if plotly or pyvista is missing."""
    require("plotly", "pages", purpose, instead)
    require("pyvista", "pages", purpose, instead)


def write_page(
    path: AnyPath,
    plotter: Plotter,
    *titles: str,
    axes: tuple[tuple[str, str, str], ...] = (("x, mm", "y, mm", "z, mm"),) * 2,
) -> None:
    """Write the panels of a plotter side by side, each beneath its title, as one HTML file, atomically.

    axes: names of the three coordinates in each panel. InputError if plotly is missing.
    """
    figure, count = _new_figure(path), len(plotter.renderers)
    for panel, (title, names) in enumerate(zip(titles, axes, strict=False)):
        low, high, end = panel / count, (panel + 0.92) / count, f"{panel + 1}" if panel else ""
        for trace in _traces(plotter, panel, high):
            figure.add_trace(trace | {"scene": f"scene{end}", "legend": f"legend{end}"})
        scene = _scene(plotter, panel, names) | {"domain": {"x": [low, high]}}
        figure.update_layout({f"scene{end}": scene, f"legend{end}": LEGEND | {"x": low + 0.01}})
        _add_title(figure, title, low + 0.01)
    _write(path, figure, titles[0])


def write_moments(path: AnyPath, moments: Iterable[tuple[str, Plotter]], title: str) -> None:
    """Write what a plotter shows at several moments, each with its name, as one HTML file with a slider, atomically.

    The plotter may be the same one, drawn anew for each moment. InputError if plotly is missing.
    """
    figure, words, bounds = _new_figure(path), [], []
    owner: list[int] = []  # moment of each trace
    scene: dict[str, Any] = {}
    for number, (word, plotter) in enumerate(moments):
        tell(f"writing {Path(path).name}, {word}")
        for trace in _traces(plotter, 0, 0.92):
            figure.add_trace(trace | {"visible": not number})
            owner.append(number)
        words.append(word)
        bounds.append(np.reshape(plotter.renderers[0].bounds, (3, 2)))
        scene = scene or _scene(plotter, 0, ("x, mm", "y, mm", "z, mm"))
    low, high = np.min(bounds, axis=0)[:, 0], np.max(bounds, axis=0)[:, 1]
    for own, k in zip("xyz", AXES, strict=True):
        scene[f"{own}axis"]["range"] = [low[k], high[k]]
    steps = [
        {"label": word, "method": "restyle", "args": [{"visible": [number == one for one in owner]}]}
        for number, word in enumerate(words)
    ]
    sliders = [{"steps": steps, "pad": {"l": 20, "r": 20, "b": 10}}]
    figure.update_layout(scene=scene | {"domain": {"x": [0.0, 0.92]}}, legend=LEGEND, sliders=sliders)
    _add_title(figure, title, 0.01)
    _write(path, figure, title)


def _new_figure(path: AnyPath) -> Any:
    check_page(str(path))
    tell(f"writing {Path(path).name}")
    import plotly.graph_objects as go

    return go.Figure(layout=LAYOUT)


def _add_title(figure: Any, title: str, left: float) -> None:
    place = {"x": left, "y": 1.0, "xref": "paper", "yref": "paper", "xanchor": "left", "yanchor": "bottom"}
    text = escape(title, quote=False).replace("\n", "<br>")
    figure.add_annotation(text=text, align="left", showarrow=False, font_size=16, **place)


def _write(path: AnyPath, figure: Any, title: str) -> None:
    settings = {"displaylogo": False, "responsive": True, "scrollZoom": True}
    text = figure.to_html(config=settings, include_plotlyjs=True, full_html=True, default_height="100vh")
    name = escape(title, quote=False).replace("\n", " ")
    write_text(path, text.replace("<head>", f"<head><title>{name}</title><style>body{{margin:0}}</style>", 1))


def _traces(plotter: Plotter, panel: int, right: float) -> Iterator[dict[str, Any]]:
    """What a panel shows, as traces of plotly; bars of colours stand left of `right`."""
    for name, (mesh, actor, scale) in parts(plotter, panel).items():
        prop, at = actor.prop, np.arange(mesh.n_points)
        if mesh.n_lines:  # a point that is no number after each line ends it in plotly
            k = mesh.lines[0]
            at = np.pad(mesh.lines.reshape(-1, k + 1)[:, 1:], ((0, 0), (0, 1)), mode="edge").ravel()
            line = {"color": prop.color.hex_rgb, "width": prop.line_width if scale is None else 2}
            trace: dict[str, Any] = {"type": "scatter3d", "mode": "lines", "line": line, "connectgaps": False}
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
        trace |= dict(zip("xyz", points[:, AXES].T, strict=True)) | {"name": name, "showlegend": name[0] != "_"}
        if scale is not None:
            colours = _colours(np.asarray(mesh[scale.label], np.float32)[at], scale, right, bool(mesh.n_lines))
            trace |= colours | ({"line": trace["line"] | colours["line"]} if mesh.n_lines else {})
        yield trace


def _colours(values: Any, scale: Scale, right: float, of_lines: bool) -> dict[str, Any]:
    """Values on a scale with its bar, which stands left of `right`."""
    to_shown = np.log10 if scale.spread == "log" else np.asarray
    shown, (low, top) = to_shown(np.maximum(values, scale.low)), to_shown([scale.low, scale.top]).tolist()
    share = 1.0 + (OVER_STRIP if scale.is_exceeded else 0.0)
    places = np.linspace(0.0, 1.0, 65)
    tones = [f"rgb({','.join(map(str, tone[:3]))})" for tone in scale.colour_map()(places, bytes=True)]
    colours = [*zip((places / share).tolist(), tones, strict=True)]
    colours += [(colours[-1][0], OVER), (1.0, OVER)] if scale.is_exceeded else []
    bar: dict[str, Any] = {"title": {"text": scale.title, "side": "right"}, "len": 0.7, "thickness": 18}
    bar |= {"x": right, "xanchor": "right"}
    if scale.spread == "log":
        ticks = np.linspace(low, top, 6)
        bar |= {"tickvals": ticks.tolist(), "ticktext": [f"{10.0**tick:.2g}" for tick in ticks]}
    found = {"colorscale": colours, "cmin": low, "cmax": low + share * (top - low), "colorbar": bar, "showscale": True}
    hover = {"hovertemplate": f"{scale.label}: %{{customdata:.4g}}<extra></extra>", "customdata": values}
    own = {"line": found | {"color": shown}} if of_lines else found | {"intensity": shown}
    return hover | {"showlegend": False} | own


def _scene(plotter: Plotter, panel: int, names: tuple[str, str, str]) -> dict[str, Any]:
    renderer = plotter.renderers[panel]
    sides = np.maximum(np.ptp(np.reshape(renderer.bounds, (3, 2)), axis=1), 1e-12)
    sides = np.maximum(sides, 1e-3 * sides.max())
    eye = np.array(renderer.camera.position) - np.array(renderer.camera.focal_point)
    eye *= 1.35 * np.linalg.norm(sides) / sides.prod() ** (1.0 / 3.0) / np.linalg.norm(eye)  # in plotly's unit
    axis = {"showbackground": False, "zeroline": False, "gridcolor": "#e3e6ea", "showspikes": False}
    return {
        "aspectmode": "data",
        "dragmode": "turntable",
        "camera": {"up": {"x": 0, "y": 0, "z": 1}, "eye": dict(zip("xyz", eye[AXES].tolist(), strict=True))},
        **{f"{own}axis": axis | {"title": {"text": names[k]}} for own, k in zip("xyz", AXES, strict=True)},
    }
