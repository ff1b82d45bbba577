"""The jog panel."""
