"""The users' benchmarks: `tutti bench`."""
