"""The paper's method: Stewart-Trinkle time stepping, all ten rings, alternating projection."""
