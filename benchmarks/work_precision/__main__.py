"""Makes the report: `python -m benchmarks.work_precision [--full] [--only SECTION] [--out FOLDER]`."""

from benchmarks.pages.model import Report
from benchmarks.pages.output import command
from benchmarks.work_precision import chain, contact, curtain, law, rve

REPORT = Report(
    "work_precision",
    "Error against run time",
    "What an error costs, for every method at hand: locked strains, contact search, membrane laws, curtains, and the "
    "whole chain. Problems are the same for all methods, references agree by two of them, and failures stay in the "
    "tables. Times are processor times on one thread.",
    "OMP_NUM_THREADS=1 python -m benchmarks.work_precision",
)
MEASURES = {
    "rve": rve.measure,
    "contact": contact.measure,
    "law": law.measure,
    "curtain": curtain.measure,
    "chain": chain.measure,
}

main = command(REPORT, MEASURES)

if __name__ == "__main__":
    main()
