"""Numbers of the cards of gallery.md, by the default law: python docs/gallery_numbers.py [NAME]..."""

from __future__ import annotations

import re
import sys
import tempfile
from pathlib import Path
from typing import Any

import macro_fem

HERE = Path(__file__).parent
EXAMPLES = HERE.parent / "examples"


def numbers(told: dict[str, Any]) -> str:
    """What a card says of the summary of a curtain at rest."""
    forces = [one["largest_nodal_force_N"] for one in told["support_forces"]]
    said = [f"mesh {told['mass_kg']:.3g} kg", f"mean height {told['mean_height_mm']:.0f} mm"]
    said.append(f"largest force of a held node {max(forces):.3g} N")
    said += [f"{one['obstacle']} pushed by {norm(one['reaction_N']):.3g} N" for one in told.get("obstacles") or ()]
    if told["safety_factor"]:
        said.append(f"rings hold {told['safety_factor']:.3g} times the load")
    return ", ".join(said)


def norm(force: list[float]) -> float:
    """Size of a vector."""
    return float(sum(one**2 for one in force) ** 0.5)


def main(names: list[str]) -> None:
    """Solve the scenes and put their numbers below their pictures."""
    page = HERE / "gallery.md"
    for path in sorted(EXAMPLES.glob("*.toml")):
        if (names and path.stem not in names) or "[motion]" in path.read_text("utf-8"):
            continue
        with tempfile.TemporaryDirectory() as folder:
            told = macro_fem.run_scene(path, None, folder, picture=False)
        place = re.compile(rf"(!\[[^\n]*pictures/{path.stem}\.png\)\n)\n(?:\*\*Numbers\*\*[^\n]*\n\n)?")
        card = f"\n**Numbers**: {numbers(told)}.\n\n"
        page.write_text(place.sub(rf"\1{card}", page.read_text("utf-8")), "utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
