"""`tutti io …`: named inputs and outputs."""

import click

from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, with_fleet
from orchestrator.cli.one_step import run_single_step, wait_option


@click.group(epilog="Example: tutti io set gantry.lamp on")
def io() -> None:
    """List inputs and outputs by their names, and switch outputs."""


@io.command("ls", epilog="Example: tutti io ls --json")
@fleet_options
@json_option
def list_points(connect: str, fleet: str | None, *, as_json: bool) -> None:
    """List all named inputs and outputs: active or not."""
    from rich.table import Table

    from orchestrator.client import Tutti

    async def show_points(tutti: Tutti) -> None:
        states = await tutti.status()
        if as_json:
            print_json({name: {"inputs": s.inputs, "outputs": s.outputs} for name, s in states.items()})
            return
        table = Table(box=None, header_style="bold")
        for heading in ("name", "kind", "state"):
            table.add_column(heading)
        for name, state in states.items():
            for kind, points in (("input", state.inputs), ("output", state.outputs)):
                for point, active in points.items():
                    table.add_row(f"{name}.{point}", kind, "active" if active else "inactive")
        console.print(table)

    with_fleet(connect, fleet, show_points)


@io.command("set", epilog="Example: tutti io set gantry.lamp off")
@click.argument("output", metavar="CONTROLLER.OUTPUT")
@click.argument("state", type=click.Choice(["on", "off"]))
@wait_option
@fleet_options
def set_output(output: str, state: str, connect: str, fleet: str | None, *, wait: bool) -> None:
    """Switch a named output: on is active, whatever its polarity."""
    step = {"do": "output", "output": output, "value": state == "on"}
    run_single_step(connect, fleet, step, f"{output} is {state}", wait=wait)
