"""Times for people, in one form: local with their offset from UTC, e.g. `2026-11-25 22:24:05+01:00`.

The same text is accepted wherever a command takes a time. JSON has the times of the bus, in UTC.
"""

import re
from contextvars import ContextVar
from datetime import UTC, datetime

_utc_wanted: ContextVar[bool] = ContextVar("utc_wanted", default=False)
_STAMP = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(?:\.\d+)?(?:Z|[+-]\d\d:\d\d)")


def show_utc(*, wanted: bool) -> None:
    """Show all times in UTC from here on, or in local time."""
    _utc_wanted.set(wanted)


def format_time(stamp: str, *, precise: bool = False) -> str:
    """Format an RFC 3339 time; `precise` with milliseconds. A text that is none is returned as it is."""
    try:
        instant = datetime.fromisoformat(stamp).astimezone(UTC if _utc_wanted.get() else None)
    except (ValueError, OverflowError):
        return stamp
    return instant.isoformat(" ", "milliseconds" if precise else "seconds").replace("+00:00", "Z")


def localize_times(text: str) -> str:
    """`text` with the RFC 3339 times in it in that form."""
    return _STAMP.sub(lambda match: format_time(match[0]), text)
