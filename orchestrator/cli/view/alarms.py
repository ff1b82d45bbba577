"""`tutti alarm …`: alarms listed, acknowledged and shelved."""

from typing import TYPE_CHECKING

import click
from click.shell_completion import CompletionItem

from orchestrator.cli.base.codes import BAD_INPUT
from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, print_result, with_fleet
from orchestrator.cli.base.durations import DurationType
from orchestrator.cli.base.errors import exit_with_error

if TYPE_CHECKING:
    from orchestrator.client import Tutti


def _complete_alarms(context: click.Context, _: click.Parameter, begun: str) -> list[CompletionItem]:
    from orchestrator.cli.base.completion import ask_fleet

    records = ask_fleet(context, lambda tutti: tutti.list_alarms()) or []
    return [CompletionItem(record.id, help=record.text) for record in records if record.id.startswith(begun)]


_ID = click.argument("alarm_id", metavar="ID", shell_complete=_complete_alarms)


@click.group(epilog="Example: tutti alarm ls")
def alarm() -> None:
    """List, acknowledge and shelve alarms.

    An alarm is unacknowledged until a user acknowledges it, also when its cause is over: then it is returned. It is
    normal when both have happened. No alarm moves or stops anything.
    """


@alarm.command("ls", epilog="Example: tutti alarm ls --all")
@click.option("--all", "everything", is_flag=True, help="Also alarms that are normal.")
@click.option("--history", default=0, type=click.IntRange(0, 10_000), help="The last changes of alarms, so many.")
@fleet_options
@json_option
def list_alarms(history: int, connect: str, fleet: str | None, *, everything: bool, as_json: bool) -> None:
    """List the alarms: first those that wait for a user, by priority, each with what to do."""
    from orchestrator.cli.base.alarms import make_alarm_table

    async def show_alarms(tutti: "Tutti") -> None:
        records = await (tutti.list_alarm_history(history) if history else tutti.list_alarms(normal=everything))
        if as_json:
            print_json([record.to_plain() for record in records])
        elif records:
            console.print(make_alarm_table(records, actions=not history))
        else:
            console.print("no alarms", highlight=False)

    with_fleet(connect, fleet, show_alarms)


@alarm.command("ack", epilog="Example: tutti alarm ack disconnected-stage")
@click.argument("alarm_ids", metavar="ID...", nargs=-1, shell_complete=_complete_alarms)
@click.option("--all", "everything", is_flag=True, help="All alarms that are not acknowledged.")
@fleet_options
@json_option
def acknowledge(
    alarm_ids: tuple[str, ...], connect: str, fleet: str | None, *, everything: bool, as_json: bool
) -> None:
    """Acknowledge the alarms ID: a person has seen them. The user and the time are kept."""
    if everything == bool(alarm_ids):
        exit_with_error("name alarms, or give --all", BAD_INPUT)

    async def acknowledge_alarms(tutti: "Tutti") -> None:
        alarms = await tutti.acknowledge_alarms(*alarm_ids)
        words = "\n".join(f"{record.id}: {record.state}" for record in alarms) or "nothing had to be acknowledged"
        print_result([record.to_plain() for record in alarms], words, as_json=as_json)

    with_fleet(connect, fleet, acknowledge_alarms)


@alarm.command(epilog='Example: tutti alarm shelve disconnected-stage --for 2h --why "cable is being changed"')
@_ID
@click.option("--for", "seconds", required=True, type=DurationType("24h"), help="How long, at most 24h.")
@click.option("--why", default="", help="The reason, for others.")
@fleet_options
@json_option
def shelve(alarm_id: str, seconds: float, why: str, connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Set the alarm ID aside for a time, in which it waits for no user. It comes back by itself."""
    from orchestrator.monitor.times import format_time

    async def shelve_alarm(tutti: "Tutti") -> None:
        record = await tutti.shelve_alarm(alarm_id, seconds, why)
        words = f"{record.id} is shelved until {format_time(record.shelved_until_utc or '')}"
        print_result(record.to_plain(), words, as_json=as_json)

    with_fleet(connect, fleet, shelve_alarm)


@alarm.command(epilog="Example: tutti alarm unshelve disconnected-stage")
@_ID
@fleet_options
@json_option
def unshelve(alarm_id: str, connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Bring the alarm ID back before its time."""

    async def unshelve_alarm(tutti: "Tutti") -> None:
        record = await tutti.unshelve_alarm(alarm_id)
        print_result(record.to_plain(), f"{record.id}: {record.state}", as_json=as_json)

    with_fleet(connect, fleet, unshelve_alarm)
