"""`python -m benchmarks.stability`: the extremes of rings, laws and curtains; writes docs/reports/stability.*."""

from __future__ import annotations

from benchmarks.pages.model import Report
from benchmarks.pages.output import command
from benchmarks.stability import cells, curtains, degenerate, features, laws, loads, stepping

REPORT = Report(
    "stability",
    "Stability at the extremes",
    "What was tried, case by case, and what happened. A row says `converged`, or the name of what went wrong, or the "
    "sentence with which the input was refused: nothing fails silently. Residuals and gaps that are round-off "
    "are given "
    "by the decade that bounds them.",
    "OMP_NUM_THREADS=1 python -m benchmarks.stability",
)

main = command(
    REPORT,
    {
        "stepping": stepping.measure,
        "cells": cells.measure,
        "loads": loads.measure,
        "pairs": degenerate.measure,
        "laws": laws.measure,
        "curtains": curtains.measure,
        "features": features.measure,
    },
)

if __name__ == "__main__":
    main()
