"""Pictures of curtains and rings in the documentation: python docs/pictures.py"""

import shutil
import tempfile
from pathlib import Path

import macro_fem

HERE = Path(__file__).parent
ON_A_TRACK = macro_fem.Scene(
    macro_fem.Rectangle(400.0, 230.0),
    [macro_fem.Track(radius=130.0, angle=150.0, pitch=40.0, height=230.0)],
    macro_fem.Mesh(cells=24),
)


def main() -> None:
    """Solve both scenes and their rings, and put the pictures beside the pages."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        answer = macro_fem.solve(macro_fem.Scene.rectangle(1000.0, 1000.0, cells=48).hung_by("corners"))
        answer.save(folder / "curtain")
        shutil.copyfile(folder / "curtain" / "curtain.png", HERE / "curtain.png")
        answer.rings().save(folder / "rings")
        shutil.copyfile(folder / "rings" / "rings.png", HERE / "rings.png")
        macro_fem.solve(ON_A_TRACK).rings().save(folder / "space")
        shutil.copyfile(folder / "space" / "rings.png", HERE / "rings_space.png")


if __name__ == "__main__":
    main()
