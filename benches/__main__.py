"""`python -m benches NAME`: the developers' benchmarks as commands that look like those of `tutti bench`."""

from benches.registry.benchmarks import BENCHMARKS
from orchestrator.cli.bench import make_bench_group

main = make_bench_group(
    BENCHMARKS,
    "Measure Tutti's parts; every figure stands next to its baseline or target from the same run.",
    "python -m benches plan --json",
)

if __name__ == "__main__":
    main(prog_name="python -m benches")
