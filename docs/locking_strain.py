"""Locking strain against r1/r2, picture and table of locking_strain.md: python docs/locking_strain.py"""

import re
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import rve

HERE = Path(__file__).parent
RATIOS = {"4-in-1": (4, 4.5, 5, 6, 7, 8, 10, 12, 15, 20, 30), "6-in-1": (6, 6.5, 7, 8, 10, 12, 15, 20, 30)}
PULLS = {"across the grain": 0.0, "evenly": 45.0}
"""beta of the line loads; a pull along the grain gives the reference cell, where strains are zero or nearly so."""


def rows_of(weave: str) -> list[list[float]]:
    """r1/r2, sides of the reference cell over r1, and E11, E22 under each pull."""
    rows = []
    for ratio in RATIOS[weave]:
        cell = rve.Cell(r1=float(ratio), r2=1.0, weave=rve.WEAVES[weave])
        table = rve.solve_table(cell, ([0.0] * len(PULLS), list(PULLS.values())))
        assert (table.status == "converged").all(), (weave, ratio, table.status)
        sides = [side / ratio for side in table.cell.sides_mm]
        rows.append([ratio, *sides, *table.E[:, [0, 2]].ravel()])
    return rows


def draw(found: dict[str, list[list[float]]]) -> None:
    """Both strains over r1/r2, a panel for each weave."""
    fig, panels = plt.subplots(1, len(found), figsize=(9.0, 3.8), layout="constrained")
    for ax, (weave, rows) in zip(panels, found.items(), strict=True):
        x = np.array(rows)
        for k, (pull, colour) in enumerate(zip(PULLS, ("#c1121f", "#1f3fd0"), strict=True)):
            ax.plot(x[:, 0], x[:, 3 + 2 * k], "o-", ms=3.5, color=colour, label=f"$E_{{11}}$, pulled {pull}")
            ax.plot(x[:, 0], x[:, 4 + 2 * k], "s--", ms=3.5, color=colour, label=f"$E_{{22}}$, pulled {pull}")
        ax.axhline(0.0, color="0.6", lw=0.8)
        ax.set(title=weave, xlabel="$r_1/r_2$", ylabel="locking strain", xlim=(3.0, 31.0))
        ax.grid(alpha=0.35)
    panels[1].legend(fontsize=8, frameon=False, loc="upper left")
    fig.savefig(HERE / "locking_strain.svg", metadata={"Date": None})


def main() -> None:
    """Write the picture and the tables of the page."""
    page = HERE / "locking_strain.md"
    text = page.read_text("utf-8")
    found = {weave: rows_of(weave) for weave in RATIOS}
    for weave, rows in found.items():
        cells = [[f"{row[0]:g}", *(f"{round(value, 3) + 0.0:.3f}" for value in row[1:])] for row in rows]
        body = "".join(f"| {' | '.join(line)} |\n" for line in cells)
        text = re.sub(rf"(## {weave}\n\n(?:\|.*\n){{2}})(?:\|.*\n)*", rf"\g<1>{body}", text)
    page.write_text(text, "utf-8")
    with mpl.rc_context({"svg.hashsalt": "locking_strain"}):
        draw(found)


if __name__ == "__main__":
    main()
