"""What a solved curtain is looked at by: curtain.png, curtain.gif and curtain.html, in the plane or in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from macro_fem.output.space_view import Frame, curtain_view
from macro_fem.scene.schema import Scene
from macro_fem.solution import CurtainSolution
from rve.common.drawing.page import check_page, write_page
from rve.common.drawing.render import check_render, render
from rve.common.drawing.views import THREE_QUARTERS, View
from rve.common.errors import InputError, NotConverged, require
from rve.common.types import Array

PICTURE, ANIMATION, PAGE = "curtain.png", "curtain.gif", "curtain.html"


@dataclass(frozen=True)
class Looks:
    """Which pictures are wanted: curtain.png, curtain.gif of the load steps, curtain.html."""

    picture: bool = True
    animation: bool = False
    html: bool = False

    def check_packages(self) -> None:
        """InputError if a package is missing that pictures of every scene need."""
        for name in self._drawn:
            require("matplotlib", "plots", name, _instead(name))
        if self.html:
            check_page(PAGE, _instead(PAGE))

    def check(self, scene: Scene) -> None:
        """InputError, before anything is solved, for what is missing or makes no sense in this scene."""
        self.check_packages()
        if self.animation and scene.load.steps < 2:
            raise InputError(
                f"{scene.source}: [load] steps = 1: there is nothing to animate; set steps = 10 or leave out "
                "--animation"
            )
        if scene.in_space:
            for name in self._drawn:
                check_render(name, _instead(name))

    @property
    def _drawn(self) -> list[str]:
        return [name for name, asked in ((PICTURE, self.picture), (ANIMATION, self.animation)) if asked]


def _instead(name: str) -> str:
    """What to do without a picture."""
    return {PICTURE: "ask for --no-picture", ANIMATION: "leave out --animation", PAGE: "leave out --html"}[name]


def write_looks(
    folder: Path, steps: Sequence[CurtainSolution], wanted: Looks, error: Array | None = None
) -> str | None:
    """Write the wanted pictures into `folder`; `error`: density of the error of a plane curtain (n_cells,).

    Returns why a picture in space could not be drawn, None if all are there.
    """
    if wanted.html:
        write_page(folder / PAGE, curtain_view(steps[-1]))
    if not steps[-1].problem.scene.in_space:
        _plane(folder, steps, wanted, error)
        return None
    try:
        if wanted.picture:
            render(folder / PICTURE, [curtain_view(steps[-1])])
        if wanted.animation:
            render(folder / ANIMATION, frames(steps))
    except NotConverged as failure:
        return str(failure).removeprefix(f"{folder}/")
    return None


def frames(steps: Sequence[CurtainSolution]) -> list[View]:
    """Views of all load steps with one scale of colours, one box and one camera."""
    frame, made = Frame.of(steps), []
    for step in steps:
        view = curtain_view(step, frame)
        title = f"{100.0 * step.problem.factor:.0f} % of live loads and moves\n{view.title}"
        made.append(replace(view, title=title, cameras=(THREE_QUARTERS,)))
    return made


def _plane(folder: Path, steps: Sequence[CurtainSolution], wanted: Looks, error: Array | None) -> None:
    from macro_fem.output.plots import save_animation, save_picture

    if wanted.picture:
        save_picture(folder / PICTURE, steps[-1], error)
    if wanted.animation:
        save_animation(folder / ANIMATION, steps)
