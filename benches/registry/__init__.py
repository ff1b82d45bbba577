"""The table of the developers' benchmarks, like that of the users' in `orchestrator.bench.registry`."""
