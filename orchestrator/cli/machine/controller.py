"""`tutti raw`: a command in a controller's own language."""

import click

from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, with_fleet
from orchestrator.cli.base.completion import complete_controllers


@click.command(epilog='Example: tutti raw gantry "MG TIME" --i-know')
@click.argument("controller", shell_complete=complete_controllers)
@click.argument("command")
@click.option("--i-know", is_flag=True, help="Confirm: the command is sent without any limit check.")
@fleet_options
@json_option
def raw(controller: str, command: str, connect: str, fleet: str | None, *, i_know: bool, as_json: bool) -> None:
    """Send COMMAND to CONTROLLER in the controller's own language and print its reply. It is logged."""
    from orchestrator.client import Tutti

    async def send_command(tutti: Tutti) -> None:
        reply = await tutti.send_raw(controller, command, i_know=i_know)
        print_json({"reply": reply}) if as_json else console.print(reply, highlight=False, markup=False)

    with_fleet(connect, fleet, send_command)
