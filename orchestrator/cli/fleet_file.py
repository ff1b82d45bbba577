"""`tutti fleet …`: fleet files."""

from pathlib import Path

import click

from orchestrator.cli.codes import FAILED
from orchestrator.cli.common import console, fleet_options, with_fleet


@click.group(epilog="Example: tutti fleet check lab3.fleet.yaml")
def fleet() -> None:
    """Check fleet files, offline and against the units that are there."""


@fleet.command(epilog="Example: tutti fleet check lab3.fleet.yaml --live")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--live", is_flag=True, help="Also compare with the adapters that run now, and with their units.")
@fleet_options
def check(file: Path, live: bool, connect: str, fleet: str | None) -> None:
    """Check FILE: its form, its references, and each controller's part by its make's own rules."""
    from orchestrator.cli.common import run
    from orchestrator.client import Tutti
    from orchestrator.lab.checked import load_checked_fleet

    async def offline() -> None:
        loaded = load_checked_fleet(file)
        console.print(f"{file}: {len(loaded.controllers)} controllers, {len(loaded.axis_names)} axes: no problem found")

    run(offline())
    if not live:
        return

    async def act(tutti: Tutti) -> None:
        loaded, wrong = load_checked_fleet(file), 0
        states = await tutti.status()
        for name, config in loaded.controllers.items():
            state = states.get(name)
            if state is None:
                said = "[red]no adapter runs for it[/]; is its host in `tutti up`?"
            elif state.digest != config.digest:
                said = f"[red]its adapter has another configuration[/] ({state.digest}, the file has {config.digest})"
            elif state.faults:
                said = f"[red]{state.faults[0].text}[/]; {state.faults[0].remedy}"
            else:
                console.print(f"{name}: the unit and its adapter agree with the file")
                continue
            wrong += 1
            console.print(f"{name}: {said}", soft_wrap=True)
        if wrong:
            raise SystemExit(FAILED)

    with_fleet(connect, fleet or load_checked_fleet(file).fleet, act)
