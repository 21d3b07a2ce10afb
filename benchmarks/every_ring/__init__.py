"""Every ring against the homogenized disk, the periodic cell and other solvers."""
