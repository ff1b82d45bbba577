"""Times in the notation of users."""

import re
from datetime import datetime, timedelta
from typing import Any

import click

from orchestrator.cli.base.durations import DURATION, DurationType

_CLOCK = re.compile(r"^\d{1,2}:\d{2}(:\d{2})?$")


class InstantType(click.ParamType[datetime]):
    """An RFC 3339 time; without an offset it is local, and `22:30` is the next such time. Aware, in local time."""

    name = "time"

    def __init__(self, *, past: bool = False) -> None:
        self._past = past

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> datetime:
        if isinstance(value, datetime):
            return value
        text, now = str(value), datetime.now().astimezone()
        if self._past and DURATION.match(text):
            return now - timedelta(seconds=DurationType().convert(text, param, ctx))
        try:
            if _CLOCK.match(text):
                clock = datetime.strptime(text, "%H:%M:%S" if text.count(":") == 2 else "%H:%M").time()
                day = now.date()
                wanted = datetime.combine(day, clock).astimezone()
                if not self._past and wanted <= now:
                    wanted = datetime.combine(day + timedelta(days=1), clock).astimezone()
                return wanted
            return datetime.fromisoformat(text).astimezone()
        except (ValueError, OverflowError):
            also = ", or an age as 7d" if self._past else ""
            known = "2026-11-21T22:30:00+01:00, or 2026-11-21T22:30 or 22:30 in local time"
            self.fail(f"{text!r}: write e.g. {known}{also}", param, ctx)
