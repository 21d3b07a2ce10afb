"""Makes the report: `python -m benchmarks.stability [--full] [--only SECTION] [--out FOLDER]`."""

from benchmarks.report.files import command
from benchmarks.report.records import Report
from benchmarks.stability import cells, curtains, features, laws, loads, pairs, stepping

REPORT = Report(
    "stability",
    "Stability at the extremes",
    "What was tried, case by case, and what happened. A row says `converged`, or the status of the failure, or the "
    "sentence with which the input was refused: nothing fails silently. Residuals and gaps at the level of round-off "
    "are given by the power of ten that bounds them.",
    "OMP_NUM_THREADS=1 python -m benchmarks.stability",
)
SECTIONS = (stepping, cells, loads, pairs, laws, curtains, features)

main = command(REPORT, {module.__name__.split(".")[-1]: module.measure for module in SECTIONS})

if __name__ == "__main__":
    main()
