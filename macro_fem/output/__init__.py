"""Output of a solved curtain: files, pictures, line loads, the table of --explain."""
