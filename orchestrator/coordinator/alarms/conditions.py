"""The conditions behind alarms: an alarm is raised when its condition has held for a while, and returns when that has
been over for a while, so that none flaps."""

from collections.abc import Callable
from dataclasses import dataclass

from orchestrator.clock.base import Clock
from orchestrator.coordinator.alarms.common_causes import CommonCause
from orchestrator.coordinator.alarms.folding import AlarmFolding
from orchestrator.coordinator.alarms.register import AlarmRegister
from orchestrator.model.alarm_rules import AlarmRule
from orchestrator.model.fleet import Fleet
from orchestrator.model.names import controller_of
from orchestrator.model.operation.alarms import AlarmCause, AlarmRecord

MAX_CONDITIONS = 20_000


@dataclass(slots=True)
class _Condition:
    """since_ns: since when it holds, or no longer holds. until_ns: until when it holds without being reported again.
    common: what it may have in common with others, for which it waits, or which it has joined. raised: also if another
    alarm stands for it."""

    cause: AlarmCause
    holds: bool
    since_ns: int
    until_ns: int | None = None
    raised: bool = False
    common: CommonCause | None = None


class AlarmConditions:
    """All conditions that hold, or are not over for long enough. fleet: returns the fleet, with its rules."""

    def __init__(self, register: AlarmRegister, clock: Clock, fleet: Callable[[], Fleet]) -> None:
        self.register = register
        self.folding = AlarmFolding(register, fleet)
        self._clock = clock
        self._fleet = fleet
        self._known: dict[str, _Condition] = {}
        self._by_controller: dict[tuple[str, str], set[str]] = {}
        """The ids of what is known, by kind and controller."""
        self.started = False
        """Until the alarms of the last leader are restored, nothing is reported."""

    def restore(self, record: AlarmRecord, *, holds: bool, for_ns: int | None = None) -> None:
        """Take over an alarm that the last leader raised. holds, for_ns: as in `report`."""
        if self.folding.restore(record, self._clock.now_ns()):
            return
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
            self._add(_Condition(cause, holds, now_ns, until_ns, raised=True))

    def find_rule(self, cause: AlarmCause) -> AlarmRule:
        """The rule of the fleet file for a cause."""
        rule = None if cause.source else getattr(self._fleet().alarms, cause.kind.replace("-", "_"), None)
        return rule if isinstance(rule, AlarmRule) else self._fleet().alarms.other

    def report(self, cause: AlarmCause, *, holds: bool, for_ns: int | None = None) -> None:
        """A condition holds, or not. for_ns: it is over after that time, unless it is reported again."""
        if not self.started:
            return
        now_ns, known_condition = self._clock.now_ns(), self._known.get(cause.id)
        holds = holds and self.find_rule(cause).enabled
        if known_condition is None:
            if not holds or len(self._known) >= MAX_CONDITIONS:
                return
            known_condition = self._add(_Condition(cause, holds, now_ns))
        if known_condition.holds != holds:
            known_condition.holds, known_condition.since_ns = holds, now_ns
        if holds:
            known_condition.cause = cause
        known_condition.until_ns = None if for_ns is None else now_ns + for_ns
        self._apply(known_condition, now_ns)

    def find_all(self, kind: str, controller: str) -> list[AlarmCause]:
        """The causes of a kind and a controller whose conditions hold."""
        known_conditions = [self._known[cause_id] for cause_id in self._by_controller.get((kind, controller), ())]
        return [condition.cause for condition in known_conditions if condition.holds]

    def _add(self, condition: _Condition) -> _Condition:
        cause = condition.cause
        self._by_controller.setdefault((cause.kind, controller_of(cause.subject)), set()).add(cause.id)
        self._known[cause.id] = condition
        return condition

    def _delete(self, cause: AlarmCause) -> None:
        del self._known[cause.id]
        ids = self._by_controller[cause.kind, controller_of(cause.subject)]
        ids.discard(cause.id)
        if not ids:
            del self._by_controller[cause.kind, controller_of(cause.subject)]

    def tick(self) -> None:
        """Raise and return what has held, or been over, for long enough."""
        now_ns = self._clock.now_ns()
        for known_condition in list(self._known.values()):
            over = known_condition.until_ns is not None and now_ns >= known_condition.until_ns
            if known_condition.holds and (over or not self.find_rule(known_condition.cause).enabled):
                known_condition.holds, known_condition.since_ns, known_condition.until_ns = False, now_ns, None
            self._apply(known_condition, now_ns)
        self._settle(now_ns)

    def _settle(self, now_ns: int) -> None:
        """Raise what has waited for others with the same cause: together with them, or by itself."""
        for cause_id, joins in list(self.folding.settle(now_ns)):
            known_condition = self._known[cause_id]
            common, known_condition.raised = known_condition.common, True
            if joins and common is not None:
                self.folding.join(common, self._prioritise(known_condition.cause))
            else:
                known_condition.common = None
                self.register.raise_alarm(self._prioritise(known_condition.cause))
        self.folding.update(now_ns)

    def _apply(self, known: _Condition, now_ns: int) -> None:
        rule, passed_ns = self.find_rule(known.cause), now_ns - known.since_ns
        if known.holds and not known.raised and passed_ns >= rule.for_:
            known.common = known.common or self.folding.find_common(known.cause)
            if known.common is not None:
                self.folding.gather(known.common, known.cause.id, now_ns)
                return
            known.raised = True
            self.register.raise_alarm(self._prioritise(known.cause))
        elif not known.holds and (not known.raised or passed_ns >= rule.return_after):
            self._end(known)

    def _end(self, known: _Condition) -> None:
        if known.common is not None and not known.raised:
            return  # it waits for others, and is to be seen although it is over
        self._delete(known.cause)
        if known.common is not None:
            self.folding.leave(known.common, known.cause.id)
        elif known.raised:
            self.register.return_alarm(known.cause.id)

    def _prioritise(self, cause: AlarmCause) -> AlarmCause:
        return cause._replace(priority=cause.priority if cause.source else self.find_rule(cause).priority)
