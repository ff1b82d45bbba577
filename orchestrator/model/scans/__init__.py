"""Points of scans, and the order of steps: what is built on the models of jobs."""
