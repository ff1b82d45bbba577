"""RFC 3339 text of instants."""

from datetime import UTC, datetime, timedelta

# Virtual time 0 is shown as this instant. Any fixed instant will do; it must not depend on the machine.
VIRTUAL_ZERO = datetime(2026, 1, 1, tzinfo=UTC)
_NAIVE_ZERO = VIRTUAL_ZERO.replace(tzinfo=None)
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def format_rfc3339(instant: datetime) -> str:
    """Format `instant` in UTC with microseconds, e.g. `2026-11-21T10:00:00.000000Z`."""
    return instant.astimezone(UTC).replace(tzinfo=None).isoformat(timespec="microseconds") + "Z"


def parse_utc_ns(text: str) -> int:
    """Return an RFC 3339 time as ns since 1970. Raises `ValueError`, also for a time without an offset from UTC."""
    instant = datetime.fromisoformat(text)
    if instant.tzinfo is None:
        raise ValueError("a time without an offset from UTC")
    return (instant - _EPOCH) // timedelta(microseconds=1) * 1000


def format_utc_ns(at_ns: int) -> str:
    """Format an instant in ns since 1970, like `format_rfc3339`."""
    return format_rfc3339(_EPOCH + timedelta(microseconds=at_ns // 1000))


def virtual_utc(now_ns: int) -> str:
    """Return the UTC text that represents `now_ns` of virtual time."""
    return (_NAIVE_ZERO + timedelta(microseconds=now_ns // 1000)).isoformat(timespec="microseconds") + "Z"
