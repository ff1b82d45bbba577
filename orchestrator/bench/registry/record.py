"""The record of a benchmark: name, options, run function, columns and targets."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

Document = Mapping[str, Any]
"""The result of a run: the fields of its JSON document. Rows are `NamedTuple`s or mappings."""


@dataclass(frozen=True, slots=True)
class BenchOption:
    """One command line option.

    low, high: permitted range of a number; None: any.
    """

    name: str
    kind: Literal["int", "float", "text", "flag", "folder", "file"]
    help: str
    default: Any = None
    low: float | None = None
    high: float | None = None
    metavar: str | None = None


@dataclass(frozen=True, slots=True)
class BenchColumn:
    """One column of a table.

    title: ends in `>` if the column is right-aligned.
    value: a field of the row, or a function of it.
    spec: format of its numbers; None is shown as an empty cell, a bool as `yes` or `NO`.
    scale: factor of its numbers.
    """

    title: str
    value: str | Callable[[Any], Any]
    spec: str = ""
    scale: float = 1


TARGET_COLUMNS = (BenchColumn("target", "asked"), BenchColumn("met", "met"))


@dataclass(frozen=True, slots=True)
class BenchTable:
    """One table of a result.

    rows: key of the rows in the document, or a function that returns them; None: the table is omitted.
    has_targets: each row states its target (`asked`) and whether it is reached (`met`), which are shown last.
    title: a line above the table, with fields of the document in braces.
    """

    rows: str | Callable[[Document], Iterable[Any] | None]
    columns: tuple[BenchColumn, ...]
    has_targets: bool = False
    title: str = ""

    @property
    def all_columns(self) -> tuple[BenchColumn, ...]:
        """The columns, with those of the targets."""
        return (*self.columns, *TARGET_COLUMNS) if self.has_targets else self.columns

    def find_rows(self, document: Document) -> Iterable[Any] | None:
        """Return the rows of the table; None if it is omitted."""
        return document[self.rows] if isinstance(self.rows, str) else self.rows(document)


@dataclass(frozen=True, slots=True)
class BenchNote:
    """Lines of text between tables: with fields of the document in braces, or made by a function."""

    text: str | Callable[[Document], Iterable[str]]

    def make_lines(self, document: Document) -> Iterable[str]:
        """Return the lines for `document`."""
        return [self.text.format_map(document)] if isinstance(self.text, str) else self.text(document)


@dataclass(frozen=True, slots=True)
class Benchmark:
    """One benchmark, and its command, `tutti bench NAME` or `python -m benches NAME`.

    run: called with a function that shows progress, and with the options by name.
    layout: tables and notes in the order in which they are shown.
    has_failed: whether a result makes the exit code 1.
    """

    name: str
    help: str
    example: str
    options: tuple[BenchOption, ...]
    run: Callable[..., Document]
    layout: tuple[BenchTable | BenchNote, ...]
    has_failed: Callable[[Document], bool] = lambda document: False


def index_benchmarks(benchmarks: Iterable[Benchmark]) -> dict[str, Benchmark]:
    """Return benchmarks by name, in the order of their names."""
    return {benchmark.name: benchmark for benchmark in sorted(benchmarks, key=lambda benchmark: benchmark.name)}


def make_spread_columns(unit: str, scale: float, spec: str) -> tuple[BenchColumn, ...]:
    """Return the columns of a row (label, spread)."""
    return (
        BenchColumn("n", lambda row: row[1].n),
        BenchColumn(f"p50, {unit}>", lambda row: row[1].p50_ms, spec, scale),
        BenchColumn(f"p99, {unit}>", lambda row: row[1].p99_ms, spec, scale),
        BenchColumn(f"max, {unit}>", lambda row: row[1].max_ms, spec, scale),
        BenchColumn("target", lambda row: row[1].asked),
        BenchColumn("met", lambda row: row[1].met),
    )


def make_spread_table(
    title: str, labels: Mapping[str, str], unit: str = "ms", scale: float = 1, spec: str = ".1f"
) -> BenchTable:
    """Make a table of the spreads in a document. labels: text for the field of each spread."""
    return BenchTable(
        lambda document: [(label, document[field]) for field, label in labels.items()],
        (BenchColumn(title, lambda row: row[0]), *make_spread_columns(unit, scale, spec)),
    )
