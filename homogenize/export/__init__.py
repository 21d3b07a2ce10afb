"""A law for other programs: source of a user material."""
