"""The end of a certificate: what a process states of its own, and when it is announced, 30, 7 and 1 days before."""

from datetime import datetime, timedelta

from orchestrator.bus.identity import find_session_identity
from orchestrator.clock.utc import format_rfc3339
from orchestrator.model.alarm_rules import AlarmPriority
from orchestrator.model.state import CertificateEnd

ALARMS: tuple[tuple[int, AlarmPriority], ...] = ((30, "low"), (7, "medium"), (1, "high"))
"""Days before the end, and the priority of the alarm from then on."""


def find_session_certificate(endpoint: str) -> CertificateEnd | None:
    """The certificate of this process's session at `endpoint`; None: it has none."""
    identity = find_session_identity(endpoint)
    if identity is None:
        return None
    return CertificateEnd(name=identity.common_name, ends_utc=format_rfc3339(identity.expires))


def describe_expiry(expires: datetime, now: datetime) -> str:
    """In words for a list: `valid`, `ends in 6 days`, `expired`."""
    if now >= expires:
        return "expired"
    time_left = expires - now
    return "valid" if time_left > timedelta(days=ALARMS[0][0]) else f"ends in {_format_left(time_left)}"


def find_priority(expires: datetime, now: datetime) -> AlarmPriority | None:
    """The priority of the alarm for a certificate; None while it has more than 30 days."""
    alarm_priority: AlarmPriority | None = None
    for days, priority in ALARMS:
        if expires - now <= timedelta(days=days):
            alarm_priority = priority
    return alarm_priority


def _format_left(left: timedelta) -> str:
    hours = left // timedelta(hours=1)
    return f"{left.days} days" if left.days > 1 else f"{hours} h"
