"""The registry of all benchmarks.

Only records and run functions are loaded for `tutti bench --help`: a benchmark's own module is imported when it runs.
`orchestrator.cli.bench` makes the commands from the records, and prints tables and JSON. To add a benchmark, add its
record and its run function (`orchestrator.bench.registry.runs`).
"""

from orchestrator.bench.registry.live_records import LIVE_BENCHMARKS
from orchestrator.bench.registry.record import Benchmark
from orchestrator.bench.registry.virtual_records import VIRTUAL_BENCHMARKS

BENCHMARKS: dict[str, Benchmark] = {
    benchmark.name: benchmark
    for benchmark in sorted((*VIRTUAL_BENCHMARKS, *LIVE_BENCHMARKS), key=lambda benchmark: benchmark.name)
}
"""By name of the command."""
