"""Makes the report: `python -m benchmarks.omissions [--full] [--only SECTION] [--out FOLDER]`."""

from benchmarks.omissions import curtains, imports, motion, outputs, rings
from benchmarks.report.files import command
from benchmarks.report.records import Report

REPORT = Report(
    "omissions",
    "What a scene leaves out",
    "Features that cost time run only in scenes that need them. `--explain` says which ones a run used, and why. "
    "Here each is switched on by the functions behind the commands: the time without and with it, and the change of "
    "the result.",
    "OMP_NUM_THREADS=1 python -m benchmarks.omissions",
)
SECTIONS = (motion, rings, curtains, outputs, imports)

main = command(REPORT, {module.__name__.split(".")[-1]: module.measure for module in SECTIONS})

if __name__ == "__main__":
    main()
