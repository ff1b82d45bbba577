"""The register of all alarms: their states in memory, on the bus, and in the journal.

It only describes: nothing moves or stops because of an alarm.
"""

import difflib
from collections.abc import Callable, Iterable
from datetime import timedelta
from functools import partial

from orchestrator.bus.base import Bus, BusDeclaration, BusSample, Priority, RequestRefused
from orchestrator.bus.keys import FleetKeys
from orchestrator.coordinator.alarms.store import AlarmStore
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.journal.facts import AlarmChange
from orchestrator.model.errors import Refusal
from orchestrator.model.operation.alarms import (
    AcknowledgeAlarms,
    AlarmCause,
    AlarmRecord,
    AlarmsAcknowledged,
    AlarmShelved,
    AlarmsListed,
    ListAlarms,
    ShelveAlarm,
)
from orchestrator.model.operation.transitions import (
    acknowledge_alarm,
    raise_alarm,
    return_alarm,
    set_out_of_service,
    shelve_alarm,
    unshelve_alarm,
)
from orchestrator.model.queue import format_utc, parse_utc

MAX_ALARMS = 1_000  # those that are normal go first
ORDER = ("high", "medium", "low")

Transition = Callable[[AlarmRecord], AlarmRecord]


class AlarmRegister:
    """All alarms of the fleet."""

    def __init__(self, access: FleetAccess, store: AlarmStore, bus: Bus, keys: FleetKeys) -> None:
        self._access = access
        self._store = store
        self._bus = bus
        self._keys = keys
        self._records: dict[str, AlarmRecord] = {}
        self._served: dict[str, BusDeclaration] = {}
        self._changes = 0
        self.epoch = 0
        self.explain_absence: Callable[[AlarmRecord], str] = lambda _: ""
        """Returns why an alarm is out of service; empty: it is not."""
        self.needs_notice: Callable[[AlarmRecord], bool] = lambda _: False
        """Returns whether a command is to be run for an alarm that a user is to see now."""
        self.on_notice: Callable[[AlarmRecord], None] = lambda _: None
        """Called then."""

    def restore(self, records: Iterable[AlarmRecord]) -> None:
        """Take over what the last leader has left. Called before any other change."""
        self._records = {record.id: record for record in records}

    async def close(self) -> None:
        """Serve no alarm any more."""
        served_declarations, self._served = list(self._served.values()), {}
        for declaration in served_declarations:
            await declaration.undeclare()

    @property
    def records(self) -> list[AlarmRecord]:
        """All alarms, also those that are normal."""
        return list(self._records.values())

    # Changes by conditions

    def raise_alarm(self, cause: AlarmCause) -> None:
        """The condition of an alarm holds."""
        record_before = self._records.get(cause.id)
        if record_before is None and not self._make_room():
            self._access.log.warning(f"an alarm is left out, because there are {MAX_ALARMS}: {cause.text}")
            return
        alarm_after = raise_alarm(record_before, cause, self._access.clock.utc())
        self._take(set_out_of_service(alarm_after, self.explain_absence(alarm_after)), record_before)

    def return_alarm(self, alarm_id: str) -> None:
        """The condition of an alarm is over."""
        self._change(alarm_id, lambda record_before: return_alarm(record_before, self._access.clock.utc()))

    def check_service(self) -> None:
        """Set alarms out of service, and into service again, by `explain_absence`."""
        for alarm_id, record in list(self._records.items()):
            self._change(alarm_id, partial(set_out_of_service, why=self.explain_absence(record)))

    def end_shelving(self) -> None:
        """Unshelve the alarms whose time has come."""
        utc_now = self._access.clock.utc()
        for alarm_id, record in list(self._records.items()):
            if record.shelved_until_utc is not None and record.shelved_until_utc <= utc_now:
                self._change(alarm_id, unshelve_alarm)

    def _change(self, alarm_id: str, change: Transition) -> None:
        record_before = self._records.get(alarm_id)
        if record_before is not None:
            self._take(change(record_before), record_before)

    def _take(self, after: AlarmRecord, before: AlarmRecord | None) -> None:
        """Take a changed record over, and have it written."""
        if after is not before:
            change = self._make_change(after, before)
            self._store.add_change(change)
            self._show(change, before)

    def _make_change(self, after: AlarmRecord, before: AlarmRecord | None) -> AlarmChange:
        """The change with a name of its own. It needs a notice if a user is to see it now: the alarm is unacknowledged
        and not set aside, and was not so before."""
        self._changes += 1
        named_record = after.model_copy(update={"change": f"{self.epoch}-{self._changes}"})
        was = before is not None and _is_annunciated(before)
        return AlarmChange(named_record, _is_annunciated(named_record) and not was and self.needs_notice(named_record))

    def _show(self, change: AlarmChange, before: AlarmRecord | None) -> None:
        record = self._records[change.record.id] = change.record
        if before is None or before.state != record.state:
            self._access.log.info(f"alarm {record.id} is {record.state}", priority=record.priority)
        self._bus.put(self._keys.alarm(record.id), record.to_json(), Priority.EVENT)
        if change.notify:
            self.on_notice(record)

    def _make_room(self) -> bool:
        """Forget the oldest alarm that is normal, if there are too many; False if there is none."""
        if len(self._records) < MAX_ALARMS:
            return True
        normal = [record for record in self._records.values() if record.state == "normal" and not record.is_suppressed]
        if not normal:
            return False
        oldest = min(normal, key=lambda record: record.raised_utc).id
        del self._records[oldest]
        self._store.forget_alarm(oldest)
        return True

    # On the bus

    async def serve_new(self) -> None:
        """Serve the alarms that are new, so that a late reader finds them, and no longer those that are forgotten."""
        for alarm_id in [known_id for known_id in self._records if known_id not in self._served]:
            self._served[alarm_id] = await self._bus.serve(self._keys.alarm(alarm_id), self._reply_alarm)
        for alarm_id in [served_id for served_id in self._served if served_id not in self._records]:
            await self._served.pop(alarm_id).undeclare()

    async def _reply_alarm(self, sample: BusSample) -> bytes:
        record = self._records.get(sample.key.rpartition("/")[2])
        if record is None:
            raise RequestRefused("there is no such alarm")
        return record.to_json()

    # Requests of users

    async def list_alarms(self, request: ListAlarms) -> AlarmsListed:
        """List alarms: the more urgent ones first, and of one priority the newest. Raises `JournalError`."""
        shown_records = [record for record in self._records.values() if request.all or record.state != "normal"]
        shown_records.sort(key=lambda record: record.raised_utc, reverse=True)
        shown_records.sort(key=lambda record: (not record.is_open, ORDER.index(record.priority)))
        history = await self._store.load_history(request.history) if request.history else []
        return AlarmsListed(alarms=shown_records, history=history)

    async def acknowledge_alarms(self, request: AcknowledgeAlarms) -> AlarmsAcknowledged:
        """Acknowledge alarms; it is in the journal when this is answered. Raises `Refusal`, `JournalError`."""
        utc = self._access.clock.utc()
        ids = request.alarm_ids or list(self._records)
        for alarm_id in ids:
            self._require(alarm_id)
        changed_records = await self._change_recorded(
            ids, lambda record_before: acknowledge_alarm(record_before, request.actor, utc)
        )
        return AlarmsAcknowledged(alarms=changed_records)

    async def shelve_alarm(self, request: ShelveAlarm) -> AlarmShelved:
        """Set an alarm aside, or no longer; it is in the journal when this is answered. Raises `Refusal`,
        `JournalError`."""
        self._require(request.alarm_id)
        if request.for_s is None:
            change: Transition = unshelve_alarm
        else:
            end_utc = parse_utc(self._access.clock.utc()) + timedelta(seconds=request.for_s)
            change = partial(shelve_alarm, until_utc=format_utc(end_utc), actor=request.actor, why=request.why)
        await self._change_recorded([request.alarm_id], change)
        return AlarmShelved(alarm=self._records[request.alarm_id])

    def _require(self, alarm_id: str) -> None:
        if alarm_id not in self._records:
            matches = difflib.get_close_matches(alarm_id, self._records, 1)
            hint = f"did you mean {matches[0]}? " if matches else ""
            raise Refusal("unknown-alarm", f"there is no alarm {alarm_id}", f"{hint}see `tutti alarm ls --all`")

    async def _change_recorded(self, ids: Iterable[str], change: Transition) -> list[AlarmRecord]:
        """Change alarms once it is in the journal; return those that have changed. Raises `JournalError`."""
        records_before = {alarm_id: self._records[alarm_id] for alarm_id in ids}
        records_after = {alarm_id: change(record) for alarm_id, record in records_before.items()}
        changes = [
            self._make_change(records_after[alarm_id], records_before[alarm_id])
            for alarm_id in records_before
            if records_after[alarm_id] is not records_before[alarm_id]
        ]
        if changes:
            await self._store.write_pending(*changes)
        for alarm_change in changes:
            record_now = self._records.get(alarm_change.record.id)
            if record_now is records_before[alarm_change.record.id]:
                self._show(alarm_change, record_now)
            elif record_now is not None:  # its condition has changed while this was written
                self._take(change(record_now), record_now)
        return [
            self._records[alarm_change.record.id] for alarm_change in changes if alarm_change.record.id in self._records
        ]


def _is_annunciated(record: AlarmRecord) -> bool:
    return record.state == "unacknowledged" and not record.is_suppressed
