"""Pictures of curtains and rings in the documentation: python docs/pictures.py"""

import subprocess
import sys
import tempfile
from pathlib import Path

import pyvista
from PIL import Image

import macro_fem
import rve

HERE = Path(__file__).parent
ON_A_TRACK = macro_fem.Scene(
    macro_fem.Rectangle(400.0, 230.0),
    [macro_fem.Track(radius=130.0, angle=150.0, pitch=40.0, height=230.0)],
    macro_fem.Mesh(cells=24),
)
A_PIECE = macro_fem.Scene(macro_fem.Rectangle(120.0, 100.0), [macro_fem.Top()], macro_fem.Mesh(cells=4))


def put(picture: Path, path: Path, width: int = 1200) -> None:
    """The picture in a file of the documentation, of so many pixels and 256 colours, which are a tenth of its bytes."""
    whole = Image.open(picture).convert("RGB")
    small = whole.resize((width, round(width * whole.height / whole.width)), Image.Resampling.LANCZOS)
    small.quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=4).save(path, optimize=True)  # keeps colours of small parts


def weaves(path: Path) -> None:
    """A piece of every weave of the catalogue, slack, with wire of a half of the thickest, in two rows."""
    plotter = pyvista.Plotter(shape=(2, 3), off_screen=True, window_size=(1500, 1000), border=False)
    for number, (name, weave) in enumerate(rve.WEAVES.items()):
        plotter.subplot(*divmod(number, 3))
        piece = rve.Piece.cut(rve.Cell(5.0, 2.5 / weave.jamming_ratio, weave), (58.0, 50.0))
        points, quads = piece.rings.tubes(48, 16)
        tubes = pyvista.PolyData.from_regular_faces(points, quads.reshape(-1, 4))
        plotter.add_mesh(tubes, color="#b8bec6", smooth_shading=True, specular=0.6, specular_power=20.0)
        plotter.add_text(name, font_size=14, color="black")
        plotter.camera_position = "xy"
        plotter.camera.zoom(1.25)
    plotter.screenshot(path)


def main() -> None:
    """Solve both scenes and their rings, and put the pictures beside the pages."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        example = [sys.executable, HERE.parent / "examples" / "curtain.py", "--out", folder]  # README's first command
        subprocess.run(example, check=True)
        put(folder / "curtain" / "curtain.png", HERE / "curtain.png")
        macro_fem.localize(folder / "curtain").save(folder / "rings")
        put(folder / "rings" / "rings.png", HERE / "rings.png")
        macro_fem.solve(A_PIECE).rings().save(folder / "metal", picture=False, render=True)
        put(folder / "metal" / "render.png", HERE / "rings_metal.png", 640)
        macro_fem.solve(ON_A_TRACK).rings().save(folder / "space")
        put(folder / "space" / "rings.png", HERE / "rings_space.png")
        weaves(folder / "weaves.png")
        put(folder / "weaves.png", HERE / "weaves.png", 900)


if __name__ == "__main__":
    main()
