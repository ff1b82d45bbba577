"""The in-memory bus for virtual time."""
