"""`tutti bench …`: a command for each benchmark in the registry; tables and JSON are printed here.

`python -m benches …` is made in the same way, from the registry of the developers' benchmarks.
"""

import inspect
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, cast

import click

from orchestrator.bench.registry.benchmarks import BENCHMARKS
from orchestrator.bench.registry.record import BenchColumn, Benchmark, BenchNote, BenchOption, BenchTable, Document
from orchestrator.bench.registry.runs import BenchFailed, InvalidOption
from orchestrator.cli.base.codes import FAILED
from orchestrator.cli.base.common import console, print_json
from orchestrator.cli.base.errors import exit_with_error, expected_errors
from orchestrator.cli.base.root import RootGroup
from orchestrator.cli.base.systems import require_linux

_JSON_OPTION = click.Option(["--json", "as_json"], is_flag=True, help="Print JSON for programs, errors too.")


def _make_option(option: BenchOption) -> click.Option:
    """Convert the option of a benchmark to one of click."""
    return click.Option(
        [f"--{option.name}"],
        help=option.help,
        default=option.default,
        show_default=option.default not in (None, "", False),
        metavar=option.metavar,
        is_flag=option.kind == "flag",
        type=_make_type(option),
    )


def _make_type(option: BenchOption) -> "click.ParamType[Any] | type | None":
    match option.kind:
        case "flag":
            return None
        case "text":
            return str
        case "folder":
            return click.Path(exists=True, file_okay=False, path_type=Path)
        case "file":
            return click.Path(dir_okay=False, path_type=Path)
        case "int":
            return int if option.low is None else click.IntRange(int(option.low), _to_int(option.high))
        case "float":
            return float if option.low is None else click.FloatRange(option.low, option.high)


def _to_int(value: float | None) -> int | None:
    return None if value is None else int(value)


def _make_command(benchmark: Benchmark) -> click.Command:
    """Make the command of a benchmark."""

    def run_benchmark(*, as_json: bool, **options: Any) -> None:
        require_linux("a benchmark", "run it on the computer of the fleet, which it measures")
        document = _run_guarded(benchmark, as_json=as_json, options=options)
        if as_json:
            print_json(_to_plain(document))
        else:
            _print_layout(benchmark, document)
        if benchmark.has_failed(document):
            raise SystemExit(FAILED)

    return click.Command(
        benchmark.name,
        callback=run_benchmark,
        params=[_JSON_OPTION, *(_make_option(option) for option in benchmark.options)],
        help=inspect.cleandoc(benchmark.help),
        epilog=f"Example: {benchmark.example}",
    )


def _run_guarded(benchmark: Benchmark, options: dict[str, Any], *, as_json: bool) -> Document:
    """Run a benchmark; every expected error becomes a message and an exit code."""

    def show_progress(line: str) -> None:
        if not as_json:
            console.print(f"[dim]{line}[/]")

    with expected_errors():
        try:
            return benchmark.run(show_progress, **options)
        except InvalidOption as error:
            raise click.BadParameter(str(error), param_hint=f"--{error.name}") from None
        except BenchFailed as error:
            exit_with_error(str(error))


def _to_plain(value: Any) -> Any:
    """Convert named tuples, wherever they are, to dictionaries."""
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {str(key): _to_plain(item) for key, item in cast(Mapping[Any, Any], value).items()}
    return [_to_plain(item) for item in cast(Iterable[Any], value)] if isinstance(value, list | tuple) else value


def _print_layout(benchmark: Benchmark, document: Document) -> None:
    """Print the tables and notes of a result."""
    for part in benchmark.layout:
        if isinstance(part, BenchNote):
            for line in part.make_lines(document):
                console.print(line, highlight=False)
        else:
            _print_table(part, document)


def _print_table(table: BenchTable, document: Document) -> None:
    from orchestrator.monitor.tables import make_plain_table

    rows = table.find_rows(document)
    if rows is None:
        return
    if table.title:
        console.print(table.title.format_map(document), style="bold", highlight=False)
    shown_table = make_plain_table([column.title for column in table.all_columns])
    for row in rows:
        shown_table.add_row(*(_format_cell(column, row) for column in table.all_columns))
    console.print(shown_table)


def _format_cell(column: BenchColumn, row: Any) -> str:
    """Return the text of a cell."""
    match _find_value(column.value, row):
        case None:
            return ""
        case bool(is_met):
            return "yes" if is_met else "NO"
        case int(number) | float(number) if column.spec:
            return format(number * column.scale, column.spec)
        case value:
            return str(value)


def _find_value(value: str | Callable[[Any], Any], row: Any) -> Any:
    """Return the value of a cell: a field of a mapping or of a record, or a function of the row."""
    if callable(value):
        return value(row)
    return cast(Mapping[str, Any], row)[value] if isinstance(row, Mapping) else getattr(row, value)


def make_bench_group(benchmarks: Mapping[str, Benchmark], text: str, example: str) -> RootGroup:
    """Make the group with a command for each benchmark. text: its help."""
    commands = [_make_command(benchmark) for benchmark in benchmarks.values()]
    settings = {"help_option_names": ["-h", "--help"]}
    return RootGroup("bench", commands=commands, help=text, epilog=f"Example: {example}", context_settings=settings)


bench = make_bench_group(
    BENCHMARKS, "Measure Tutti on this computer, live with simulated controllers.", "tutti bench dispatch --json"
)
