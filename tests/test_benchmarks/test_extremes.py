"""The extremes of the stability report end as it says: solved, or with a named status or a sentence."""

import numpy as np
import pytest

from benchmarks import extremes as ex
from homogenize import default_law
from rve import InputError
from rve.common import SENTENCES
from rve.geometry import FOUR_IN_ONE, SIX_IN_ONE

LAW = default_law()


def assert_ends(row, cases, missed=0):
    """All cases but `missed` converge, without overlap; the others have a named status."""
    ends = {name: int(count) for count, name in (part.split() for part in row[ex.OUTCOME].split(", "))}
    assert sum(ends.values()) == cases
    assert set(ends) <= {*SENTENCES, "converged"}
    assert ends["converged"] >= cases - missed, row
    assert row["R"] < 1e-9
    assert row["overlap, mm"] < 1e-10


CELLS = [(FOUR_IN_ONE, ratio, 0) for ratio in (3.98093, 3.9811, 4.0, 5.0, 10.0)]
CELLS += [(SIX_IN_ONE, ratio, 0) for ratio in (5.9433, 6.0, 10.0)] + [
    (FOUR_IN_ONE, ratio, 3) for ratio in (20.0, 100.0)
]


@pytest.mark.release
@pytest.mark.parametrize(("weave", "ratio", "missed"), CELLS)
def test_cells_from_the_jamming_limit_to_thin_wire(weave, ratio, missed):
    row = ex.ratio_row(weave, ratio)
    assert_ends(row, 28, missed)
    assert row["contradicting rows"] == 0


@pytest.mark.release
@pytest.mark.parametrize(("name", "ratio"), [(name, ratio) for name in ex.RIMS for ratio in (10.0, 50.0)])
def test_loads_at_the_boundary_of_the_tensile_cone(name, ratio):
    assert_ends(ex.rim_row(name, ratio), 48)


@pytest.mark.parametrize(
    "count", [pytest.param(25, marks=pytest.mark.slow), pytest.param(100, marks=pytest.mark.release)]
)
def test_random_loads_are_seeded_and_solved(count):
    assert ex.random_rows(1, 5) == ex.random_rows(1, 5)
    for row in ex.random_rows(2, count):
        assert_ends(row, count, 1)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "changes"), list(ex.ladders())[::9])
def test_motions_lose_energy_and_keep_their_links(name, changes):
    row = ex.motion_row(name, changes, 200)
    assert row[ex.RISES]
    assert row["links intact"]
    assert {part.split()[1] for part in row[ex.OUTCOME].split(", ")} <= {"converged", "step-limit", "time-step"}


@pytest.mark.parametrize("name", ex.law_kinds())
def test_laws_are_finite_and_metric_everywhere(name):
    row = ex.law_row(name, ex.law_kinds()[name])
    assert row["all finite"]
    assert row["E - E* = A S"] < 1e-9


@pytest.mark.parametrize("law", ex.law_kinds().values(), ids=ex.law_kinds())
def test_laws_refuse_what_is_no_number(law):
    for function in (law.response, law.cut, law.support):
        with pytest.raises(InputError, match="finite numbers, row 0"):
            function(np.array([[np.nan, 0.0, 0.1]]))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ex.KINDS)
@pytest.mark.parametrize("name", ex.curtain_tables())
def test_curtains_are_solved_or_say_why_not(name, kind):
    row = ex.curtain_row(name, ex.curtain_tables()[name], LAW, kind)
    if (name, kind) == ("a point load of 1e+06 N", "plastic"):
        assert row[ex.STATUS] == "collapsed at 0.00014 of the loads"
    elif kind != "plastic" and name in ("corners drawn apart to 1.6", "corners drawn apart to 3"):
        assert row[ex.STATUS].startswith("infeasible: ")
    else:
        assert row[ex.STATUS] == "converged"
        assert np.isfinite(row[ex.HEIGHT])
