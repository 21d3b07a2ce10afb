"""What a solved curtain leaves: files, pictures, line loads, decisions in words."""
