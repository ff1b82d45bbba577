"""`tutti repair …`: repairs that a person decides on."""

import click

from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, with_fleet


@click.group(epilog="Example: tutti repair epoch")
def repair() -> None:
    """Repair what a fleet does not repair by itself, because a person has to know that it is safe."""


@repair.command(epilog="Example: tutti repair epoch")
@fleet_options
@json_option
def epoch(connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Let controllers accept the present coordinator, although they remember an epoch that no coordinator has.

    Each start of a coordinator takes an epoch, and adapters refuse older ones. A damaged file or a forged message can
    leave one that is never reached. All axes must be at rest, and no other coordinator may lead the fleet. Nothing is
    sent to the controllers.
    """
    from orchestrator.client import Tutti

    async def repair_epoch(tutti: Tutti) -> None:
        controllers = await tutti.repair_epoch()
        if as_json:
            print_json({"repaired": controllers})
        elif controllers:
            console.print(f"{', '.join(controllers)}: the coordinator's epoch is accepted", highlight=False)
        else:
            console.print("every controller has accepted the coordinator already; nothing was changed")

    with_fleet(connect, fleet, repair_epoch)
