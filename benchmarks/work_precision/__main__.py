"""Makes the report: `python -m benchmarks.work_precision [--full] [--only SECTION] [--out FOLDER]`."""

from benchmarks.report.files import command
from benchmarks.report.records import Report
from benchmarks.work_precision import chain, contact, curtain, law, nested, rve

REPORT = Report(
    "work_precision",
    "Error against run time",
    "What an error costs, for every available method: locked strains, contact search, membrane laws, curtains, and "
    "the whole chain. All methods solve the same problem. Two independent methods agree on each reference. Failures "
    "stay in the tables. Times are processor times on one thread.",
    "OMP_NUM_THREADS=1 python -m benchmarks.work_precision",
)
SECTIONS = (rve, contact, law, curtain, nested, chain)

main = command(REPORT, {module.__name__.split(".")[-1]: module.measure for module in SECTIONS})

if __name__ == "__main__":
    main()
