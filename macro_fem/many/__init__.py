"""Many scenes: sweeps over scene files, and the largest value of one quantity with which a curtain holds."""
