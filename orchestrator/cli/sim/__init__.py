"""Simulated controllers and the fault campaign."""
