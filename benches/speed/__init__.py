"""Benchmarks of processor time: of plans, and of simulations in virtual time."""
