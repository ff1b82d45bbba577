"""The recorded points of scans in words: as a table, and line by line while they come."""

from collections.abc import Iterator, Sequence

from rich.console import RenderableType

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.model.report import PointRecord
from orchestrator.model.steps.numbers import number_step
from orchestrator.monitor.tables import make_plain_table

TITLES = ("step>", "point>", "target", "measured, or passed", "verdict", "start skew>", "took>")
"""One that ends with `>` is aligned to the right."""
LEAST_WIDTHS = (4, 6, 0, 0, 7, 10, 9)


def make_point_table(records: Sequence[PointRecord]) -> RenderableType:
    """A row a point: targets, measured positions, verdict, start skew, time."""
    table = make_plain_table(TITLES)
    for record in records:
        table.add_row(*_make_cells(record))
    return table


class PointLines:
    """The table line by line, for points that come one after the other. A column is as wide as its widest cell so
    far."""

    def __init__(self) -> None:
        self._titles = [title.rstrip(">") for title in TITLES]
        self._widths = list(LEAST_WIDTHS)
        self._last: PointRecord | None = None

    def make_lines(self, record: PointRecord) -> Iterator[str]:
        """The line of a point; before it the titles, where a scan of other axes begins."""
        last, self._last = self._last, record
        is_new = last is None or (record.step != last.step and record.target.keys() != last.target.keys())
        if is_new:
            self._widths = [max(len(title), least) for title, least in zip(self._titles, LEAST_WIDTHS, strict=True)]
        cells = _make_cells(record)
        self._widths = [max(width, len(cell)) for width, cell in zip(self._widths, cells, strict=True)]
        if is_new:
            yield self._join(self._titles)
        yield self._join(cells)

    def _join(self, cells: Sequence[str]) -> str:
        columns = zip(TITLES, cells, self._widths, strict=True)
        return "  ".join(f"{cell:{'>' if title.endswith('>') else '<'}{width}}" for title, cell, width in columns)


def _make_cells(record: PointRecord) -> list[str]:
    return [
        str(number_step(record.step)),
        str(record.point),
        " ".join(f"{axis}={value:g}" for axis, value in record.target.items()),
        _describe_place(record),
        _describe_verdict(record),
        "" if record.start_skew is None else f"≤ {record.start_skew.at_most_ns / NS_PER_MS:.1f} ms",
        "" if record.took_s is None else f"{record.took_s:.3f} s",
    ]


def _describe_place(record: PointRecord) -> str:
    """Where its axes stood, or when the axis that flies was there, from the start of its line on."""
    if record.window is None or record.t0_fleet_ns is None:
        return " ".join(f"{axis}={'-' if value is None else f'{value:g}'}" for axis, value in record.measured.items())
    middle = record.window.middle
    after_s = ((middle.earliest_ns + middle.latest_ns) / 2 - record.t0_fleet_ns) / NS_PER_S
    half_ms = (middle.latest_ns - middle.earliest_ns) / 2 / NS_PER_MS
    return f"T0 + {after_s:.4f} s ± {half_ms:.1f} ms"


def _describe_verdict(record: PointRecord) -> str:
    word = record.verdict if record.state == "done" else record.state
    return f"{word}, not good" if record.good is False else word
