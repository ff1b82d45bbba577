"""The developers' benchmarks, `python -m benches`: Tutti's algorithms, simulators and page beside baselines."""
