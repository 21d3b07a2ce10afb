"""From table rows to a law: rows, bounds, refinement, stiffness, error report."""
