"""Export of a polyhedral law as a user material: Fortran source after the conventions of Abaqus/Standard.

NTENS = 3: membranes in plane stress with finite strain, STRESS = (11, 22, 12), engineering shear, DFGRD1 in the
material frame of the weave, consistent tangent of the Kirchhoff stress in the Jaumann rate. NTENS = 6: solids as
CalculiX hands them to materials named ABAQUSNL...: logarithmic strain, stress and tangent in the frame without
rotation; across the thickness a stiffness of its own, which the plane does not feel.
PROPS(1) is the nominal thickness (mm) by which line loads (N/mm) are divided; PROPS(2), if given, scales the stiffness;
PROPS(3) is a stiffness (N/mm) of slack mesh too in the first step, a hundredth of it in each further one.
The same source holds UMAT_USER, CalculiX's own interface for materials USER..., for whole sheets from a flat start
(`macro_fem deck`). Its locking surface is rounded by 3 % of strain, its kink smooth within 1 %.
`umat.f` beside this module is its source with @names@ for what a law fills in. Its iteration is that of
`homogenize.laws.geometry`, one point at a time. The stiffness is the law's constant one;
elastic curtains use that of each direction (`homogenize.elastic_law`).
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from homogenize.laws.geometry import OPTIONS, polyhedron_of
from homogenize.laws.net import STATED_STIFFNESS
from homogenize.laws.polyhedral import PolyhedralLaw
from homogenize.laws.protocol import MembraneLaw
from rve.common import Array, InputError, checked, filled, write_text

PER_STATEMENT = 38  # two a line: Fortran 77 takes 19 lines beside the first


def umat_source(law: MembraneLaw, title: str = "") -> str:
    """Fortran 77 source (fixed form) of the law; InputError for a law without half-spaces of its own."""
    if not isinstance(law, PolyhedralLaw):
        raise InputError(
            f"kind = {law.name}: only polyhedral laws are exported, fit one of kind refined, outer or inner"
        )
    body = polyhedron_of(law.S, law.h, law.stiffness)
    size = np.linalg.norm(body.normals, axis=1)
    planes = np.column_stack([body.normals, -body.h]) / size[:, None]
    blocks = [*data_statements("P", planes.ravel()), *data_statements("R", body.R.T.ravel())]
    fields = {
        "TITLE": title[:60],
        "DENSITY": "(its own)" if law.cell is None else f"{law.cell.areal_mass_kg_per_m2 * 1e-9:.9E}",
        "M": str(len(body.h)),
        "ROUNDS": str(OPTIONS.max_rounds),
        "TOLERANCE": f"{OPTIONS.tolerance / size.max():.1E}".replace("E", "D"),
        "SMALL": f"{OPTIONS.dependent**2:.3E}".replace("E", "D"),
        "DATA": "\n".join(blocks),
    }
    return filled(__package__, "umat.f", fields)


def even_law(law: MembraneLaw, turn: Array) -> MembraneLaw:
    """A polyhedral law in axes to which `turn` (3, 3) takes triples, as stiff in all directions; others as they are."""
    if not isinstance(law, PolyhedralLaw):
        return law
    even = STATED_STIFFNESS * np.eye(3)
    return replace(law, S=law.S @ turn.T, vertices=law.vertices @ turn.T, stiffness=even)


def data_statements(name: str, values: Array) -> list[str]:
    """Lines of DATA statements that fill the array `name` with values, every digit kept, in 72 columns."""
    lines: list[str] = []
    for start in range(0, len(values), PER_STATEMENT):
        part = values[start : start + PER_STATEMENT]
        lines.append(f"      DATA ({name}(I),I={start + 1},{start + len(part)})/")
        texts = [np.format_float_scientific(x, unique=True, trim="0").replace("e", "D") for x in part]
        for k in range(0, len(texts), 2):
            end = "/" if k + 2 >= len(texts) else ","
            lines.append("     1 " + ",".join(texts[k : k + 2]) + end)
    return lines


@checked
def write_umat(law: MembraneLaw, path: str | Path, title: str = "") -> None:
    """Writes the source of the law to `path` (atomic: the file is complete or absent)."""
    write_text(Path(path), umat_source(law, title))
