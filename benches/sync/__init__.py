"""Skew of starts: methods to compare with, bounds, and the measurement in virtual time."""
