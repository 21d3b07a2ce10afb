"""The paper's study for this implementation: its load cases and figures."""
