"""Answers of a law: the locked strain under a Cauchy load, its bounds, and the numbers of the command line."""
