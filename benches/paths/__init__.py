"""Paths: how far members are off them, and how the planner compares with its limits, times and costs."""
