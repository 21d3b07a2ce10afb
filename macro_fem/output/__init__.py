"""Output of a solved curtain: files, pictures, line loads, strength, and what is said of it."""
