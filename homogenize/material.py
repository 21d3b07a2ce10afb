"""Laws for rings of another material than that of their table."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar, cast

from homogenize.fitting.interval import LawInterval
from homogenize.laws.protocol import MembraneLaw
from homogenize.laws.stored import Law
from homogenize.laws.strength import MAKE_AGAIN
from rve.common import InputError, checked
from rve.common.materials import Material, material_of

Kind = TypeVar("Kind", bound=MembraneLaw | LawInterval)


@checked
def with_material(law: Kind, given: Mapping[str, Any], where: str = "") -> Kind:
    """The law for rings whose material is what `given` says, as `rve.common.materials.material_of` reads it.

    Without a named material `given` replaces values of the law's own. Yield stress, areal mass, and the stiffness if it
    is that of the rings, follow; strains of rigid rings do not depend on the material. Poisson's ratio of the table
    stays in the stiffness, where it acts on the torsion of the wire only. InputError for a law that does not know its
    rings' material, for values out of range and for a Poisson's ratio; `where` stands before the message.

    >>> from homogenize.io import default_law
    >>> law = with_material(default_law(), {"material": "titanium grade 2"})
    >>> round(law.cell.areal_mass_kg_per_m2 / default_law().cell.areal_mass_kg_per_m2, 4), law.strength.material.name
    (0.5745, 'titanium grade 2')
    """
    if not given:
        return law
    laws = (law.inner, law.law, law.outer) if isinstance(law, LawInterval) else (law,)
    old = next((one.cell.material for one in laws if one.cell is not None and one.cell.material is not None), None)
    if old is None:
        raise InputError(f"{where} needs a law that knows the material of its rings; {MAKE_AGAIN}".lstrip())
    if given.get("poisson") is not None:
        raise InputError(
            f"{where} poisson = {given['poisson']}: is that of the law's table, {old.poisson:g}; make the table again "
            "with rve table --rings --poisson".lstrip()
        )
    new = material_of(given, where, base=old)
    is_strong = any(isinstance(one, Law) and one.strength is not None for one in laws)
    if not is_strong and not {"yield", "ultimate"}.isdisjoint(given):
        raise InputError(f"{where} needs a law that knows the strength of its rings; {MAKE_AGAIN}".lstrip())
    changed = {id(one): _changed(one, old, new) for one in laws}
    if not isinstance(law, LawInterval):
        return cast("Kind", changed[id(law)])
    inner, own, outer = (changed[id(one)] for one in laws)
    return cast("Kind", replace(law, inner=inner, law=own, outer=outer))


def _changed(law: MembraneLaw, old: Material, new: Material) -> MembraneLaw:
    """The law with areal mass, strength and stiffness of rings of `new` in place of `old`."""
    if not isinstance(law, Law):
        return law
    softer, cell, known = old.young_N_per_mm2 / new.young_N_per_mm2, law.cell, law.strength
    if cell is not None:
        mass = cell.areal_mass_kg_per_m2 * new.density_kg_per_mm3 / old.density_kg_per_mm3
        cell = replace(cell, areal_mass_kg_per_m2=mass, material=new)
    if known is not None:
        known = replace(known, material=new, compliance=known.compliance * softer)
    return replace(law, cell=cell, strength=known).softer(softer)
