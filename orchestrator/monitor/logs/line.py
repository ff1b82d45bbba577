"""One line of a log file."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, cast

from orchestrator.clock.utc import parse_utc_ns

LogLevel = Literal["info", "warning"]

# Events are lines of level `info`, because they are published as events; these are abnormal all the same.
_ABNORMAL_KINDS = {"offline", "fault", "failed", "estop"}


@dataclass(frozen=True, slots=True)
class LogLine:
    """A line as it stands in a file.

    file: name of the file without rotation number and suffix. utc_ns: since 1970; None for a line without a time.
    fields: the JSON object; empty for a line that is none. raw: the text of such a line. damaged: it should be one.
    """

    file: str
    utc_ns: int | None = None
    fleet_ns: int | None = None
    level: LogLevel = "info"
    fields: Mapping[str, Any] = field(default_factory=dict[str, Any])
    raw: str = ""
    damaged: bool = False

    @property
    def process(self) -> str:
        """The process that has written it: one file has the lines of an adapter host and of its guardian."""
        role, name = self.fields.get("role"), self.fields.get("id")
        return f"{role}-{name}" if role in ("guardian", "host") else self.file

    @property
    def controller(self) -> str | None:
        """The controller that it is about."""
        field = self.fields.get("controller")
        if field is None and self.fields.get("role") == "controller":
            field = self.fields.get("id")  # a line that was too long has lost its further fields
        return field if isinstance(field, str) else None

    @property
    def job(self) -> str | None:
        """The job that it is about, or that holds the axes that it is about."""
        field = self.fields.get("job") or self.fields.get("holder")
        return field if isinstance(field, str) else None


def parse_line(file: str, text: str) -> LogLine:
    """Parse a line of a file with JSON lines. Raises nothing: a damaged line keeps its text."""
    try:
        entry = json.loads(text)
        if not isinstance(entry, dict):
            raise TypeError("no object")
        fields = cast(dict[str, Any], entry)
        utc, fleet_ns = fields.get("utc"), fields.get("fleet_ns")
        utc_ns = None if utc is None else parse_utc_ns(utc)
        if fleet_ns is not None and type(fleet_ns) is not int:
            raise TypeError("fleet_ns is no number")
    except (ValueError, TypeError, OverflowError, RecursionError):
        return LogLine(file, level="warning", raw=text, damaged=True)
    abnormal = fields.get("level") != "info" or fields.get("kind") in _ABNORMAL_KINDS
    return LogLine(file, utc_ns, fleet_ns, "warning" if abnormal else "info", fields)


def parse_plain_line(file: str, text: str) -> LogLine:
    """A line of what a process has written to its standard error; it is abnormal that there is any."""
    return LogLine(file, level="warning", raw=text)
