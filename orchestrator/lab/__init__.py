"""Whole fleets put together: in virtual time, live on this machine, for demos, benchmarks and fault campaigns."""
