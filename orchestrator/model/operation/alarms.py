"""Alarms on the bus: their records on `alarm/{id}`, and the requests about them, on `svc/{verb}`."""

import re
from typing import Annotated, Literal, NamedTuple
from zlib import crc32

from pydantic import Field

from orchestrator.model.alarm_rules import AlarmPriority
from orchestrator.model.base import Id, Int53, Label, Model, Sentence
from orchestrator.model.messages import Reply, Request
from orchestrator.model.text.text_fields import SHOW_TEXT

AlarmState = Literal["unacknowledged", "acknowledged", "returned", "normal"]
MAX_SHELVED_S = 24 * 3600.0
MAX_ALARM_IDS, MAX_HISTORY = 1_000, 10_000
MAX_SUBJECT = 140
MANY_PREFIX = "many-"
"""With which the kind of an alarm begins that stands for conditions of one kind in many controllers."""
OPEN_BUS = "open-bus"
"""The kind of the alarm that other computers reach the bus without TLS: each view shows it by itself."""

_JOINT = re.compile(r"[.+]")
_OTHER_SIGNS = re.compile(r"[^a-z0-9_-]+")


def make_alarm_id(kind: str, subject: str, code: str = "", source: str = "") -> str:
    """The id of an alarm: one chunk of a key, always the same for the same cause.

    `disconnected` and `gantry` make `disconnected-gantry`; the sign in `gantry.x` and in `gantry+stage` becomes `_`.
    Where that could be the id of two causes, and for alarms of other processes, a checksum follows.
    """
    text = "-".join(part for part in (kind, code, subject) if part)
    plain = _OTHER_SIGNS.sub("-", _JOINT.sub("_", text))
    unsure = _OTHER_SIGNS.search(_JOINT.sub("_", text)) or len({".", "+", "_"} & set(text)) > 1
    if len(plain) <= 64 and not unsure and not source and not (code and "-" in subject):
        return plain
    return f"{plain[:55]}-{crc32(repr((kind, subject, code, source)).encode()):08x}"


class AlarmCause(NamedTuple):
    """What raises an alarm. subject: a controller, an axis, controllers joined by `+`, or a part of the fleet.

    code: tells several causes of one kind and subject apart; empty: there is one. action: what the operator does.
    source: of which process; empty: the coordinator.
    """

    kind: str
    subject: str
    text: str
    action: str
    code: str = ""
    priority: AlarmPriority = "high"
    source: str = ""

    @property
    def id(self) -> str:
        return make_alarm_id(self.kind, self.subject, self.code, self.source)

    @property
    def stands_for_many(self) -> bool:
        """Whether it stands for conditions of many controllers, which come and go while it holds."""
        return self.kind.startswith(MANY_PREFIX) and not self.source


class AlarmRecord(Model):
    """An alarm, with its state by ISA-18.2. Instants are UTC.

    unacknowledged: its condition holds. acknowledged: it holds, and a user has seen it. returned: it is over, and was
    never acknowledged. normal: it is over. raised_utc: when it was raised last, for the `count`-th time.
    shelved_until_utc: set aside by a user until then. out_of_service: why it does not count now: its axis is reserved.
    change: names its last change, `EPOCH-NUMBER`; no other change of any alarm has this name.
    """

    schema_: Literal["tutti.alarm/1"] = Field(default="tutti.alarm/1", alias="schema")
    id: Id
    kind: Id
    subject: str = Field(max_length=MAX_SUBJECT)
    code: str = ""
    source: str = ""
    priority: AlarmPriority
    text: Sentence
    action: Sentence
    state: AlarmState
    raised_utc: str
    returned_utc: str | None = None
    acknowledged_by: str | None = None
    acknowledged_utc: str | None = None
    shelved_until_utc: str | None = None
    shelved_by: str | None = None
    shelved_why: str = ""
    out_of_service: str = ""
    count: Int53 = 1
    change: str = ""

    @property
    def is_active(self) -> bool:
        """Whether its condition holds."""
        return self.state in ("unacknowledged", "acknowledged")

    @property
    def is_suppressed(self) -> bool:
        """Whether it is set aside: shelved, or out of service."""
        return self.shelved_until_utc is not None or bool(self.out_of_service)

    @property
    def is_open(self) -> bool:
        """Whether it waits for a user: it holds or is not acknowledged, and is not set aside."""
        return self.state != "normal" and not self.is_suppressed


class AlarmRequest(Model):
    """What another process publishes on `alarm-request/{role}/{id}`, so that the coordinator raises an alarm, or lets
    it return."""

    kind: Annotated[Id, Field(max_length=32)]
    subject: Label = Field(min_length=1, max_length=MAX_SUBJECT)
    text: Sentence
    action: Sentence = ""
    priority: AlarmPriority = "medium"
    active: bool


class ListAlarms(Request):
    """List alarms. all: also those that are normal. history: the last changes of alarms, at most so many."""

    all: bool = False
    history: int = Field(default=0, ge=0, le=MAX_HISTORY)


class AlarmsListed(Reply):
    """alarms: by priority, the newest first. history: each change, the newest first."""

    alarms: list[AlarmRecord] = Field(default=[])
    history: list[AlarmRecord] = Field(default=[])


class AcknowledgeAlarms(Request):
    """Acknowledge alarms; an empty list stands for all that are not acknowledged."""

    alarm_ids: list[Id] = Field(default=[], max_length=MAX_ALARM_IDS)


class AlarmsAcknowledged(Reply):
    """The alarms as they are now; without those that were acknowledged already."""

    alarms: list[AlarmRecord] = Field(default=[])


class ShelveAlarm(Request):
    """Set an alarm aside for `for_s` seconds; None: no longer."""

    alarm_id: Id
    for_s: float | None = Field(gt=0, le=MAX_SHELVED_S)
    why: Annotated[str, SHOW_TEXT] = Field(default="", max_length=200)


class AlarmShelved(Reply):
    alarm: AlarmRecord | None = None
