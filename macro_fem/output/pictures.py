"""Pictures of solved curtains: NAME.png, NAME.gif and NAME.html, in the plane or in space, of load steps or moments."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from macro_fem.output import plots
from macro_fem.output.space_view import Titled, draw_curtain, drawn, title
from macro_fem.scene.schema import Scene
from macro_fem.solution import CurtainSolution
from rve.common import InputError, check_out_file, require
from rve.common.drawing import space
from rve.common.drawing.page import check_page, write_page
from rve.common.drawing.plane import save_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NO_GIF = "leave out --animation"


@dataclass(frozen=True)
class Pictures:
    """Which pictures are wanted: STEM.png, STEM.gif of the load steps or moments, STEM.html; where a `report` as PDF
    and the outline of the flat sheet as `dxf` go."""

    picture: bool = True
    animation: bool = False
    html: bool = False
    report: Path | None = None
    dxf: Path | None = None
    stem: str = "curtain"

    def check(self, scene: Scene | None = None, inputs: Sequence[Path | None] = ()) -> None:
        """InputError, before anything is solved, for a package that is missing, a file that cannot be written or would
        overwrite one of `inputs`, and what makes no sense in this scene."""
        for is_asked, ending, instead in (
            (self.picture, "png", "ask for --no-picture"),
            (self.animation, "gif", NO_GIF),
        ):
            if is_asked:
                require("matplotlib", "plots", f"{self.stem}.{ending}", instead)
                if scene is not None and scene.in_space:
                    space.check_render(f"{self.stem}.{ending}", instead)
        if self.html:
            check_page(f"{self.stem}.html", "leave out --html")
        if self.animation and scene is not None and scene.load.steps < 2 and scene.motion is None:
            raise InputError(
                f"{scene.source}: [load] steps = 1: there is nothing to animate; set steps = 10 or {NO_GIF}"
            )
        for option, path, ending, package, extra in (
            ("--report", self.report, ".pdf", "matplotlib", "plots"),
            ("--dxf", self.dxf, ".dxf", "ezdxf", "cad"),
        ):
            if path is None:
                continue
            require(package, extra, option, "leave it out")
            check_out_file(path, option, inputs)
            if path.suffix.lower() != ending:
                raise InputError(f"{option} = {path}: give a name that ends in {ending}")


def write_pictures(folder: Path, steps: Sequence[CurtainSolution], wanted: Pictures) -> None:
    """Write the wanted pictures of the load steps into `folder`."""
    last = steps[-1]
    picture = folder / f"{wanted.stem}.png"
    if wanted.html:
        write_curtain_page(folder / f"{wanted.stem}.html", last)
    if wanted.picture and last.problem.scene.in_space:
        plotter = space.new_plotter(2)
        for panel, direction in enumerate((space.FRONT, space.THREE_QUARTERS)):
            plotter.subplot(0, panel)
            draw_curtain(last, plotter, direction=direction)
        space.save_picture(picture, plotter, title(last))
    elif wanted.picture:
        save_figure(picture, plots.panels(last))
    if wanted.animation:
        shares = [f"{100.0 * step.problem.factor:.0f} % of live loads and moves\n{title(step)}" for step in steps]
        space.save_animation(folder / f"{wanted.stem}.gif", figures(list(zip(shares, steps, strict=True))))


def write_curtain_page(path: str | Path, solution: CurtainSolution) -> None:
    """Write the curtain in space as one HTML file that turns in a browser; InputError if plotly is missing."""
    check_page(str(path))
    write_page(path, draw_curtain(solution), title(solution))


def figures(steps: Titled) -> Iterator[Figure]:
    """The curtain at each step as a figure, with one scale of colours and one camera."""
    if not steps[0][1].problem.scene.in_space:
        return plots.frames(steps)
    return (space.compose(one, words) for words, one in drawn(steps))
