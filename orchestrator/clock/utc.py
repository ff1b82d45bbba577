"""RFC 3339 text of instants."""

from datetime import UTC, datetime, timedelta

# Virtual time 0 is shown as this instant. Any fixed instant will do; it must not depend on the machine.
VIRTUAL_ZERO = datetime(2026, 1, 1, tzinfo=UTC)
_NAIVE_ZERO = VIRTUAL_ZERO.replace(tzinfo=None)


def format_rfc3339(instant: datetime) -> str:
    """Format `instant` in UTC with microseconds, e.g. `2026-11-21T10:00:00.000000Z`."""
    return instant.astimezone(UTC).replace(tzinfo=None).isoformat(timespec="microseconds") + "Z"


def virtual_utc(now_ns: int) -> str:
    """Return the UTC text that represents `now_ns` of virtual time."""
    return (_NAIVE_ZERO + timedelta(microseconds=now_ns // 1000)).isoformat(timespec="microseconds") + "Z"
