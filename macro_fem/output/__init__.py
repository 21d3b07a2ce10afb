"""Output of a solved curtain: files, pictures, and what is said of it."""
