"""Rigid interlinked rings in a periodic cell: where a ring mesh locks under each load direction."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rve.common.lazy import lazily

if TYPE_CHECKING:
    from rve.common.errors import InputError as InputError
    from rve.common.errors import NotConverged as NotConverged
    from rve.common.materials import MATERIALS as MATERIALS
    from rve.common.materials import Material as Material
    from rve.common.materials import named_material as named_material
    from rve.directions import LoadDirections as LoadDirections
    from rve.directions import graded_grid as graded_grid
    from rve.directions import grid as grid
    from rve.directions import read_loads as read_loads
    from rve.equilibrium.interior_point import DirectOptions as DirectOptions
    from rve.finite.layout import FiniteMesh as FiniteMesh
    from rve.finite.layout import cell_of_sides as cell_of_sides
    from rve.finite.records import FiniteOptions as FiniteOptions
    from rve.finite.solution import FiniteSolution as FiniteSolution
    from rve.finite.walls import HalfSpace as HalfSpace
    from rve.geometry.cell import Cell as Cell
    from rve.geometry.kinematics import cauchy_line_load as cauchy_line_load
    from rve.geometry.kinematics import deformation_gradient as deformation_gradient
    from rve.geometry.kinematics import green_lagrange as green_lagrange
    from rve.geometry.kinematics import second_pk as second_pk
    from rve.geometry.weave import WEAVES as WEAVES
    from rve.geometry.weave import Weave as Weave
    from rve.localization.curtain import Curtain as Curtain
    from rve.localization.field import RingField as RingField
    from rve.localization.job import LocalizeOptions as LocalizeOptions
    from rve.localization.job import localize as localize
    from rve.more_columns import with_rings as with_rings
    from rve.solve import solve_table as solve_table
    from rve.support_function import Support as Support
    from rve.support_function import support as support
    from rve.table import StrainTable as StrainTable
    from rve.table import read_table as read_table
    from rve.table import write_table as write_table

_MODULES = {
    "Cell": "rve.geometry.cell",
    "Curtain": "rve.localization.curtain",
    "DirectOptions": "rve.equilibrium.interior_point",
    "FiniteMesh": "rve.finite.layout",
    "FiniteOptions": "rve.finite.records",
    "FiniteSolution": "rve.finite.solution",
    "HalfSpace": "rve.finite.walls",
    "InputError": "rve.common.errors",
    "LoadDirections": "rve.directions",
    "LocalizeOptions": "rve.localization.job",
    "MATERIALS": "rve.common.materials",
    "Material": "rve.common.materials",
    "NotConverged": "rve.common.errors",
    "RingField": "rve.localization.field",
    "StrainTable": "rve.table",
    "Support": "rve.support_function",
    "WEAVES": "rve.geometry.weave",
    "Weave": "rve.geometry.weave",
    "cauchy_line_load": "rve.geometry.kinematics",
    "cell_of_sides": "rve.finite.layout",
    "deformation_gradient": "rve.geometry.kinematics",
    "graded_grid": "rve.directions",
    "green_lagrange": "rve.geometry.kinematics",
    "grid": "rve.directions",
    "localize": "rve.localization.job",
    "named_material": "rve.common.materials",
    "read_loads": "rve.directions",
    "read_table": "rve.table",
    "second_pk": "rve.geometry.kinematics",
    "solve_table": "rve.solve",
    "support": "rve.support_function",
    "with_rings": "rve.more_columns",
    "write_table": "rve.table",
}
"""Public names and the modules that hold them: imported when they are first used."""

__all__ = [
    "MATERIALS",
    "WEAVES",
    "Cell",
    "Curtain",
    "DirectOptions",
    "FiniteMesh",
    "FiniteOptions",
    "FiniteSolution",
    "HalfSpace",
    "InputError",
    "LoadDirections",
    "LocalizeOptions",
    "Material",
    "NotConverged",
    "RingField",
    "StrainTable",
    "Support",
    "Weave",
    "cauchy_line_load",
    "cell_of_sides",
    "deformation_gradient",
    "graded_grid",
    "green_lagrange",
    "grid",
    "localize",
    "named_material",
    "read_loads",
    "read_table",
    "second_pk",
    "solve_table",
    "support",
    "with_rings",
    "write_table",
]

__getattr__, __dir__ = lazily(__name__, _MODULES)
