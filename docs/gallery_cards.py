"""Numbers and pictures of the cards of gallery.md, by the default law: python docs/gallery_cards.py [NAME]..."""

import re
import sys
import tempfile
from pathlib import Path
from typing import Any

from pictures import put

import macro_fem
from macro_fem.motion.files import run_motion

HERE = Path(__file__).parent
EXAMPLES = HERE.parent / "examples"


def numbers(told: dict[str, Any]) -> str:
    """What a card says of the summary of a curtain at rest or in motion."""
    if "reached_s" in told:
        return ", ".join(moving(told))
    forces = [one["largest_nodal_force_N"] for one in told["support_forces"]]
    said = [f"mesh {told['mass_kg']:.3g} kg", f"mean height {told['mean_height_mm']:.0f} mm"]
    said.append(f"largest nodal force {max(forces):.3g} N")
    said += [f"{one['obstacle']} pushed by {norm(one['reaction_N']):.3g} N" for one in told.get("obstacles") or ()]
    if told["safety_factor"]:
        said.append(f"safety factor {told['safety_factor']:.3g}")
    return ", ".join(said)


def moving(told: dict[str, Any]) -> list[str]:
    """What a card says of the summary of a curtain in motion."""
    most, at = told["peak_support_force_N"], told["peak_support_force_at_s"]
    said = [
        f"{told['reached_s']:.3g} s in {told['steps']} steps",
        f"lowest point at last {told['lowest_point_mm']:.0f} mm",
        f"supports together at most {most:.0f} N, at {at:.2f} s",
    ]
    if told["holds"] is not None:
        said.append(f"smallest factor {told['smallest_factor']:.3g}, at {told['at_s']:.2f} s")
    said += [f"{one['body']} leaves with {norm(one['velocity_mm_per_s']) / 1000:.2g} m/s" for one in told["bodies"]]
    return [*said, f"energy account within {told['account_error']:.0e}"]


def norm(force: list[float]) -> float:
    """Size of a vector."""
    return float(sum(one**2 for one in force) ** 0.5)


def main(names: list[str]) -> None:
    """Solve the scenes, and put their pictures on their cards with the numbers below."""
    page = HERE / "gallery.md"
    for path in sorted(EXAMPLES.glob("*.toml")):
        if names and path.stem not in names:
            continue
        with tempfile.TemporaryDirectory() as folder:
            run = run_motion if "[motion]" in path.read_text("utf-8") else macro_fem.run_scene
            told = run(path, None, Path(folder))
            put(*Path(folder).glob("*.png"), EXAMPLES / "pictures" / f"{path.stem}.png")
        place = re.compile(rf"(!\[[^\n]*pictures/{path.stem}\.png\)\n)\n(?:\*\*Numbers\*\*[^\n]*\n\n)?")
        card = f"\n**Numbers**: {numbers(told)}.\n\n"
        page.write_text(place.sub(rf"\1{card}", page.read_text("utf-8")), "utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
