"""Benchmarks of CAN buses: load, mixed fleets, streamed moves."""
