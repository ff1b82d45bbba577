"""The states of an alarm by ISA-18.2, and what leads from one to the next. Pure: each function returns a new record.

A shelved alarm, or one out of service, goes on through these states unseen. When it is no longer set aside, it is
annunciated anew if its condition holds, and otherwise over.
"""

from typing import Literal

from orchestrator.model.operation.alarms import AlarmCause, AlarmRecord, AlarmState

AlarmEvent = Literal["raise", "return", "acknowledge", "annunciate"]

TRANSITIONS: dict[tuple[AlarmState, AlarmEvent], AlarmState] = {
    ("normal", "raise"): "unacknowledged",
    ("unacknowledged", "raise"): "unacknowledged",
    ("acknowledged", "raise"): "acknowledged",
    ("returned", "raise"): "unacknowledged",
    ("normal", "return"): "normal",
    ("unacknowledged", "return"): "returned",
    ("acknowledged", "return"): "normal",
    ("returned", "return"): "returned",
    ("normal", "acknowledge"): "normal",
    ("unacknowledged", "acknowledge"): "acknowledged",
    ("acknowledged", "acknowledge"): "acknowledged",
    ("returned", "acknowledge"): "normal",
    # It was set aside, and is so no longer.
    ("normal", "annunciate"): "normal",
    ("unacknowledged", "annunciate"): "unacknowledged",
    ("acknowledged", "annunciate"): "unacknowledged",
    ("returned", "annunciate"): "normal",
}
"""The next state for each state and event; the same one where the event changes nothing."""

_ASIDE = ("shelved_until_utc", "shelved_by", "shelved_why", "out_of_service")


def raise_alarm(before: AlarmRecord | None, cause: AlarmCause, utc: str) -> AlarmRecord:
    """Its condition holds. before: None for one that was never raised. An alarm whose condition held already stays as
    it is, with the text of when it was raised; but that of one that stands for many says what it stands for now."""
    if before is not None and before.is_active and not cause.stands_for_many:
        return before
    fresh = AlarmRecord(
        id=cause.id,
        kind=cause.kind,
        subject=cause.subject,
        code=cause.code,
        source=cause.source,
        priority=cause.priority,
        text=cause.text,
        action=cause.action,
        state="unacknowledged",
        raised_utc=utc,
    )
    if before is None:
        return fresh
    if before.is_active:
        texts = {"text": fresh.text, "action": fresh.action}
        return before if before.text == fresh.text else before.model_copy(update=texts)
    fields = {name: getattr(before, name) for name in _ASIDE}
    state = TRANSITIONS[before.state, "raise"]
    return fresh.model_copy(update={**fields, "state": state, "count": before.count + 1})


def return_alarm(before: AlarmRecord, utc: str) -> AlarmRecord:
    """Its condition is over."""
    if not before.is_active:
        return before
    return before.model_copy(update={"state": TRANSITIONS[before.state, "return"], "returned_utc": utc})


def acknowledge_alarm(before: AlarmRecord, actor: str, utc: str) -> AlarmRecord:
    """A user has seen it. One that waits for no acknowledgement stays as it is."""
    state = TRANSITIONS[before.state, "acknowledge"]
    if state == before.state:
        return before
    return before.model_copy(update={"state": state, "acknowledged_by": actor, "acknowledged_utc": utc})


def shelve_alarm(before: AlarmRecord, until_utc: str, actor: str, why: str) -> AlarmRecord:
    """A user sets it aside until an instant."""
    return before.model_copy(update={"shelved_until_utc": until_utc, "shelved_by": actor, "shelved_why": why})


def unshelve_alarm(before: AlarmRecord) -> AlarmRecord:
    """It is no longer shelved."""
    if before.shelved_until_utc is None:
        return before
    return _annunciate(before, {"shelved_until_utc": None, "shelved_by": None, "shelved_why": ""})


def set_out_of_service(before: AlarmRecord, why: str) -> AlarmRecord:
    """It is out of service; with an empty `why`, no longer."""
    if why or not before.out_of_service:
        return before if why == before.out_of_service else before.model_copy(update={"out_of_service": why})
    return _annunciate(before, {"out_of_service": ""})


def _annunciate(before: AlarmRecord, changes: dict[str, str | None]) -> AlarmRecord:
    """`before` with `changes`; if nothing else sets it aside, its state follows."""
    record_after = before.model_copy(update=changes)
    if record_after.is_suppressed:
        return record_after
    state = TRANSITIONS[before.state, "annunciate"]
    if before.state == "acknowledged":
        record_after = record_after.model_copy(update={"acknowledged_by": None, "acknowledged_utc": None})
    return record_after.model_copy(update={"state": state})
