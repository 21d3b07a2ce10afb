"""Time of the direct solver by stages: `python -m benchmarks.profile_rve` writes docs/measured/profile_rve.md.

The paper's 190 load cases on one core, under the profiler of the standard library, which slows small calls.
"""

from functools import partial

from benchmarks.machine import ROOT
from benchmarks.problems import loads
from benchmarks.report.files import write_page
from benchmarks.report.measure import least_seconds, profiled
from benchmarks.report.records import Section, table
from rve.geometry.cell import Cell
from rve.solve import solve_table

STAGES = {
    "contact search: coarse samples and soft minima (`_samples`)": "_samples",
    "contact search: Newton polish (`_polish`)": "_polish",
    "contact search, all (`find_contacts`)": "find_contacts",
    "equations: gradients, Hessians, Jacobian (`assemble`)": "assemble",
    "Newton directions (`newton_direction`)": "newton_direction",
    "way between poses (`parallel_clearance`)": "parallel_clearance",
    "limits of free strains, all (`limit_equilibrium`)": "limit_equilibrium",
}
TITLE = "Where the direct solver spends its time"
TEXT = "The paper's 190 load cases, r1/r2 = 10. Shares are cumulative, so the stages overlap."
COMMAND = "OMP_NUM_THREADS=1 python -m benchmarks.profile_rve"


def measure() -> Section:
    """The shares of the stages."""
    given = loads()
    plain, inner = (least_seconds(partial(solve_table, Cell(), some))[1] for some in (given, loads(first_beta=5.0)))
    _, of = profiled(lambda: solve_table(Cell(), given))
    rows = []
    for title, name in STAGES.items():
        calls, share = of(name)
        rows.append({"stage": title, "calls": str(calls), "share": f"{100 * share:.0f} %"})
    text = (
        f"{plain:.2f} s on one core, of which the rows with beta = 0 take {plain - inner:.2f} s: six of them leave the "
        "strain free, and their limits are found by continuation."
    )
    conclusion = (
        "Contact search is the largest part: every pose of every case samples some ten pairs of rings at 48 angles, "
        "and soft minima at 97 more."
    )
    return Section("Stages", text, (table("", rows),), (), conclusion)


if __name__ == "__main__":
    write_page(ROOT / "docs" / "measured" / "profile_rve.md", TITLE, TEXT, COMMAND, measure)
