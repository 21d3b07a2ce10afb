"""Where the direct solver spends its time: `python -m benchmarks.profile_rve` writes docs/profile_rve.md.

The paper's 190 load cases on one core, under the profiler of the standard library (which itself slows small calls).
"""

from __future__ import annotations

import cProfile
import pstats
from pathlib import Path

import numpy as np

from benchmarks.machine import describe
from benchmarks.measured import least
from rve.ranges import grid
from rve.sweep import solve_table

TARGET = Path(__file__).resolve().parents[1] / "docs" / "profile_rve.md"
STAGES = {
    "contact search: coarse samples and soft minima (`_samples`)": "_samples",
    "contact search: Newton polish (`_polish`)": "_polish",
    "contact search, all (`find_contacts`)": "find_contacts",
    "equations: gradients, Hessians, Jacobian (`assemble`)": "assemble",
    "Newton directions (`newton_direction`)": "newton_direction",
    "way between poses (`parallel_clearance`)": "parallel_clearance",
    "limits of free strains, all (`limit_equilibrium`)": "limit_equilibrium",
}


def main() -> None:
    """Profile one table and write the shares."""
    loads = grid(np.arange(0.0, 46.0, 5.0), np.arange(0.0, 91.0, 5.0))
    inner = loads[0][loads[1] > 0.0], loads[1][loads[1] > 0.0]
    plain, without = least(lambda: solve_table(*loads)), least(lambda: solve_table(*inner))
    profile = cProfile.Profile()
    profile.enable()
    solve_table(*loads)
    profile.disable()
    stats = pstats.Stats(profile)
    total = stats.total_tt  # type: ignore[attr-defined]
    rows = []
    for title, name in STAGES.items():
        found = [entry for key, entry in stats.stats.items() if key[2] == name]  # type: ignore[attr-defined]
        calls, seconds = sum(entry[1] for entry in found), sum(entry[3] for entry in found)
        rows.append(f"| {title} | {calls} | {100 * seconds / total:.0f} % |")
    text = (
        "# Where the direct solver spends its time\n\nMade by `OMP_NUM_THREADS=1 python -m benchmarks.profile_rve`. "
        f"190 load cases, r1/r2 = 10: {plain:.2f} s on one core, of which the rows with beta = 0 take "
        f"{plain - without:.2f} s; six of them leave the strain free, and their limits are found by continuation. "
        "Shares are cumulative, so the stages overlap.\n\n| stage | calls | share |\n|---|---|---|\n" + "\n".join(rows)
    )
    text += (
        "\n\nContact search is the largest part: every pose of every case samples some ten pairs of rings at 48 "
        f"angles, and soft minima at 97 more.\n\n{describe()}\n"
    )
    TARGET.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
