"""Realistic one-line mistakes in the numerics, and whether the quick tests notice them."""
