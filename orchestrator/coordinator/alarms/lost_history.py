"""The alarm of a journal that has lost history. The coordinator that must not lead on it raises it: at the leader on
the newer line, if there is one, and by the command of the fleet file, as no leader may be left that would run it.
"""

from hashlib import sha256
from pathlib import Path

from orchestrator.bus.base import Bus, Priority
from orchestrator.bus.keys import FleetKeys
from orchestrator.coordinator.alarms.notifier import make_variables
from orchestrator.coordinator.journal.records import HistoryLost
from orchestrator.coordinator.leadership.environment import RunCommand
from orchestrator.model.alarm_rules import NotifyCommand
from orchestrator.model.files.private_files import replace_private_file
from orchestrator.model.operation.alarms import AlarmRecord, AlarmRequest

KIND, SUBJECT = "journal-history", "journal"


class LostHistoryAlarm:
    """The alarm of one computer.

    folder: of its state. The change for which the command has succeeded is kept there: a service that is started again
    and again runs it once.
    """

    def __init__(self, folder: Path, bus: Bus, keys: FleetKeys, run_command: RunCommand) -> None:
        self._file = folder / "history-lost"
        self._bus = bus
        self._keys = keys
        self._run_command = run_command

    async def raise_alarm(self, error: HistoryLost, command: NotifyCommand | None, utc: str) -> str:
        """Publish it, and run the command once. Return why the command has failed; empty: it has not."""
        request = AlarmRequest(
            kind=KIND, subject=SUBJECT, text=error.text, action=error.remedy, priority="high", active=True
        )
        self._bus.put(self._keys.alarm_request("coordinator", SUBJECT), request.to_json(), Priority.EVENT)
        # The same for each repetition, and of no leader's alarm: those have an epoch there.
        change = f"{KIND}-{sha256(error.text.encode()).hexdigest()[:12]}"
        if command is None or request.priority not in command.priorities or change == self._read_change():
            return ""
        record = AlarmRecord(
            id=f"{KIND}-{SUBJECT}",
            kind=KIND,
            subject=SUBJECT,
            source=f"coordinator/{SUBJECT}",
            priority=request.priority,
            text=error.text,
            action=error.remedy,
            state="unacknowledged",
            raised_utc=utc,
            change=change,
        )
        result = await self._run_command(command.command, record.to_json(), make_variables(record), command.timeout)
        if result.exit_code != 0:
            return result.why or f"exit code {result.exit_code}"
        replace_private_file(self._file, change.encode())
        return ""

    def clear(self) -> None:
        """The journal is led on: another loss is another alarm."""
        self._file.unlink(missing_ok=True)

    def _read_change(self) -> str:
        try:
            return self._file.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError):
            return ""
