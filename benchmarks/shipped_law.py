"""The law that ships with the package, r1/r2 = 10: `python -m benchmarks.shipped_law TABLE` makes it anew.

TABLE has the 190 rows of the paper's grid, made with `rve table --rings`, so that the law holds the strength of its
rings. Its stiffness is the stated one, of contacts: measurements and examples of elastic curtains refer to it.
"""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from homogenize import fit_table
from homogenize.io import DEFAULT_LAW
from homogenize.laws import STATED_STIFFNESS, PolyhedralLaw, law_record


def shipped_record(table: Path) -> dict[str, Any]:
    """What the shipped file holds if it is made from the file `table`, without what differs between machines."""
    law = fit_table(table).law
    provenance = {key: value for key, value in law.provenance.items() if key not in ("python", "numpy", "scipy")}
    provenance["stiffness"] = f"stated: {STATED_STIFFNESS:g} N/mm for every strain, not from the table"
    stated = STATED_STIFFNESS * np.eye(3)
    assert isinstance(law, PolyhedralLaw)
    return law_record(replace(law, stiffness=stated, stiffness_is_measured=False, provenance=provenance))


if __name__ == "__main__":
    DEFAULT_LAW.write_text(json.dumps(shipped_record(Path(sys.argv[1]))) + "\n", encoding="utf-8")
