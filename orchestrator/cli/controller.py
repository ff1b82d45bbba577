"""`tutti raw` and `tutti trace`: one controller's link."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, with_fleet
from orchestrator.cli.base.completion import complete_controllers

if TYPE_CHECKING:
    from adapters.link.can_log import LogFormat
    from orchestrator.link.trace import TraceEntry
    from orchestrator.model.messages import TraceReply


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


@click.command(epilog="Examples: tutti trace gantry; tutti trace spindle --format blf --output spindle.blf")
@click.argument("controller", shell_complete=complete_controllers)
@click.option("--format", "form", type=click.Choice(["asc", "blf", "candump"]), help="Format of a CAN bus log.")
@click.option("--output", type=click.Path(dir_okay=False, path_type=Path), help="Output file of the log.")
@fleet_options
@json_option
def trace(
    controller: str,
    form: "LogFormat | None",
    output: Path | None,
    connect: str,
    fleet: str | None,
    *,
    as_json: bool,
) -> None:
    """Show the bytes of the last 60 s on CONTROLLER's link: seconds before now, direction, text.

    With --format and --output, write the frames of its CAN bus to a log file for other tools.
    """
    if (form is None) != (output is None):
        raise click.UsageError("--format and --output must be given together")
    from orchestrator.client import Tutti
    from orchestrator.monitor.times import format_time

    async def show_trace(tutti: Tutti) -> None:
        reply = await tutti.read_trace(controller)
        if form is not None and output is not None:
            count = _write_log(reply, form, output, controller)
            print_json({"frames": count, "file": str(output)}) if as_json else console.print(
                f"{count} frames in {output}", highlight=False, markup=False
            )
            return
        if as_json:
            print_json(reply.to_plain())
            return
        console.print(f"{format_time(reply.utc, precise=True)} is 0 s", highlight=False)
        for at_ns, direction, text in reply.entries:
            shown = text.encode("unicode_escape").decode("ascii")
            arrow = "→" if direction == "out" else "←"
            console.print(
                f"{(at_ns - reply.host_ns) / 1e9:+11.6f} s {arrow} {shown}",
                highlight=False,
                markup=False,
                soft_wrap=True,
            )

    with_fleet(connect, fleet, show_trace)


def _write_log(reply: "TraceReply", form: "LogFormat", output: Path, controller: str) -> int:
    """Write the log and return the number of frames. Raises `click.ClickException`."""
    from datetime import datetime

    from adapters.link.can_log import write_log

    entries: list[TraceEntry] = [(at_ns, direction, text.encode("latin-1")) for at_ns, direction, text in reply.entries]
    origin_s = datetime.fromisoformat(reply.utc).timestamp() - reply.host_ns / 1e9
    try:
        return write_log(output, form, entries, origin_s)
    except ValueError as error:
        raise click.ClickException(f"{controller} is not on a CAN bus: {error}; trace it without --format") from None
    except OSError as error:
        raise click.ClickException(f"{output}: {error.strerror}; choose another file: --output") from None
