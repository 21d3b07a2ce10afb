"""Realistic one-line mistakes put into the numerics, and whether the quick tests notice: `python -m benchmarks.mutation`."""
