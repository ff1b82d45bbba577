"""Axes of two motors, which carry one beam."""
