"""The commands, by chapter of the manual."""
