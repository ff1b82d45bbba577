"""Axes of two motors: the second one is geared to the commanded position of the first, in gantry mode."""
