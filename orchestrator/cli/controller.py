"""`tutti raw` and `tutti trace`: one controller's link."""

import click

from orchestrator.cli.common import console, fleet_options, json_option, print_json, with_fleet


@click.command(epilog='Example: tutti raw gantry "MG TIME" --i-know')
@click.argument("controller")
@click.argument("command")
@click.option("--i-know", is_flag=True, help="Yes, send it: no limit is checked.")
@fleet_options
@json_option
def raw(controller: str, command: str, i_know: bool, connect: str, fleet: str | None, as_json: bool) -> None:
    """Send COMMAND to CONTROLLER in the controller's own language and print its reply. It is logged."""
    from orchestrator.client import Tutti

    async def act(tutti: Tutti) -> None:
        reply = await tutti.raw(controller, command, i_know)
        print_json({"reply": reply}) if as_json else console.print(reply, highlight=False, markup=False)

    with_fleet(connect, fleet, act)


@click.command(epilog="Example: tutti trace gantry")
@click.argument("controller")
@fleet_options
@json_option
def trace(controller: str, connect: str, fleet: str | None, as_json: bool) -> None:
    """Show the bytes of the last 60 s on CONTROLLER's link: seconds before now, direction, text."""
    from orchestrator.client import Tutti

    async def act(tutti: Tutti) -> None:
        reply = await tutti.trace(controller)
        if as_json:
            print_json(reply.to_plain())
            return
        console.print(f"{reply.utc} is 0 s", highlight=False)
        for at_ns, direction, text in reply.entries:
            shown = text.encode("unicode_escape").decode("ascii")
            arrow = "→" if direction == "out" else "←"
            console.print(
                f"{(at_ns - reply.host_ns) / 1e9:+11.6f} s {arrow} {shown}",
                highlight=False,
                markup=False,
                soft_wrap=True,
            )

    with_fleet(connect, fleet, act)
