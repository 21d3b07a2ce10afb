"""Error against run time, stability, omissions: what the numbers and figures of README and docs are made with."""
