"""What a scene leaves out: every feature that costs time, forced on and compared."""
