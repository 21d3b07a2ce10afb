"""Plotters of pyvista as one HTML file that turns in a browser without a network, by plotly with its script inside.

Hovering shows numbers, a click on the legend hides a part. The script is 5 MB of each file.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rve.common.drawing.scale import Scale
from rve.common.drawing.space import parts
from rve.common.errors import require
from rve.common.files import write_text
from rve.common.progress import tell

if TYPE_CHECKING:
    from pyvista import Plotter, PolyData

AXES = [2, 0, 1]
"""Our axes z, x, y as x, y, z of plotly, whose third axis points up."""
OVER_STRIP = 0.03
"""Length of the strip of the colour above the scale, over that of the scale."""
LAYOUT: dict[str, Any] = {"margin": {"l": 0, "r": 0, "b": 0, "t": 70}, "font": {"family": "sans-serif"}}
LIGHT = {"ambient": 0.6, "diffuse": 0.7, "specular": 0.1, "roughness": 0.6, "fresnel": 0.05}


def check_page(purpose: str = "a page", instead: str = "ask for none") -> None:
    """InputError if plotly or pyvista is missing."""
    require("plotly", "pages", purpose, instead)
    require("pyvista", "pages", purpose, instead)


def write_page(
    path: str | os.PathLike[str],
    plotter: Plotter,
    *titles: str,
    axes: tuple[tuple[str, str, str], ...] = (("x, mm", "y, mm", "z, mm"),) * 2,
) -> None:
    """Write the panels of a plotter side by side, each beneath its title, as one HTML file, atomically.

    axes: names of the three coordinates in each panel. InputError if plotly is missing.
    """
    check_page(str(path))
    tell(f"writing {Path(path).name}")
    import plotly.graph_objects as go

    count = len(plotter.renderers)
    figure = go.Figure(layout=LAYOUT)
    for panel, (title, names) in enumerate(zip(titles, axes, strict=False)):
        low, high, end = panel / count, (panel + 0.92) / count, f"{panel + 1}" if panel else ""
        for trace in _traces(plotter, panel, high):
            figure.add_trace(trace | {"scene": f"scene{end}", "legend": f"legend{end}"})
        figure.update_layout({f"scene{end}": _scene(plotter, panel, names, [low, high])})
        figure.update_layout({f"legend{end}": {"x": low + 0.01, "y": 0.98, "bgcolor": "rgba(255,255,255,0.7)"}})
        _add_title(figure, title, low + 0.01)
    _write(path, figure, titles[0])


def write_moments(path: str | os.PathLike[str], moments: Iterable[tuple[str, Plotter]], title: str) -> None:
    """Write what a plotter shows at several moments, each with its name, as one HTML file with a slider, atomically.

    The plotter may be the same one, drawn anew for each moment. InputError if plotly is missing.
    """
    check_page(str(path))
    import plotly.graph_objects as go

    figure, words, bounds = go.Figure(layout=LAYOUT), [], []
    first: dict[str, dict[str, Any]] = {}
    shown: list[set[int]] = []  # numbers of moments in which each trace is shown
    for number, (word, plotter) in enumerate(moments):
        tell(f"writing {Path(path).name}, {word}")
        if not number:
            figure.update_layout(scene=_scene(plotter, 0, ("x, mm", "y, mm", "z, mm"), [0.0, 0.92]))
        for trace in _traces(plotter, 0, 0.92):
            known = first.get(trace["name"])
            if known is not None and all(np.array_equal(known[key], trace[key], equal_nan=True) for key in "xyz"):
                shown[known["place"]].add(number)  # what stands still is in the file once
                continue
            if not number:
                first[trace["name"]] = trace | {"place": len(shown)}
            figure.add_trace(trace | {"visible": not number})
            shown.append({number})
        words.append(word)
        bounds.append(np.reshape(plotter.renderers[0].bounds, (3, 2)))
    low, high = np.min(bounds, axis=0)[:, 0], np.max(bounds, axis=0)[:, 1]
    ranges = {f"{own}axis": {"range": [low[k], high[k]]} for own, k in zip("xyz", AXES, strict=True)}
    steps = [
        {"label": word, "method": "restyle", "args": [{"visible": [number in one for one in shown]}]}
        for number, word in enumerate(words)
    ]
    figure.update_layout(legend={"x": 0.01, "y": 0.98, "bgcolor": "rgba(255,255,255,0.7)"})
    figure.update_layout(scene=ranges, sliders=[{"steps": steps, "pad": {"l": 20, "r": 20, "b": 10}}])
    _add_title(figure, title, 0.01)
    _write(path, figure, title)


def _traces(plotter: Plotter, panel: int, right: float) -> Iterator[dict[str, Any]]:
    """What a panel shows, as traces of plotly; bars of colours stand left of `right`."""
    for name, (mesh, actor, scale) in parts(plotter, panel).items():
        trace = _lines(mesh, actor) if mesh.n_lines else _surface(mesh, actor)
        trace |= _colours(mesh, scale, right) if scale is not None else {"showlegend": name[0] != "_"}
        yield trace | {"name": name}


def _add_title(figure: Any, title: str, left: float) -> None:
    place = {"x": left, "y": 1.0, "xref": "paper", "yref": "paper", "xanchor": "left", "yanchor": "bottom"}
    figure.add_annotation(text=_plain(title), align="left", showarrow=False, font_size=16, **place)


def _write(path: str | os.PathLike[str], figure: Any, title: str) -> None:
    settings = {"displaylogo": False, "responsive": True, "scrollZoom": True}
    text = figure.to_html(config=settings, include_plotlyjs=True, full_html=True, default_height="100vh")
    head = f"<head><title>{_plain(title, ' ')}</title><style>body{{margin:0}}</style>"
    write_text(path, text.replace("<head>", head, 1))


def _surface(mesh: PolyData, actor: Any) -> dict[str, Any]:
    mesh = mesh.triangulate()
    x, y, z = np.asarray(mesh.points, np.float32)[:, AXES].T
    i, j, k = np.asarray(mesh.regular_faces, np.int32).T
    # a browser draws the triangles of transparent surfaces in any order: those that are nearly opaque are opaque
    opacity = actor.prop.opacity if actor.prop.opacity < 0.5 else 1.0
    return {
        **{"type": "mesh3d", "x": x, "y": y, "z": z, "i": i, "j": j, "k": k, "showscale": False},
        **{"color": actor.prop.color.hex_rgb, "opacity": opacity, "lighting": LIGHT},
        **{"lightposition": {"x": 1e5, "y": 3e4, "z": 1e5}, "hovertemplate": "%{y:.4g}, %{z:.4g}, %{x:.4g}"},
    }


def _lines(mesh: PolyData, actor: Any) -> dict[str, Any]:
    """Lines with a point that is no number after each, which ends it in plotly."""
    cells = mesh.lines.reshape(-1, mesh.lines[0] + 1)[:, 1:]
    broken = np.full((len(cells), cells.shape[1] + 1, 3), np.nan, np.float32)
    broken[:, :-1] = mesh.points[cells]
    x, y, z = broken.reshape(-1, 3)[:, AXES].T
    line = {"color": actor.prop.color.hex_rgb, "width": actor.prop.line_width}
    return {"type": "scatter3d", "mode": "lines", "x": x, "y": y, "z": z, "line": line, "connectgaps": False}


def _colours(mesh: PolyData, scale: Scale, right: float) -> dict[str, Any]:
    """Values on a scale with its bar, which stands left of `right`."""
    values = np.asarray(mesh[scale.label], np.float32)
    is_log = scale.spread == "log"
    shown = np.log10(np.maximum(values, scale.low)) if is_log else values
    low, top = (np.log10([scale.low, scale.top]) if is_log else np.array([scale.low, scale.top])).tolist()
    share = 1.0 + (OVER_STRIP if scale.is_exceeded else 0.0)
    places = np.linspace(0.0, 1.0, 65)
    tones = [f"rgb({','.join(map(str, tone[:3]))})" for tone in scale.colour_map()(places, bytes=True)]
    colours = [*zip((places / share).tolist(), tones, strict=True)]
    colours += [(colours[-1][0], scale.over), (1.0, scale.over)] if scale.is_exceeded else []
    bar: dict[str, Any] = {"title": {"text": scale.title, "side": "right"}, "len": 0.7, "thickness": 18}
    bar |= {"x": right, "xanchor": "right"}
    if is_log:
        room = 0.1 * (top - low)  # numbers do not overlap
        powers = np.arange(np.ceil(low + room), np.floor(top - room) + 1)
        ticks = np.array([low, *powers, top])
        bar |= {"tickvals": ticks.tolist(), "ticktext": [f"{10.0**tick:.3g}" for tick in ticks]}
    found = {"colorscale": colours, "cmin": low, "cmax": low + share * (top - low), "colorbar": bar, "showscale": True}
    hover = {"hovertemplate": f"{scale.label}: %{{customdata:.4g}}<extra></extra>", "showlegend": False}
    if mesh.n_lines:
        n, k = len(mesh.lines) // (mesh.lines[0] + 1), mesh.lines[0]
        pad = lambda per_point: np.pad(per_point.reshape(n, k), ((0, 0), (0, 1)), mode="edge").ravel()  # noqa: E731
        return {"line": found | {"color": pad(shown), "width": 2}, "customdata": pad(values), **hover}
    return found | {"intensity": shown, "customdata": values, **hover}


def _scene(plotter: Plotter, panel: int, names: tuple[str, str, str], reach: list[float]) -> dict[str, Any]:
    renderer = plotter.renderers[panel]
    sides = np.maximum(np.ptp(np.reshape(renderer.bounds, (3, 2)), axis=1), 1e-12)
    sides = np.maximum(sides, 1e-3 * sides.max())
    eye = np.array(renderer.camera.position) - np.array(renderer.camera.focal_point)
    eye *= 1.35 * np.linalg.norm(sides) / sides.prod() ** (1.0 / 3.0) / np.linalg.norm(eye)  # in plotly's unit
    axis = {"showbackground": False, "zeroline": False, "gridcolor": "#e3e6ea", "showspikes": False}
    return {
        "domain": {"x": reach},
        "aspectmode": "data",
        "dragmode": "turntable",
        "camera": {"up": {"x": 0, "y": 0, "z": 1}, "eye": dict(zip("xyz", eye[AXES].tolist(), strict=True))},
        **{f"{own}axis": axis | {"title": {"text": names[k]}} for own, k in zip("xyz", AXES, strict=True)},
    }


def _plain(text: str, break_: str = "<br>") -> str:
    from html import escape

    return escape(text, quote=False).replace("\n", break_)
