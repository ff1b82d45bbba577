"""`tutti wiring …`: the trigger wires between controllers."""

import click

from orchestrator.cli.base.codes import FAILED
from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, with_fleet


@click.group(epilog="Example: tutti wiring check")
def wiring() -> None:
    """Trigger wires from outputs of controllers to inputs of others, which can start moves."""


@wiring.command(epilog="Example: tutti wiring check")
@fleet_options
@json_option
def check(connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Check every wire of the fleet file: switch its output, and read all inputs.

    Nothing moves; all axes of the wired controllers are acquired meanwhile. Exit 1 when a wire is wrong.
    """
    from orchestrator.client import Tutti
    from orchestrator.monitor.tables import make_plain_table

    async def check_wires(tutti: Tutti) -> None:
        findings = await tutti.check_wiring()
        if as_json:
            print_json([finding.to_plain() for finding in findings])
        else:
            table = make_plain_table(["output", "input", "", "found"])
            for finding in findings:
                words = f"{finding.text}; {finding.remedy}" if finding.remedy else finding.text
                table.add_row(finding.output, finding.input, "[green]ok[/]" if finding.ok else "[red]wrong[/]", words)
            console.print(table)
        if not all(finding.ok for finding in findings):
            raise SystemExit(FAILED)

    with_fleet(connect, fleet, check_wires)
