"""The conditions behind alarms: an alarm is raised when its condition has held for a while, and returns when that has
been over for a while, so that none flaps."""

from collections.abc import Callable
from dataclasses import dataclass

from orchestrator.clock.base import Clock
from orchestrator.coordinator.alarms.register import AlarmRegister
from orchestrator.model.alarm_rules import AlarmRule, AlarmRules
from orchestrator.model.operation.alarms import AlarmCause, AlarmRecord

MAX_CONDITIONS = 2_000


@dataclass(slots=True)
class _Condition:
    """since_ns: since when it holds, or no longer holds. until_ns: until when it holds without being reported again."""

    cause: AlarmCause
    holds: bool
    since_ns: int
    until_ns: int | None = None
    raised: bool = False


class AlarmConditions:
    """All conditions that hold, or are not over for long enough. rules: returns the rules of the fleet file."""

    def __init__(self, register: AlarmRegister, clock: Clock, rules: Callable[[], AlarmRules]) -> None:
        self.register = register
        self._clock = clock
        self._rules = rules
        self._known: dict[str, _Condition] = {}
        self.started = False
        """Until the alarms of the last leader are restored, nothing is reported."""

    def restore(self, record: AlarmRecord, *, holds: bool, for_ns: int | None = None) -> None:
        """Take over an alarm that the last leader raised. holds, for_ns: as in `report`."""
        if record.is_active:
            cause = AlarmCause(
                kind=record.kind,
                subject=record.subject,
                text=record.text,
                action=record.action,
                code=record.code,
                priority=record.priority,
                source=record.source,
            )
            now_ns = self._clock.now_ns()
            until_ns = None if for_ns is None else now_ns + for_ns
            self._known[record.id] = _Condition(cause, holds, now_ns, until_ns, raised=True)

    def find_rule(self, cause: AlarmCause) -> AlarmRule:
        """The rule of the fleet file for a cause."""
        rule = None if cause.source else getattr(self._rules(), cause.kind.replace("-", "_"), None)
        return rule if isinstance(rule, AlarmRule) else self._rules().other

    def report(self, cause: AlarmCause, *, holds: bool, for_ns: int | None = None) -> None:
        """A condition holds, or not. for_ns: it is over after that time, unless it is reported again."""
        if not self.started:
            return
        now_ns, known_condition = self._clock.now_ns(), self._known.get(cause.id)
        holds = holds and self.find_rule(cause).enabled
        if known_condition is None:
            if not holds or len(self._known) >= MAX_CONDITIONS:
                return
            known_condition = self._known[cause.id] = _Condition(cause, holds, now_ns)
        if known_condition.holds != holds:
            known_condition.holds, known_condition.since_ns = holds, now_ns
        if holds:
            known_condition.cause = cause
        known_condition.until_ns = None if for_ns is None else now_ns + for_ns
        self._apply(known_condition, now_ns)

    def find_all(self, kind: str) -> list[AlarmCause]:
        """The causes of a kind whose conditions hold."""
        return [
            condition.cause for condition in self._known.values() if condition.holds and condition.cause.kind == kind
        ]

    def tick(self) -> None:
        """Raise and return what has held, or been over, for long enough."""
        now_ns = self._clock.now_ns()
        for known_condition in list(self._known.values()):
            over = known_condition.until_ns is not None and now_ns >= known_condition.until_ns
            if known_condition.holds and (over or not self.find_rule(known_condition.cause).enabled):
                known_condition.holds, known_condition.since_ns, known_condition.until_ns = False, now_ns, None
            self._apply(known_condition, now_ns)

    def _apply(self, known: _Condition, now_ns: int) -> None:
        rule, passed_ns = self.find_rule(known.cause), now_ns - known.since_ns
        if known.holds and not known.raised and passed_ns >= rule.for_:
            known.raised = True
            priority = known.cause.priority if known.cause.source else rule.priority
            self.register.raise_alarm(known.cause._replace(priority=priority))
        elif not known.holds and (not known.raised or passed_ns >= rule.return_after):
            del self._known[known.cause.id]
            if known.raised:
                self.register.return_alarm(known.cause.id)
