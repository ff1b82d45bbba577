"""Recordings of what a fleet publishes, as MCAP files: the recorder, repair, and reading."""
