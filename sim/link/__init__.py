"""Simulated controllers on real sockets and pseudo-terminals."""
