"""A ring-mesh curtain as a homogenized plane membrane."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rve.common.lazy import lazily

if TYPE_CHECKING:
    from macro_fem.job import CurtainResult as CurtainResult
    from macro_fem.job import run_scene as run_scene
    from macro_fem.job import solve as solve
    from macro_fem.scene.schema import Scene as Scene
    from macro_fem.scene.schema import load_scene as load_scene
    from macro_fem.scene.schema import read_scene as read_scene
    from macro_fem.solution import CurtainSolution as CurtainSolution

_MODULES = {
    "CurtainResult": "macro_fem.job",
    "CurtainSolution": "macro_fem.solution",
    "Scene": "macro_fem.scene.schema",
    "load_scene": "macro_fem.scene.schema",
    "read_scene": "macro_fem.scene.schema",
    "run_scene": "macro_fem.job",
    "solve": "macro_fem.job",
}
"""Public names and the modules that hold them: imported when they are first used."""

__all__ = ["CurtainResult", "CurtainSolution", "Scene", "load_scene", "read_scene", "run_scene", "solve"]

__getattr__, __dir__ = lazily(__name__, _MODULES)
