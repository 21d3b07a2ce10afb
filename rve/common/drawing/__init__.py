"""Surfaces and lines in space: views, pictures, animations and pages that turn."""
