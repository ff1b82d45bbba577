"""Checks of a computer that runs a part of a fleet."""
