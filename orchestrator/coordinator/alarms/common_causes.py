"""Conditions of many controllers with one cause: which belong together, and how their one alarm is worded."""

from collections.abc import Iterable
from typing import NamedTuple

from orchestrator.model.fleet import Fleet
from orchestrator.model.names import controller_of
from orchestrator.model.operation.alarms import MANY_PREFIX, AlarmCause, AlarmRecord, make_alarm_id

MANY = 20  # controllers: in a smaller fleet each condition is an alarm, at once
MAX_NAMED = 3
_WORDS = {
    "disconnected": "offline",
    "fault": "fault",
    "limit-switch": "on a limit switch",
    "clock-bound": "clock known badly",
    "link-errors": "link that breaks often",
    "following-error": "growing following error",
}


class CommonCause(NamedTuple):
    """kind: that of the conditions. subject: the host that they have in common, or `fleet`. code: of a fault."""

    kind: str
    subject: str
    code: str = ""

    @property
    def alarm_kind(self) -> str:
        return f"{MANY_PREFIX}{self.kind}"

    @property
    def alarm_id(self) -> str:
        return make_alarm_id(self.alarm_kind, self.subject, self.code)


def find_common(fleet: Fleet, cause: AlarmCause) -> CommonCause | None:
    """What a condition may have in common with those of other controllers; None: it is an alarm of its own."""
    config = fleet.controllers.get(controller_of(cause.subject))
    if cause.source or cause.kind not in _WORDS or config is None or len(fleet.controllers) <= MANY:
        return None
    if cause.kind == "disconnected":
        return CommonCause(cause.kind, config.host)
    return CommonCause(cause.kind, "fleet", cause.code)


def read_common(record: AlarmRecord) -> CommonCause | None:
    """The common cause that an alarm was raised for; None: for something else."""
    if record.source or record.kind.removeprefix(MANY_PREFIX) not in _WORDS or not record.kind.startswith(MANY_PREFIX):
        return None
    return CommonCause(record.kind.removeprefix(MANY_PREFIX), record.subject, record.code)


def describe_common(fleet: Fleet, common: CommonCause, causes: Iterable[AlarmCause]) -> AlarmCause:
    """The one alarm for these causes, of which there is one at least: with their number and the first names."""
    causes = list(causes)
    names = sorted({controller_of(cause.subject) for cause in causes})
    first_names = ", ".join(names[:MAX_NAMED]) + (
        f" and {len(names) - MAX_NAMED} more" if len(names) > MAX_NAMED else ""
    )
    group, total = "controllers", len(fleet.controllers)
    if common.subject != "fleet":
        group = f"controllers of host {common.subject}"
        total = sum(config.host == common.subject for config in fleet.controllers.values())
    number = f"all {total}" if len(names) == total else f"{len(names)} of {total}"
    words = f"{_WORDS[common.kind]}{f' {common.code}' if common.code else ''}"
    text = f"{words}: {number} {group} ({first_names}); the first: {causes[0].text}"
    return AlarmCause(common.alarm_kind, common.subject, text, causes[0].action, common.code, causes[0].priority)
