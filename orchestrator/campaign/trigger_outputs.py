"""The outputs with triggers of the fault campaign's fleets."""

TRIGGER_OUTPUT, TRIGGER_NUMBER = "flash", 3
"""The output of the controllers whose make has triggers, and its number."""
TRIGGER_PERIOD = "40 ms"
