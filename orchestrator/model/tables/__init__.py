"""Functions that are given by tables."""
