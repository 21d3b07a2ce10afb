"""A ring-mesh curtain as a homogenized plane membrane."""
