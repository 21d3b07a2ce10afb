"""Files: atomic writes, jobs of several files, reading with limits, VTU."""
