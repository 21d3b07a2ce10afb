"""The law that ships inside the package, r1/r2 = 10: made from the 190-row table of the paper's grid by this module.

The table is one of `rve table --rings`, so that the law holds the strength of its rings. Its stiffness is the stated
one, of contacts: measurements and examples of elastic curtains refer to it.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from homogenize.fitting.fit import fit_table
from homogenize.laws.stored import law_record
from rve.common.storage.files import write_text

SHIPPED = Path(__file__).parents[1] / "data" / "rings_10.json"


def shipped_record(table: Path) -> dict[str, Any]:
    """What the shipped file holds if it is made from the table file `table`, without what differs between machines."""
    law = fit_table(table, stated_stiffness=True).law
    provenance = {key: value for key, value in law.provenance.items() if key not in ("python", "numpy")}
    return law_record(replace(law, provenance=provenance))


def ship(table: Path) -> Path:
    """Writes the shipped law from the table file `table`; returns where."""
    write_text(SHIPPED, json.dumps(shipped_record(table)) + "\n")
    return SHIPPED
