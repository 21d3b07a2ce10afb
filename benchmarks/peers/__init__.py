"""Scripts that drive solvers of others, some with an interpreter of their own."""
