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
        text, present = str(value), datetime.now().astimezone()
        if self._past and DURATION.match(text):
            return present - timedelta(seconds=DurationType().convert(text, param, ctx))
        try:
            if _CLOCK.match(text):
                clock = datetime.strptime(text, "%H:%M:%S" if text.count(":") == 2 else "%H:%M").time()
                day = present.date()
                instant = datetime.combine(day, clock).astimezone()
                if not self._past and instant <= present:
                    instant = datetime.combine(day + timedelta(days=1), clock).astimezone()
                return instant
            return datetime.fromisoformat(text).astimezone()
        except (ValueError, OverflowError):
            age_hint = ", or an age as 7d" if self._past else ""
            forms = "2026-11-21T22:30:00+01:00, or 2026-11-21T22:30 or 22:30 in local time"
            self.fail(f"{text!r}: write e.g. {forms}{age_hint}", param, ctx)
