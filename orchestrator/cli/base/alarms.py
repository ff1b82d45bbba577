"""Alarms in a terminal."""

from collections import Counter
from collections.abc import Sequence

from rich.console import RenderableType
from rich.text import Text

from orchestrator.cli.base.common import console
from orchestrator.model.operation.alarms import AlarmRecord
from orchestrator.monitor.tables import make_plain_table
from orchestrator.monitor.times import format_time

PRIORITIES = {"high": "bold red", "medium": "yellow", "low": "cyan"}


def make_alarm_table(alarms: Sequence[AlarmRecord], *, actions: bool) -> RenderableType:
    """Build a table with one row per alarm, and its text below. actions: with what to do while its cause holds."""
    table = make_plain_table(["priority", "state", "raised", "alarm"])
    for alarm in alarms:
        unseen = alarm.state != "acknowledged" and alarm.is_open
        priority = Text(alarm.priority, PRIORITIES[alarm.priority] if alarm.is_open else "dim")
        state = Text(alarm.state, "bold" if unseen else "")
        style = "" if alarm.is_open else "dim"
        table.add_row(priority, state, format_time(alarm.raised_utc), alarm.id, style=style)
        times = f" ({alarm.count} times)" if alarm.count > 1 else ""
        action = f" → {alarm.action}" if actions and alarm.is_active and alarm.action else ""
        absence = describe_absence(alarm)
        table.add_note(f"{alarm.text}{times}{action}" + (f"\n{absence}" if absence else ""))
    return table


def describe_absence(alarm: AlarmRecord) -> str:
    """Why an alarm is set aside; empty if it is not."""
    if alarm.shelved_until_utc is not None:
        reason = f": {alarm.shelved_why}" if alarm.shelved_why else ""
        return f"shelved by {alarm.shelved_by} until {format_time(alarm.shelved_until_utc)}{reason}"
    return f"out of service: {alarm.out_of_service}" if alarm.out_of_service else ""


def print_open_alarms(alarms: Sequence[AlarmRecord]) -> None:
    """Print one line about the alarms that wait for a user, if there are any."""
    waiting_alarms = [alarm for alarm in alarms if alarm.is_open]
    if not waiting_alarms:
        return
    counts = Counter(record.priority for record in waiting_alarms)
    count_list = ", ".join(f"{counts[priority]} {priority}" for priority in PRIORITIES if counts[priority])
    new = sum(record.state != "acknowledged" for record in waiting_alarms)
    worst = next(priority for priority in PRIORITIES if counts[priority])
    text = f"alarms: {count_list}; {new} not acknowledged → `tutti alarm ls`"
    console.print(text, style=PRIORITIES[worst], highlight=False, markup=False)
