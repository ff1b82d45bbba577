"""The table of all benchmarks: their options, how they are run, and how their results are shown."""
