"""Wiring check and reload of the fleet file."""
