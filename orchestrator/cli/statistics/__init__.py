"""`tutti stats`."""
