"""From a strain-load table to a convex, tension-only membrane law."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rve.common.lazy import lazily

if TYPE_CHECKING:
    from homogenize.export.umat import write_umat as write_umat
    from homogenize.fitting.fit import FitOptions as FitOptions
    from homogenize.fitting.fit import FitResult as FitResult
    from homogenize.fitting.fit import cell_of as cell_of
    from homogenize.fitting.fit import fit as fit
    from homogenize.fitting.fit import fit_table as fit_table
    from homogenize.fitting.rows import Rows as Rows
    from homogenize.interval import LawInterval as LawInterval
    from homogenize.interval import interval_of_table as interval_of_table
    from homogenize.interval import interval_or_law as interval_or_law
    from homogenize.interval import law_interval as law_interval
    from homogenize.interval import read_law_interval as read_law_interval
    from homogenize.io import default_law as default_law
    from homogenize.io import load_law as load_law
    from homogenize.io import strength_of_law as strength_of_law
    from homogenize.laws.cloth import ClothLaw as ClothLaw
    from homogenize.laws.giving import GivingLaw as GivingLaw
    from homogenize.laws.giving import elastic_law as elastic_law
    from homogenize.laws.net import NetLaw as NetLaw
    from homogenize.laws.net import diagonal_net as diagonal_net
    from homogenize.laws.net import ring_net as ring_net
    from homogenize.laws.protocol import CellInfo as CellInfo
    from homogenize.laws.protocol import Cut as Cut
    from homogenize.laws.protocol import HalfSpaces as HalfSpaces
    from homogenize.laws.protocol import MembraneLaw as MembraneLaw
    from homogenize.laws.protocol import Response as Response
    from homogenize.laws.report import ErrorReport as ErrorReport
    from homogenize.laws.stored import save_law as save_law
    from homogenize.material import with_material as with_material
    from homogenize.query.strain import LockedStrain as LockedStrain
    from homogenize.query.strain import locked_strain as locked_strain
    from homogenize.strength import Strength as Strength
    from homogenize.strength import strength_of_table as strength_of_table

_MODULES = {
    "CellInfo": "homogenize.laws.protocol",
    "ClothLaw": "homogenize.laws.cloth",
    "Cut": "homogenize.laws.protocol",
    "ErrorReport": "homogenize.laws.report",
    "FitOptions": "homogenize.fitting.fit",
    "FitResult": "homogenize.fitting.fit",
    "GivingLaw": "homogenize.laws.giving",
    "HalfSpaces": "homogenize.laws.protocol",
    "LawInterval": "homogenize.interval",
    "LockedStrain": "homogenize.query.strain",
    "MembraneLaw": "homogenize.laws.protocol",
    "NetLaw": "homogenize.laws.net",
    "Response": "homogenize.laws.protocol",
    "Rows": "homogenize.fitting.rows",
    "Strength": "homogenize.strength",
    "cell_of": "homogenize.fitting.fit",
    "default_law": "homogenize.io",
    "elastic_law": "homogenize.laws.giving",
    "diagonal_net": "homogenize.laws.net",
    "fit": "homogenize.fitting.fit",
    "fit_table": "homogenize.fitting.fit",
    "interval_of_table": "homogenize.interval",
    "interval_or_law": "homogenize.interval",
    "law_interval": "homogenize.interval",
    "load_law": "homogenize.io",
    "locked_strain": "homogenize.query.strain",
    "read_law_interval": "homogenize.interval",
    "ring_net": "homogenize.laws.net",
    "save_law": "homogenize.laws.stored",
    "strength_of_law": "homogenize.io",
    "strength_of_table": "homogenize.strength",
    "with_material": "homogenize.material",
    "write_umat": "homogenize.export.umat",
}
"""Public names and the modules that hold them: imported when they are first used."""

__all__ = [
    "CellInfo",
    "ClothLaw",
    "Cut",
    "ErrorReport",
    "FitOptions",
    "FitResult",
    "GivingLaw",
    "HalfSpaces",
    "LawInterval",
    "LockedStrain",
    "MembraneLaw",
    "NetLaw",
    "Response",
    "Rows",
    "Strength",
    "cell_of",
    "default_law",
    "diagonal_net",
    "elastic_law",
    "fit",
    "fit_table",
    "interval_of_table",
    "interval_or_law",
    "law_interval",
    "load_law",
    "locked_strain",
    "read_law_interval",
    "ring_net",
    "save_law",
    "strength_of_law",
    "strength_of_table",
    "with_material",
    "write_umat",
]

__getattr__, __dir__ = lazily(__name__, _MODULES)
