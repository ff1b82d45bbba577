"""A log line for a terminal, and for programs."""

from collections.abc import Iterable
from typing import Any

from rich.cells import cell_len
from rich.text import Text

from orchestrator.clock.utc import format_utc_ns
from orchestrator.model.steps.numbers import name_step
from orchestrator.monitor.logs.line import LogLine
from orchestrator.monitor.logs.placing import PlacedLine
from orchestrator.monitor.times import format_time

MAX_VALUE = 80  # characters of a further field
_SHOWN = {"utc", "fleet_ns", "level", "role", "id", "text", "controller", "job", "step", "epoch"}


class LineLayout:
    """How lines are shown: time, process, controller, job/step, text, further fields. The columns are as wide as the
    lines that it was made for need."""

    def __init__(self, lines: Iterable[PlacedLine]) -> None:
        self._widths = [0, 0, 0]
        for line in lines:
            sizes = (cell_len(cell) for cell in _make_cells(line.line))
            self._widths = [max(width, size) for width, size in zip(self._widths, sizes, strict=True)]

    def format_line(self, placed: PlacedLine) -> Text:
        """The line for a terminal; colours only for what is abnormal."""
        line = placed.line
        cells = zip(_make_cells(line), self._widths, strict=True)
        head = "".join(f"{cell.ljust(width)}  " for cell, width in cells if width)
        words = Text(f"{format_time(format_utc_ns(placed.at_ns), precise=True)}  {head}")
        if not line.fields:
            return words.append(escape_control(line.raw), style="dim")
        style = "yellow" if line.level == "warning" else ""
        words.append(escape_control(str(line.fields.get("text", ""))), style=style)
        field_text = "  ".join(f"{name}={_shorten(value)}" for name, value in _list_further(line))
        return words.append(f"  {field_text}", style="dim") if field_text else words


def _make_cells(line: LogLine) -> tuple[str, str, str]:
    step = line.fields.get("step")
    job = (line.job or "") + ("" if line.job is None or step is None else f" {name_step(step)}")
    return escape_control(line.process), escape_control(line.controller or ""), escape_control(job)


def make_plain_line(placed: PlacedLine) -> dict[str, Any]:
    """The line for programs: `at`, its instant as UTC; `process`; then the fields as they were written, or `raw`."""
    line = placed.line
    head: dict[str, Any] = {"at": format_utc_ns(placed.at_ns), "process": line.process}
    if not line.fields:
        return head | {"raw": line.raw, "damaged": line.damaged}
    return head | {name: value for name, value in line.fields.items() if name not in head}


def escape_control(text: str) -> str:
    """Text without what a terminal would execute: a controller's answer may contain anything."""
    if text.isprintable():
        return text
    return "".join(
        character if character.isprintable() else character.encode("unicode_escape").decode("ascii")
        for character in text
    )


def _list_further(line: LogLine) -> list[tuple[str, Any]]:
    text = line.fields.get("text")
    return [
        (name, value)
        for name, value in line.fields.items()
        if name not in _SHOWN and value not in (None, "") and not (name == "kind" and value == text)
    ]


def _shorten(value: Any) -> str:
    if isinstance(value, list):
        return f"[{len(value)}]"  # pyright: ignore[reportUnknownArgumentType]
    text = escape_control(str(value))
    return text if len(text) <= MAX_VALUE else f"{text[: MAX_VALUE - 1]}…"
