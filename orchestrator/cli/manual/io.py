"""`tutti io …`: named inputs and outputs."""

import click

from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, with_fleet
from orchestrator.cli.base.completion import complete_outputs
from orchestrator.cli.manual.one_step import run_single_step, wait_option


@click.group(epilog="Example: tutti io set gantry.lamp on")
def io() -> None:
    """List inputs and outputs by their names, and switch outputs."""


@io.command("ls", epilog="Example: tutti io ls --json")
@fleet_options
@json_option
def list_points(connect: str, fleet: str | None, *, as_json: bool) -> None:
    """List all named inputs and outputs: active or not."""
    from orchestrator.cli.base.names import require_states
    from orchestrator.client import Tutti
    from orchestrator.monitor.tables import make_plain_table

    async def show_points(tutti: Tutti) -> None:
        states = await require_states(tutti)
        if as_json:
            print_json({name: {"inputs": s.inputs, "outputs": s.outputs} for name, s in states.items()})
            return
        table = make_plain_table(["name", "kind", "state"])
        for name, state in states.items():
            for kind, points in (("input", state.inputs), ("output", state.outputs)):
                for point, active in points.items():
                    table.add_row(f"{name}.{point}", kind, "active" if active else "inactive")
        console.print(table)

    with_fleet(connect, fleet, show_points)


@io.command("set", epilog="Example: tutti io set gantry.lamp off")
@click.argument("output", metavar="CONTROLLER.OUTPUT", shell_complete=complete_outputs)
@click.argument("state", type=click.Choice(["on", "off"]))
@wait_option
@fleet_options
@json_option
def set_output(output: str, state: str, connect: str, fleet: str | None, *, wait: bool, as_json: bool) -> None:
    """Switch a named output: on is active, whatever its polarity."""
    step = {"do": "output", "output": output, "value": state == "on"}
    run_single_step(connect, fleet, step, f"{output} is {state}", wait=wait, as_json=as_json)
