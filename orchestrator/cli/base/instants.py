"""Times in the notation of users."""

import re
from datetime import datetime, timedelta
from typing import Any

import click

from orchestrator.cli.base.durations import DURATION, DurationType
from orchestrator.model.errors import TuttiError

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
                instant = _find_local(datetime.combine(day, clock))
                if not self._past and instant <= present:
                    instant = _find_local(datetime.combine(day + timedelta(days=1), clock))
                return instant
            return _find_local(datetime.fromisoformat(text))
        except NoLocalTime as error:
            self.fail(str(error), param, ctx)
        except (ValueError, OverflowError):
            age_hint = ", or an age as 7d" if self._past else ""
            forms = "2026-11-21T22:30:00+01:00, or 2026-11-21T22:30 or 22:30 in local time"
            self.fail(f"{text!r}: write e.g. {forms}{age_hint}", param, ctx)


class NoLocalTime(TuttiError, ValueError):
    """A local time that does not exist: clocks go forward over it."""


def _find_local(instant: datetime) -> datetime:
    """An instant, aware. Of a local time that comes twice it is the later one, which is said; raises `NoLocalTime` for
    one that does not come: never is a time taken for an earlier one."""
    if instant.tzinfo is not None:
        return instant.astimezone()
    instants = [instant.replace(fold=fold).astimezone() for fold in (0, 1)]
    last_instant, words = max(instants), f"{instant:%Y-%m-%d %H:%M}"
    if instants[0].replace(tzinfo=None) != instant:
        remedy = f"write {last_instant:%H:%M}, or a time with an offset, e.g. {last_instant.isoformat()}"
        raise NoLocalTime(f"{words} does not come: clocks go forward over it; {remedy}")
    if instants[0] != instants[1]:
        click.echo(
            f"{words} comes twice; the later one is taken, {last_instant.isoformat()}: write the offset to choose",
            err=True,
        )
    return last_instant
