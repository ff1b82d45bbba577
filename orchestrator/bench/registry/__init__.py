"""The table of the users' benchmarks: their options, how they are run, and how their results are shown."""
