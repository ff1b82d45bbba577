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
    for each in alarms:
        unseen = each.state != "acknowledged" and each.is_open
        priority = Text(each.priority, PRIORITIES[each.priority] if each.is_open else "dim")
        state = Text(each.state, "bold" if unseen else "")
        style = "" if each.is_open else "dim"
        table.add_row(priority, state, format_time(each.raised_utc), each.id, style=style)
        times = f" ({each.count} times)" if each.count > 1 else ""
        action = f" → {each.action}" if actions and each.is_active and each.action else ""
        absence = describe_absence(each)
        table.add_note(f"{each.text}{times}{action}" + (f"\n{absence}" if absence else ""))
    return table


def describe_absence(alarm: AlarmRecord) -> str:
    """Why an alarm is set aside; empty if it is not."""
    if alarm.shelved_until_utc is not None:
        why = f": {alarm.shelved_why}" if alarm.shelved_why else ""
        return f"shelved by {alarm.shelved_by} until {format_time(alarm.shelved_until_utc)}{why}"
    return f"out of service: {alarm.out_of_service}" if alarm.out_of_service else ""


def print_open_alarms(alarms: Sequence[AlarmRecord]) -> None:
    """Print one line about the alarms that wait for a user, if there are any."""
    waiting = [each for each in alarms if each.is_open]
    if not waiting:
        return
    counts = Counter(each.priority for each in waiting)
    shown = ", ".join(f"{counts[each]} {each}" for each in PRIORITIES if counts[each])
    new = sum(each.state != "acknowledged" for each in waiting)
    worst = next(each for each in PRIORITIES if counts[each])
    text = f"alarms: {shown}; {new} not acknowledged → `tutti alarm ls`"
    console.print(text, style=PRIORITIES[worst], highlight=False, markup=False)
