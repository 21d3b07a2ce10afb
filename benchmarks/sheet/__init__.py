"""One problem, one file per code: `run(n)` yields when it is set up, when it is solved, and then its answer."""
