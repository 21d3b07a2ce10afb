"""Output of a solved curtain: files, pictures, line loads, explained decisions."""
