"""Requests about alarms, statistics and the commands of users."""

from datetime import UTC, datetime, timedelta

from orchestrator.client.connection import FleetConnection
from orchestrator.model.operation.alarms import (
    AcknowledgeAlarms,
    AlarmRecord,
    AlarmsAcknowledged,
    AlarmShelved,
    AlarmsListed,
    ListAlarms,
    ShelveAlarm,
)
from orchestrator.model.operation.commands import CommandRecord, CommandsListed, ListCommands
from orchestrator.model.operation.statistics import ReadStatistics, StatisticsRead


class OperationRequests(FleetConnection):
    """List, acknowledge and shelve alarms; read statistics; list commands."""

    async def list_alarms(self, *, normal: bool = False) -> list[AlarmRecord]:
        """The alarms: those that wait for a user first, by priority. normal: also those that are over and acknowledged.
        Raises `Refusal`."""
        request = ListAlarms(**self.request_fields(), all=normal)
        return (await self.request_service("alarms", request, AlarmsListed)).alarms

    async def list_alarm_history(self, limit: int = 100) -> list[AlarmRecord]:
        """The last changes of alarms, the newest first: each alarm as it was then. Raises `Refusal`."""
        request = ListAlarms(**self.request_fields(), history=limit)
        return (await self.request_service("alarms", request, AlarmsListed)).history

    async def acknowledge_alarms(self, *alarm_ids: str) -> list[AlarmRecord]:
        """Acknowledge alarms, for this actor; without ids, all of them. Returns those that have changed. Raises
        `Refusal`: codes `unknown-alarm`, `journal`."""
        request = AcknowledgeAlarms(**self.request_fields(), alarm_ids=list(alarm_ids))
        return (await self.request_service("acknowledge", request, AlarmsAcknowledged)).alarms

    async def shelve_alarm(self, alarm_id: str, for_s: float, why: str = "") -> AlarmRecord:
        """Set an alarm aside for at most a day; it comes back by itself. Raises `Refusal`: codes `unknown-alarm`,
        `journal`."""
        return await self._shelve(alarm_id, for_s, why)

    async def unshelve_alarm(self, alarm_id: str) -> AlarmRecord:
        """End the shelving of an alarm. Raises `Refusal`: codes `unknown-alarm`, `journal`."""
        return await self._shelve(alarm_id, None, "")

    async def read_statistics(self, since: str | None = None, *, by_day: bool = False) -> StatisticsRead:
        """What axes, controllers and jobs have done. since: a UTC day, `2026-01-31`; None: the last week. by_day: also
        those of each day. Raises `Refusal`: codes `too-much`, `journal`."""
        if since is None:
            since = (datetime.now(UTC) - timedelta(days=7)).date().isoformat()
        request = ReadStatistics(**self.request_fields(), since=since, by_day=by_day)
        return await self.request_service("statistics", request, StatisticsRead)

    async def list_commands(self, limit: int = 100, *, before: str | None = None, by: str = "") -> list[CommandRecord]:
        """The commands of users that changed something, the newest first, at most 1000. before: an RFC 3339 time, e.g.
        that of the last one of a list, for the next ones. by: only of users with this text in their name. Raises
        `Refusal`: code `journal`."""
        request = ListCommands(**self.request_fields(), limit=limit, before=before, by=by)
        return (await self.request_service("commands", request, CommandsListed)).commands

    async def _shelve(self, alarm_id: str, for_s: float | None, why: str) -> AlarmRecord:
        request = ShelveAlarm(**self.request_fields(), alarm_id=alarm_id, for_s=for_s, why=why)
        alarm = (await self.request_service("shelve", request, AlarmShelved)).alarm
        assert alarm is not None
        return alarm
