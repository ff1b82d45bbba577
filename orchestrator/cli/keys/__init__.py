"""`tutti keys` and `tutti router`."""
