"""Benchmarks of drivers on simulated controllers: links, starts, chains, and the accuracy of what is executed."""
