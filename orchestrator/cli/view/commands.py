"""`tutti command …`: the commands of users that changed something."""

from datetime import datetime
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, with_fleet
from orchestrator.cli.base.instants import InstantType

if TYPE_CHECKING:
    from orchestrator.client import Tutti


@click.group(epilog="Example: tutti command ls")
def command() -> None:
    """Commands of users, as the journal has them: by which user, when, and whether they were refused."""


@command.command("ls", epilog="Example: tutti command ls --by anna --limit 100")
@click.option("--limit", default=20, show_default=True, type=click.IntRange(1, 1000))
@click.option("--before", default=None, type=InstantType(past=True), help="Given before this time, or an age: 7d.")
@click.option("--by", default="", help="Only of users with this text in their name.")
@fleet_options
@json_option
def list_commands(
    limit: int, before: datetime | None, by: str, connect: str, fleet: str | None, *, as_json: bool
) -> None:
    """List the newest commands that changed something, the newest first."""
    from orchestrator.monitor.tables import make_plain_table
    from orchestrator.monitor.times import format_time

    async def show_commands(tutti: "Tutti") -> None:
        end_utc = None if before is None else before.isoformat()
        commands = await tutti.list_commands(limit, before=end_utc, by=by)
        if as_json:
            print_json([record.to_plain() for record in commands])
            return
        table = make_plain_table(["time", "user", "command", "about", "refused"], ["user", "about"])
        for record in commands:
            table.add_row(format_time(record.utc), record.actor, record.verb, record.subject, record.refused)
        console.print(table)

    with_fleet(connect, fleet, show_commands)
