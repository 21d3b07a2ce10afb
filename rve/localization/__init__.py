"""Back to the rings: the pose, place and contact forces of every ring of a curtain."""
