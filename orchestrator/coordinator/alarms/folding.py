"""Alarms of one cause in many controllers are one alarm with a count.

What may have a common cause is gathered for a second. If enough conditions have come by then, they are one alarm, which
others join as long as it holds; otherwise each is an alarm of its own.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.alarms.common_causes import CommonCause, describe_common, find_common, read_common
from orchestrator.coordinator.alarms.register import AlarmRegister
from orchestrator.model.fleet import Fleet
from orchestrator.model.operation.alarms import AlarmCause, AlarmRecord

FOLD_FROM = 5  # conditions
GATHER_NS = NS_PER_S
UPDATE_NS = 10 * NS_PER_S  # between two changes of the text of an alarm: each is in the history
RESTORED_NS = 30 * NS_PER_S  # an alarm of the last leader is over if nothing has joined it by then


@dataclass(slots=True)
class _Group:
    """waiting: by id, since when. members: those that the alarm stands for, by id. worded_ns: when its text was made;
    None: it is not raised."""

    waiting: dict[str, int] = field(default_factory=dict[str, int])
    members: dict[str, AlarmCause] = field(default_factory=dict[str, AlarmCause])
    worded_ns: int | None = None
    kept_until_ns: int = 0
    is_changed: bool = False


class AlarmFolding:
    """The groups of conditions with one cause. fleet: returns the fleet. is_apart: whether a cause counts by itself,
    whatever it has in common."""

    def __init__(self, register: AlarmRegister, fleet: Callable[[], Fleet]) -> None:
        self._register, self._fleet = register, fleet
        self._groups: dict[CommonCause, _Group] = {}
        self.is_apart: Callable[[AlarmCause], bool] = lambda _: False

    def restore(self, record: AlarmRecord, now_ns: int) -> bool:
        """Take over an alarm of the last leader that stands for many; return whether it does."""
        common = read_common(record)
        if common is not None and record.is_active:
            self._groups[common] = _Group(worded_ns=now_ns, kept_until_ns=now_ns + RESTORED_NS)
        return common is not None

    def find_common(self, cause: AlarmCause) -> CommonCause | None:
        """What a condition may have in common with others; None: it is to be an alarm of its own, now."""
        common = find_common(self._fleet(), cause)
        return None if common is None or self.is_apart(cause) else common

    def gather(self, common: CommonCause, cause_id: str, now_ns: int) -> None:
        """A condition has held for long enough: it waits for others."""
        self._groups.setdefault(common, _Group()).waiting.setdefault(cause_id, now_ns)

    def leave(self, common: CommonCause, cause_id: str) -> None:
        """A condition that has joined an alarm is over."""
        group = self._groups.get(common)
        if group is not None and group.members.pop(cause_id, None) is not None:
            group.is_changed = True

    def settle(self, now_ns: int) -> Iterator[tuple[str, bool]]:
        """The conditions that have waited for long enough, each with whether it joins others. Those that do are to be
        passed to `join` before `update`."""
        for group in self._groups.values():
            oldest_ns = min(group.waiting.values(), default=now_ns)
            if group.worded_ns is None and now_ns - oldest_ns < GATHER_NS:
                continue
            joins = group.worded_ns is not None or len(group.waiting) >= FOLD_FROM
            settled_ids = [cause_id for cause_id, ns in group.waiting.items() if joins or now_ns - ns >= GATHER_NS]
            for cause_id in settled_ids:
                del group.waiting[cause_id]
                yield cause_id, joins

    def join(self, common: CommonCause, cause: AlarmCause) -> None:
        """A condition becomes one of those that the alarm stands for."""
        group = self._groups[common]
        group.members[cause.id] = cause
        group.is_changed = True

    def update(self, now_ns: int) -> None:
        """Raise, word and return the alarms, by what has joined and left."""
        for common, group in list(self._groups.items()):
            if group.members:
                self._show(common, group, now_ns)
            elif group.worded_ns is not None and now_ns >= group.kept_until_ns:
                self._register.return_alarm(common.alarm_id)
                group.worded_ns = None
            if not group.members and not group.waiting and group.worded_ns is None:
                del self._groups[common]

    def _show(self, common: CommonCause, group: _Group, now_ns: int) -> None:
        is_new = group.worded_ns is None or group.kept_until_ns > 0
        if not group.is_changed or not (is_new or now_ns - (group.worded_ns or 0) >= UPDATE_NS):
            return
        group.is_changed, group.worded_ns, group.kept_until_ns = False, now_ns, 0
        self._register.raise_alarm(describe_common(self._fleet(), common, group.members.values()))
