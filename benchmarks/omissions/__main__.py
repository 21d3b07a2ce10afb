"""Makes the report: `python -m benchmarks.omissions [--full] [--only SECTION] [--out FOLDER]`."""

from benchmarks.omissions import curtains, imports, motion, outputs, rings
from benchmarks.pages.model import Report
from benchmarks.pages.output import command

REPORT = Report(
    "omissions",
    "What a scene leaves out",
    "Every feature that costs time is tied to the scenes that need it. Which ones a run used, and why, `--explain` "
    "says; `--force FEATURE` puts one back in. Here each is forced on: the time without and with it, and what that "
    "changes.",
    "OMP_NUM_THREADS=1 python -m benchmarks.omissions",
)
MEASURES = {
    "motion": motion.measure,
    "rings": rings.measure,
    "curtains": curtains.measure,
    "outputs": outputs.measure,
    "imports": imports.measure,
}

main = command(REPORT, MEASURES)

if __name__ == "__main__":
    main()
