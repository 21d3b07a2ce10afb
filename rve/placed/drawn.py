"""Pictures of many rings, in the plane and in space, also as files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rve.common import Array
from rve.common.drawing import space
from rve.common.drawing.plane import Scale, new_axes, round_top
from rve.common.files import write_mesh_file
from rve.common.optional import Axes, Plotter
from rve.geometry.ring_pair import tangent_frame

ALONG, AROUND = 24, 8
"""Points along and around the wire of a ring in files: lines of 100,000 rings stay below 60 MB."""
MOST_FINE, MOST_TUBES, MOST_POINTS = 200, 1000, 300_000
"""Of a view these numbers of rings are fine tori, and coarse ones; more are lines with this many points together."""
NO_FORCE, METAL = "#808890", "#c9ced6"
THROWN, DARK = np.array([0.3, -0.4]), 0.5
"""Way of a shadow along and up the surface over the distance from it, and how dark it is at most."""


@dataclass(frozen=True, eq=False)
class DrawnRings:
    """Rings to draw: centre (n, 3) in mm, unit normal (n, 3), radii r1 and r2 (n,) or of all in mm, and the force (n,)
    in N by which they are coloured; None for grey rings. balls: names, centres (3,) and radii in mm of balls shown with
    them."""

    centre: Array
    normal: Array
    r1: Array | float
    r2: Array | float
    force: Array | None = None
    balls: tuple[tuple[str, Array, float], ...] = ()

    def circles(self, count: int) -> tuple[Array, Array]:
        """Points (n, count, 3) of the centre circles, and the unit vectors from the centre to them."""
        e1, e2 = tangent_frame(self.normal)
        t = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)[None, :, None]
        out = np.cos(t) * e1[:, None] + np.sin(t) * e2[:, None]
        return self.centre[:, None] + np.reshape(self.r1, (-1, 1, 1)) * out, out

    def closed_circles(self, count: int) -> Array:
        """Points (n, count + 1, 3) of the centre circles, the last one that of the beginning."""
        return self.circles(count)[0][:, [*range(count), 0]]

    def tubes(self, along: int, around: int) -> tuple[Array, NDArray[np.intp]]:
        """Points (p, 3) and quadrilaterals (n, along * around, 4) of tori."""
        line, out = self.circles(along)
        v = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)[:, None]
        around_wire = np.cos(v) * out[:, :, None] + np.sin(v) * self.normal[:, None, None]
        points = line[:, :, None] + np.reshape(self.r2, (-1, 1, 1, 1)) * around_wire
        here = np.arange(along)[:, None] * around + np.arange(around)
        ahead = np.roll(here, -1, axis=0)
        quads = np.stack([here, ahead, np.roll(ahead, -1, axis=1), np.roll(here, -1, axis=1)], axis=2).reshape(-1, 4)
        first = along * around * np.arange(len(self.centre))
        return points.reshape(-1, 3), quads[None] + first[:, None, None]

    def write_vtu(self, path: Path, data: Mapping[str, Array], *, tubes: bool = False, real: type = np.float32) -> None:
        """A VTU of the centre circles, each a line of `ALONG` cells, or of the tori, by meshio.

        data: numbers per ring (n,) or (n, w), which each cell of a ring has; real: type of numbers that are not whole.
        """
        import meshio

        points, cells = self.tubes(ALONG, AROUND)
        if not tubes:
            points, here = self.circles(ALONG)[0].reshape(-1, 3), np.arange(len(self.centre) * ALONG).reshape(-1, ALONG)
            cells = np.stack([here, np.roll(here, -1, axis=1)], axis=2)
        each: dict[str, list[NDArray[Any]]] = {}
        for name, values in data.items():
            kind = np.int32 if np.issubdtype(np.asarray(values).dtype, np.integer) else real
            each[name] = [np.repeat(np.asarray(values, kind), cells.shape[1], axis=0)]
        blocks = [("quad" if tubes else "line", cells.reshape(-1, cells.shape[2]).astype(np.int32))]
        write_mesh_file(path, meshio.Mesh(points.astype(real), blocks, cell_data=each))

    def plot(self, ax: Axes | None = None, *, width: float = 0.7, series: Sequence[DrawnRings] = ()) -> Axes:
        """Centre lines of the rings seen along z, on `ax` or axes of their own; series: as of `draw`."""
        ax = new_axes(7.0, 6.0) if ax is None else ax
        from matplotlib.collections import LineCollection
        from matplotlib.patches import Circle

        grey = "0.5" if self.force is None else None  # any colour that is given would hide those of the forces
        drawn = LineCollection(list(self.closed_circles(ALONG)[:, :, :2]), linewidths=width, colors=grey)
        if self.force is not None:
            scale = force_scale(series or (self,))
            drawn.set(array=np.maximum(self.force, scale.low), cmap=scale.colour_map(), norm=scale.norm())
            scale.add_bar(ax, shrink=0.75, pad=0.02)
        ax.add_collection(drawn)
        for _, centre, radius in self.balls:
            ax.add_patch(Circle((centre[0], centre[1]), radius, color=space.BODY, alpha=space.BODY_OPACITY))
        ax.set(xlabel="x, mm", ylabel="y, mm", aspect="equal", title=f"{len(self.centre)} rings")
        ax.autoscale_view()
        return ax

    def draw(self, plotter: Plotter | None = None, series: Sequence[DrawnRings] = ()) -> Plotter:
        """Draw the rings in space: tori where there are few, else centre lines. The plotter, by default a new one.

        series: the rings at several moments, which share colours and camera.
        """
        plotter = space.new_plotter() if plotter is None else plotter
        count = len(self.centre)
        if count <= MOST_TUBES:
            points, quads = self.tubes(*((36, 12) if count <= MOST_FINE else (20, 6)))
            mesh = space.surface(points, quads.reshape(-1, 4))
        else:
            mesh = space.lines(self.closed_circles(int(np.clip(MOST_POINTS // count, 8, ALONG))))
        colours: str | Scale = NO_FORCE
        if self.force is not None:
            colours = force_scale(series or (self,))
            mesh[colours.label] = np.repeat(self.force, mesh.n_points // count)
        space.add(plotter, "rings", mesh, colours, line_width=2)
        for name, centre, radius in self.balls:
            space.add(plotter, name, space.balls(centre, radius, 64), space.BODY, opacity=space.BODY_OPACITY)
        box = None
        if series:
            places = np.concatenate([rings.centre for rings in series])
            box = np.stack([places.min(axis=0) - np.max(self.r1), places.max(axis=0) + np.max(self.r1)])
        space.look(plotter, space.THREE_QUARTERS, box=box)
        return plotter

    def render(self) -> Plotter:
        """The rings as polished metal that lie before a white surface with their soft shadow on it, seen obliquely; the
        plotter."""
        import pyvista
        from scipy.ndimage import gaussian_filter

        plotter = space.new_plotter()
        points, quads = self.tubes(64, 20)
        r1 = float(np.max(self.r1))
        turn = space.sheet_axes(self.centre)
        right, up, front = turn
        plotter.add_mesh(
            space.surface(points, quads.reshape(-1, 4)), color=METAL, pbr=True, metallic=1.0, roughness=0.28,
            smooth_shading=True, reset_camera=False,
        )  # fmt: skip
        textured: Any = pyvista.Texture  # which has no types
        plotter.set_environment_texture(textured(_studio()), is_srgb=True)
        local = points @ turn.T
        low, high = local.min(axis=0), local.max(axis=0)
        back, room = low[2] - 0.1 * r1, 6.0 * r1
        thrown = local[:, :2] + (local[:, 2:] - back) * THROWN
        size = high[:2] - low[:2] + 2.0 * room
        bins = np.maximum((size / (0.05 * r1)).astype(int), 8)
        bins = np.minimum(bins, 2048)
        ends = np.stack([low[:2] - room, high[:2] + room], axis=1)
        counts = np.histogram2d(thrown[:, 0], thrown[:, 1], bins=bins.tolist(), range=ends)[0]
        dark = gaussian_filter((counts > 0).astype(float), 0.2 * r1 * bins / size)
        image = (255.0 * (1.0 - DARK * np.clip(dark, 0.0, 1.0))).astype(np.uint8).T[::-1]
        middle = np.array([*(0.5 * (low + high))[:2], back]) @ turn
        floor = pyvista.Plane(center=(0, 0, 0), direction=(0, 0, 1), i_size=size[0], j_size=size[1])
        floor.points = floor.points @ turn + middle
        plotter.add_mesh(
            floor, texture=textured(np.repeat(image[..., None], 3, axis=2)), reset_camera=False, **space.FLAT
        )
        box = np.stack([points.min(axis=0), points.max(axis=0)])
        space.look(plotter, 0.2 * right + 0.6 * up - front, up, box)
        return plotter


def _studio() -> NDArray[np.uint8]:
    """What metal mirrors: two bright lamps above in a grey room with a dark floor, in longitude and latitude."""
    height, around = np.mgrid[1.0:-1.0:128j, -np.pi : np.pi : 256j]
    room = 0.35 + 0.35 * height
    for at, wide in ((-0.9, 0.5), (1.3, 0.35)):
        room += 0.9 * np.exp(-(((around - at) / wide) ** 2) - ((height - 0.45) / 0.25) ** 2)
    return np.repeat((255.0 * np.clip(room, 0.03, 1.0)).astype(np.uint8)[..., None], 3, axis=2)


def force_scale(rings: Sequence[DrawnRings]) -> Scale:
    """Colours of contact forces in N by their logarithm; 0.2 % of the rings are above its round top end."""
    force = np.concatenate([part.force for part in rings if part.force is not None])
    largest = float(force.max(initial=0.0))
    top = round_top(max(float(np.quantile(force, 0.998)), 1e-12), largest)
    # The scale of contact forces begins at this part of its top end.
    return Scale("largest contact force on the ring, N", 3e-3 * top, top, largest, "log")
