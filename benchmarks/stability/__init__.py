"""Report 2: what was tried at the extremes and what happened, case by case."""
