"""One problem, one file per code that solves it: each prints one JSON line (see `benchmarks.neo_hookean`)."""
