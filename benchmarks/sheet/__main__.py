"""One code on the sheet of `benchmarks.neo_hookean`: `python -m benchmarks.sheet MODULE N [OPTION ...]` prints JSON."""

import importlib
import json
import sys
import time


def main(module: str, n: str, *options: str) -> None:
    """Runs the code and prints its answer with the wall seconds of setup and solve."""
    code = importlib.import_module(f"benchmarks.sheet.{module}")
    times = [time.perf_counter()]
    run = code.run(int(n), *options)
    for _ in range(2):
        next(run)
        times.append(time.perf_counter())
    print(json.dumps(next(run) | {"setup_s": times[1] - times[0], "solve_s": times[2] - times[1]}))


if __name__ == "__main__":
    main(*sys.argv[1:])
