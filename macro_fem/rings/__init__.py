"""Back to the rings of a solved curtain, and every ring of a scene beside the curtain."""
